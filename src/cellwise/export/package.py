"""Write a model as C: sources, tables, a description; all of it or nothing.

Or as a module of somebody's tree: its manifest, build files, example in place, from the templates
in ``firmware_ref/layouts``, a folder for each.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from cellwise.arguments import file_path, number
from cellwise.cell.model import CellModel
from cellwise.cell.model_file import model_to_dict
from cellwise.cell.plausibility.sizes import check_is_model
from cellwise.errors import InputError
from cellwise.estimate.fixed.layout import CELL, INPUT, OUTPUT, state_type
from cellwise.estimate.fixed.options import MOST_CELLS, Asked, CellSettings
from cellwise.estimate.fixed.tables import (
    FixedStepTables,
    fixed_step_tables,
    shortest_step_s,
    soc_grid,
)
from cellwise.estimate.noise import Noise
from cellwise.estimate.sensor import Sensor, SensorReadings, assumed, seen_by
from cellwise.export.c_tables import (
    PUBLIC_HEADERS,
    filled,
    firmware_folder,
    prefixed,
    put,
    write_sources,
)
from cellwise.export.example import BUILD, example_files
from cellwise.wording import arg

DESCRIPTION = "cellwise_export.json"
MODEL_FILE = "cell.json"  # what the tables were made of, for `cellwise certify`
# A drive's mean current over more than a minute says little of the voltage at its end: of a
# measured US06 the SOC's error is 0.2 % at steps up to 10 s, 0.5 % at 30 s, 0.9 % at 60 s.
LONGEST_STEP_S = 60.0
GLUE = "cellwise_glue.h"  # of the layouts that keep a state, a clock and what is valid
WHOLE_MS = {
    "zephyr": "Zephyr",
    "foxbms": "foxBMS",
    "px4": "PX4",
    "ardupilot": "ArduPilot",
}  # their glue counts them


@dataclass(frozen=True, eq=False)
class Export:
    """What is exported, and how.

    Parameters
    ----------
    dt_s : float or None      time step of the target; None where what is written has none
    noise : Noise or None     None: the model's, with what the sensors add
    asked : Asked             what is compiled in
    cells : int               of a pack in series, 0: one cell
    prefix : str              of every file and name, for several models in one image
    layout : str or None      tree that the package is arranged for; None: all in one folder
    what : str                of an FMU: the ``estimator`` or the ``cell`` alone
    sensor : Sensor or None   what the target's sensors are off by; None: as a car's

    Raises
    ------
    InputError        a time step above a minute (one that is too short the tables refuse), a number
                      of cells that no pack has, a prefix that is no name
    """

    model: CellModel
    dt_s: float | None = None
    noise: Noise | None = None
    asked: Asked = field(default_factory=Asked)
    cells: int = 0
    prefix: str = ""
    layout: str | None = None
    what: str = "estimator"
    sensor: Sensor | None = None

    def __post_init__(self) -> None:
        if self.dt_s is not None and self.dt_s > LONGEST_STEP_S:
            raise InputError(
                f"a time step of {self.dt_s:g} s",
                f"at most {LONGEST_STEP_S:g} s: a longer mean says little of the voltage at its "
                "end",
                "Give " + arg("dt_s", 1) + ", say, and step more often than the rows are logged.",
            )
        if self.cells and not 2 <= self.cells <= MOST_CELLS:
            raise InputError(
                f"{self.cells} cells in a pack",
                f"2 to {MOST_CELLS} in series",
                "Leave `cells` out for one cell.",
            )
        milliseconds = 1000.0 * (self.dt_s or 0.0)
        if self.layout in WHOLE_MS and abs(milliseconds - round(milliseconds)) > 1e-6:
            raise InputError(
                f"a time step of {self.dt_s:g} s for {WHOLE_MS[self.layout]}",
                "whole milliseconds",
                "Give " + arg("dt_s", 0.1) + ", say.",
            )
        if self.prefix:
            prefixed({}, self.prefix)

    @cached_property
    def seen(self) -> SensorReadings:
        """Model and noise of the filter: with what the sensors add, and the noise as stated."""
        found = seen_by(self.model, self.sensor)
        return found if self.noise is None else found._replace(noise=self.noise)

    @cached_property
    def tables(self) -> FixedStepTables:
        """The tables at the time step; raises as `fixed_step_tables`."""
        dt_s = 0.0 if self.dt_s is None else self.dt_s
        return fixed_step_tables(self.seen.model, dt_s, self.seen.noise, **vars(self.asked))

    @property
    def components(self) -> int:
        """How many filters a bank steps side by side; 1 where none is compiled in."""
        return self.asked.components if self.tables.options.bank else 1

    @property
    def description(self) -> dict[str, Any]:
        """What is exported: the model; of a step its limits, options, noise, sizes."""
        found: dict[str, Any] = {
            "model": self.model.name,
            "model_sha256": model_sha256(self.model),
        }
        if self.dt_s is None:
            return found
        options = self.tables.options
        state_bytes = state_type(options).itemsize
        return {
            **found,
            "dt_s": self.tables.dt_s,
            "dt_limits_s": [shortest_step_s(self.model, options), LONGEST_STEP_S],
            "noise": asdict(self.seen.noise),
            "sensor": assumed(self.sensor, self.model.capacity_Ah),
            "options": asdict(options),
            "components": self.components,
            "soc_grid": soc_grid(self.seen.model, self.asked.points).to_dict(),
            "states": options.states,
            "model_bytes": self.tables.flash_bytes,
            "state_bytes": state_bytes,
            "cells": self.cells,
            "pack_bytes": state_bytes + self.cells * CELL.itemsize if self.cells else 0,
            "input_bytes": INPUT.itemsize,
            "output_bytes": OUTPUT.itemsize,
        }

    def files(self, report: Mapping[str, Any]) -> dict[str, str]:
        """Names and texts of the package; ``report`` is its description, and what was measured.

        Raises
        ------
        InputError        as `arranged`
        """
        found = dict(write_sources(self.tables, report["model_sha256"], self.model.name))
        found |= dict(example_files(self.model, self.tables, report))
        if self.layout:
            name = self.prefix or "cellwise"
            found = arranged(found, self.layout, name, self.tables.dt_s, self.components)
        if self.prefix:
            found = prefixed(found, self.prefix)
        found[MODEL_FILE] = model_text(self.model)
        found[DESCRIPTION] = json.dumps(report, indent=1, allow_nan=False) + "\n"
        return found


def model_sha256(model: CellModel) -> str:
    """Hash of the model's file, whatever its name is."""
    return hashlib.sha256(model_text(model).encode()).hexdigest()


def model_text(model: CellModel) -> str:
    """The model's file."""
    return json.dumps(model_to_dict(model), indent=1, allow_nan=False) + "\n"


def check_folder(folder: Path) -> None:
    """Refuse a folder that could not be made.

    Raises
    ------
    InputError        a file stands in its place, or the folder around it is not there
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"a file at '{folder}'", "a folder", "Give another name with -o.")
    if not folder.resolve().parent.is_dir():
        raise InputError(
            f"no folder '{folder.resolve().parent}'", "an existing folder", "Create it first."
        )


def export_firmware(
    model: CellModel,
    folder: Path | str,
    dt_s: float,
    *,
    noise: Noise | None = None,
    cells: int = 0,
    prefix: str = "",
    layout: str | None = None,
) -> list[Path]:
    """Write the filter of a model as C sources that step every ``dt_s`` seconds.

    As ``cellwise export --dt S -o DIR`` without a log, and without counting what it costs.

    Parameters
    ----------
    folder : path             made where it does not exist
    dt_s : float              time step of the target [s]
    cells : int               of a pack in series, 0: one cell
    noise, prefix, layout     as of :class:`Export`

    Returns
    -------
    list of Path              the files, in alphabetical order

    Raises
    ------
    InputError                as of :class:`Export`; a folder that cannot be written to
    """
    check_is_model(model)
    place = file_path("folder", folder)
    step_s = number("dt_s", dt_s, "the time step of the target [s]", "Give dt_s=1, say.")
    asked = Asked(cells=CellSettings() if cells else None)
    export = Export(model, step_s, noise, asked, cells, prefix, layout)
    unmeasured: dict[str, Any] = {"targets": [], "accuracy": [], "sockets": {}, "notices": []}
    return [place / name for name in write_package(export, place, export.description | unmeasured)]


def write_package(export: Export, folder: Path, report: Mapping[str, Any]) -> list[str]:
    """Write every file into ``folder``, which is made where it does not exist; their names.

    Raises
    ------
    InputError        as of `check_folder`, or it cannot be written to
    """
    check_folder(folder)
    files = export.files(report)
    try:
        with tempfile.TemporaryDirectory(dir=folder.resolve().parent, prefix=".export-") as name:
            put(files, Path(name))
            folder.mkdir(exist_ok=True)
            for file in files:
                (folder / file).parent.mkdir(parents=True, exist_ok=True)
                shutil.move(str(Path(name) / file), str(folder / file))
    except OSError as error:
        raise InputError(
            f"'{folder}', which cannot be written ({error.strerror or error})",
            "a folder with write permission and space left",
            "Check permissions and disk space, or choose another place.",
        ) from error
    return sorted(files)


def arranged(
    files: Mapping[str, str], layout: str, name: str, dt_s: float, components: int
) -> dict[str, str]:
    """The files of a package where a tree wants them, with its own beside.

    Parameters
    ----------
    files : names and texts      of the flat package, before any prefix
    layout : str                 a folder of ``firmware_ref/layouts``
    name : str                   of the library
    components : int             of the bank that its glue steps
    """
    milliseconds = round(1000.0 * dt_s)
    folder = firmware_folder() / "layouts"
    wanted = tomllib.loads((folder / "layouts.toml").read_text(encoding="utf-8"))[layout]
    marks = {"@UPPER@": name.upper(), "@DT_MS@": str(milliseconds), "@NAME@": name}
    marks["@COMPONENTS@"] = str(components)
    found: dict[str, str] = {}
    for file, text in files.items():
        if file == "example.c":
            if "example" in wanted:
                found[wanted["example"]] = as_application(text) if layout == "esp-idf" else text
        elif file == "test_vector.h":
            found[wanted["vector"] + file] = text
        elif file in PUBLIC_HEADERS:
            found[wanted["headers"] + file] = text
        elif file.endswith((".c", ".h")):
            pragma = wanted.get("pragma", "") if file.endswith(".c") else ""
            found[wanted["sources"] + file] = pragma + text
        else:
            found[file] = text.replace(BUILD, filled(wanted["use"], marks))
    own = {path: path.relative_to(folder / layout) for path in (folder / layout).rglob("*")}
    if "glue" in wanted:
        own[folder / GLUE] = Path(wanted["glue"], GLUE)
    for path, to in sorted(own.items()):
        if path.is_file():
            found[to.as_posix()] = filled(path.read_text(encoding="utf-8"), marks)
    return found


def as_application(example: str) -> str:
    """The example for a tree whose entry is ``app_main``."""
    text = example.replace("int main(void)", "static int check(void)")
    return text + "\nvoid app_main(void);\nvoid app_main(void)\n{\n    (void)check();\n}\n"
