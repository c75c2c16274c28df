"""Embedded data sets and the registry of public originals."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from cellwise.errors import InputError, not_installed
from cellwise.files import EMBEDDED_MARK as CATALOGUE
from cellwise.files import embedded_folder as datasets_folder
from cellwise.files import made_folder
from cellwise.logs import CellLog, read_log

REGISTRY = "registry.toml"
__all__ = ["CATALOGUE", "datasets_folder", "generate_datasets", "list_datasets", "list_originals"]
__all__ += ["load_dataset"]


def list_datasets(folder: Path | str | None = None) -> list[dict[str, Any]]:
    """Catalogue entries of the embedded data sets, or of a folder that was imported, in order.

    Raises
    ------
    InputError        a folder without a catalogue
    """
    place = _folder(folder)
    return list(_read(place / CATALOGUE)["dataset"])


def list_originals() -> list[dict[str, Any]]:
    """Registry entries of public measured cells: DOI, licence, tests, known flaws."""
    return list(_read(datasets_folder() / REGISTRY)["original"])


def load_dataset(name: str, folder: Path | str | None = None) -> CellLog:
    """One embedded data set as a log, or one of a folder that `cellwise data import` wrote.

    Raises
    ------
    InputError        no data set of that name; the message lists those there are
    """
    entries = {str(e["name"]): e for e in list_datasets(folder)}
    if name not in entries:
        raise InputError(
            f"data set '{name}'", f"one of {', '.join(entries)}", "See `cellwise data list`."
        )
    return read_log(_folder(folder) / str(entries[name]["file"]), name=name)


def _folder(folder: Path | str | None) -> Path:
    if folder is None:
        return datasets_folder()
    place = Path(folder)
    if not (place / CATALOGUE).is_file():
        raise InputError(
            f"no {CATALOGUE} in '{folder}'",
            "a folder that `cellwise data import` wrote",
            "Import the original first.",
        )
    return place


def generate_datasets(
    out_dir: Path,
    only: list[str] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> list[Path]:
    """Generate the embedded data again with PyBaMM's physics, which shares no code with cellwise.

    Raises
    ------
    InputError        PyBaMM is not installed; no folder can be made; a name that is not known
    """
    try:
        import_module("pybamm")
    except ImportError as error:
        raise not_installed("pybamm", "data of physics", "PyBaMM") from error
    made_folder(out_dir)
    folder = str(datasets_folder())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    generator = import_module("generator.generate")
    try:
        written: list[Path] = generator.generate(out_dir, only, progress)
    except (KeyError, ValueError) as error:
        raise InputError(
            f"{error}", "names as in `cellwise data list`", "Correct the name."
        ) from error
    return written


def _read(path: Path) -> Mapping[str, Any]:
    with path.open("rb") as file:
        return tomllib.load(file)
