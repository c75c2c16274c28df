"""Anyone's filter in the benchmark: two functions, about twenty lines.

A filter is a class or a function that takes a :class:`~cellwise.cell.model.CellModel` and gives an
object with ``start`` and ``step``. A suite names it ``file.py:Name`` or ``package.module:Name``.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import known_temperature_C
from cellwise.errors import InputError
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray


class FilterOutput(NamedTuple):
    """What a filter gives after a sample; what it does not know is NaN.

    ``voltage_V`` is predicted before the sample's own voltage was used, ``voltage_std_V`` how well.
    """

    soc: float
    soc_std: float = float("nan")
    voltage_V: float = float("nan")
    voltage_std_V: float = float("nan")


class OnlineFilter(Protocol):
    """What an adapter has to offer."""

    def start(self, soc0: float, soc0_std: float) -> None:
        """Forget everything; the SOC is ``soc0``, known to ``soc0_std``."""
        ...

    def step(
        self, current_A: float, voltage_V: float, temperature_C: float, dt_s: float
    ) -> FilterOutput | float:
        """Take the sample that ends an interval; the SOC, or a :class:`FilterOutput`.

        Positive current is discharge, and flowed during the interval. A missing reading is NaN;
        the first sample has ``dt_s`` = 0, and in a gap of the log the current is unknown.
        """
        ...


MakeFilter = Callable[[CellModel], OnlineFilter]


class Adapted:
    """An online filter as an estimator that replays logs."""

    def __init__(self, name: str, model: CellModel, make: MakeFilter) -> None:
        self.name = name
        self.filter = make(model)
        self._model = model

    def run(self, log: CellLog, soc0: float, soc0_std: float = 0.15) -> Trace:
        """Hand a whole log to the filter, sample by sample."""
        outputs = np.full((4, len(log)), np.nan)
        self.filter.start(soc0, soc0_std)
        for k, row in enumerate(samples(self._model, log).T.tolist()):
            answer = self.filter.step(*row)
            parts = answer if isinstance(answer, tuple) else (answer,)
            outputs[: len(parts), k] = parts
        return trace_of(log, *outputs)


def samples(model: CellModel, log: CellLog) -> FloatArray:
    """Current, voltage, temperature, interval of every row, shape (4, n), as `step` takes them."""
    current = np.array(log.interval_current_A)
    current[log.gap_rows] = np.nan
    temperature = known_temperature_C(model, log)
    return np.vstack((current, log.voltage_V, temperature, log.interval_s))


def trace_of(
    log: CellLog,
    soc: FloatArray,
    std: FloatArray,
    voltage: FloatArray,
    voltage_std: FloatArray | None = None,
) -> Trace:
    """What somebody's filter answered, as ours answer."""
    missing = np.full(len(log), np.nan)
    variance = missing if voltage_std is None else voltage_std**2
    status = np.zeros(len(log), dtype=np.int32)
    left = log.voltage_V - voltage
    return Trace(log.time_s, soc, std, voltage, left, variance, missing, status)


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
