"""Anyone's filter in the benchmark: two functions, about twenty lines.

A filter is a class or a function that takes a :class:`~cellwise.cell.model.CellModel` and gives a
:class:`~cellwise.estimate.estimators.OnlineFilter`. A suite names it
``file.py:Name`` or ``package.module:Name``.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.estimators import OnlineFilter

MakeFilter = Callable[[CellModel], OnlineFilter]


def is_adapter(name: str) -> bool:
    """Whether an estimator's name says where an adapter is."""
    return ":" in name


def short_name(name: str) -> str:
    """What stands in tables for ``file.py:Name``."""
    return name.rpartition(":")[2] if is_adapter(name) else name


def load_adapter(name: str, folder: Path) -> MakeFilter:
    """The class or function behind ``file.py:Name`` or ``package.module:Name``.

    Parameters
    ----------
    folder : Path      where a file is looked for first: the suite's own folder

    Raises
    ------
    InputError         no such file, module or name; it fails while it is loaded; it takes no model
    """
    place, _, attribute = name.rpartition(":")
    try:
        module = _file_module(place, folder) if place.endswith(".py") else _module(place)
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"the filter '{name}', which cannot be loaded ({described(error)})",
            "a module that can be imported",
            "Correct it, or install what it needs.",
        ) from error
    make = getattr(module, attribute, None)
    if not callable(make) or not _takes_one(make):
        raise InputError(
            f"no '{attribute}' in '{place}' that takes a model",
            "a class or function of one argument, the CellModel",
            "See 'Your filter in the benchmark' in docs/benchmark.md.",
        )
    return make  # type: ignore[no-any-return]


def described(error: BaseException) -> str:
    """What an error of somebody's filter is, and in which line of which file it was raised."""
    text = f"{type(error).__name__}: {error}"
    if isinstance(error, SyntaxError):
        return text  # states its file and line itself
    own = [f for f in traceback.extract_tb(error.__traceback__) if not _is_ours(f.filename)]
    if not own:
        return text
    return f"{text}, in line {own[-1].lineno} of {Path(own[-1].filename).name}: {own[-1].line}"


def _is_ours(filename: str) -> bool:
    """A file of this package or of Python's own import machinery."""
    package = str(Path(__file__).resolve().parents[1])
    return filename.startswith((package, "<frozen"))


def _module(place: str) -> Any:
    return importlib.import_module(place)


def _file_module(place: str, folder: Path) -> Any:
    path = Path(place)
    found = next((p for p in (folder / path, path) if p.is_file()), None)
    if found is None:
        raise InputError(
            f"no file '{place}' beside the suite", "the adapter's Python file", "Correct the path."
        )
    name = f"cellwise_adapter_{found.stem}"
    spec = importlib.util.spec_from_file_location(name, found)
    if spec is None or spec.loader is None:
        raise InputError(f"'{found}', which is no Python file", "a .py file", "Rename it.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def _takes_one(make: Callable[..., Any]) -> bool:
    try:
        inspect.signature(make).bind(None)
    except (TypeError, ValueError):
        return False
    return True
