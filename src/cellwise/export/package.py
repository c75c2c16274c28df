"""Write a model as C: sources, tables, a description; all of it or nothing.

Or as a module of somebody's tree: its manifest, build files, example in place, from the templates
in ``firmware_ref/layouts``, a folder for each.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cellwise.cell.model import CellModel
from cellwise.cell.model_file import model_to_dict
from cellwise.errors import InputError
from cellwise.estimate.fixed.layout import CELL, INPUT, OUTPUT, state_type
from cellwise.estimate.fixed.options import MOST_CELLS
from cellwise.estimate.fixed.tables import FixedStepTables, shortest_step_s
from cellwise.estimate.noise import Noise
from cellwise.export.c_tables import filled, firmware_folder, prefixed, put, write_sources
from cellwise.export.example import BUILD, example_files

DESCRIPTION = "cellwise_export.json"
MODEL_FILE = "cell.json"  # what the tables were made of, for `cellwise certify`
# A drive's mean current over more than a minute says little of the voltage at its end: of a
# measured US06 the SOC's error is 0.2 % at steps up to 10 s, 0.5 % at 30 s, 0.9 % at 60 s.
LONGEST_STEP_S = 60.0


def model_sha256(model: CellModel) -> str:
    """Hash of the model's file, whatever its name is."""
    return hashlib.sha256(model_text(model).encode()).hexdigest()


def model_text(model: CellModel) -> str:
    """The model's file."""
    return json.dumps(model_to_dict(model), indent=1, allow_nan=False) + "\n"


def describe(
    model: CellModel, tables: FixedStepTables, noise: Noise | None = None, cells: int = 0
) -> dict[str, Any]:
    """What was exported: time step and its limits, options, noise, sizes."""
    state_bytes = state_type(tables.options).itemsize
    noise = Noise.of_model(model) if noise is None else noise
    return {
        "model": model.name,
        "model_sha256": model_sha256(model),
        "dt_s": tables.dt_s,
        "dt_limits_s": [shortest_step_s(model, tables.options), LONGEST_STEP_S],
        "noise": asdict(noise),
        "options": asdict(tables.options),
        "states": tables.options.states,
        "model_bytes": tables.flash_bytes,
        "state_bytes": state_bytes,
        "cells": cells,
        "pack_bytes": state_bytes + cells * CELL.itemsize if cells else 0,
        "input_bytes": INPUT.itemsize,
        "output_bytes": OUTPUT.itemsize,
    }


def check_step(dt_s: float) -> None:
    """Refuse a time step that no target should run with.

    Raises
    ------
    InputError        longer than a minute; what is too short for float32 the tables refuse
    """
    if dt_s > LONGEST_STEP_S:
        raise InputError(
            f"a time step of {dt_s:g} s",
            f"at most {LONGEST_STEP_S:g} s: a longer mean says little of the voltage at its end",
            "Give `dt_s=1`, say, and step more often than the rows are logged.",
        )


def check_cells(cells: int) -> None:
    """Refuse a number of cells that no pack has; 0 is no pack.

    Raises
    ------
    InputError        one cell, more than a thousand
    """
    if cells and not 2 <= cells <= MOST_CELLS:
        raise InputError(
            f"{cells} cells in a pack",
            f"2 to {MOST_CELLS} in series",
            "Leave `cells` out for one cell.",
        )


def package_files(
    model: CellModel,
    tables: FixedStepTables,
    description: dict[str, Any],
    prefix: str = "",
    layout: str | None = None,
) -> dict[str, str]:
    """Names and texts of the package; parameters as :func:`write_package`."""
    files = dict(write_sources(tables, description["model_sha256"], model.name))
    files |= dict(example_files(model, tables, description))
    if layout:
        files = arranged(files, layout, prefix or "cellwise", tables.dt_s)
    if prefix:
        files = prefixed(files, prefix)
    files[MODEL_FILE] = model_text(model)
    files[DESCRIPTION] = json.dumps(description, indent=1, allow_nan=False) + "\n"
    return files


def write_package(
    model: CellModel,
    tables: FixedStepTables,
    folder: Path,
    description: dict[str, Any],
    prefix: str = "",
    layout: str | None = None,
) -> list[str]:
    """Write every file into ``folder``, which is made where it does not exist; their names.

    ``layout`` is a name of `LAYOUTS`; None: all in one folder.

    Raises
    ------
    InputError        a file stands in the folder's place, or it cannot be written to
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"a file at '{folder}'", "a folder", "Give another name with -o.")
    if not folder.resolve().parent.is_dir():
        raise InputError(
            f"no folder '{folder.resolve().parent}'", "an existing folder", "Create it first."
        )
    files = package_files(model, tables, description, prefix, layout)
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


# No build file of the Arduino tree reaches the compiler; fused operations would change bits.
UNFUSED = """\
#if defined(__clang__)
#pragma clang fp contract(off)
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#endif
"""


@dataclass(frozen=True)
class Layout:
    """Where a tree wants what: folders of sources and headers, the example's file; how it is used.

    ``example`` is None where a template is the example; ``vector`` is the folder of test_vector.h.
    """

    sources: str
    headers: str
    example: str | None
    vector: str
    use: str


LAYOUTS = {
    "cmake": Layout(
        *("src/", "include/", "example/example.c", "example/"),
        "    cmake -B build && cmake --build build && ctest --test-dir build\n\n"
        "or `add_subdirectory` of this folder, and link `@NAME@`.",
    ),
    "zephyr": Layout(
        *("src/", "include/", "samples/check/src/main.c", "samples/check/src/"),
        "    west build -b qemu_cortex_m3 samples/check -t run\n\n"
        "In an application: `EXTRA_ZEPHYR_MODULES` or the west manifest names this folder, "
        "`prj.conf` says `CONFIG_@UPPER@=y`.",
    ),
    "platformio": Layout(
        *("src/", "include/", "examples/check/src/main.c", "examples/check/src/"),
        "    pio run -d examples/check -t exec\n\n"
        "In a project: `lib_deps = @NAME@=symlink://path/of/this/folder`.",
    ),
    "arduino": Layout(
        *("src/", "src/", None, "examples/Check/"),
        "Put this folder into `libraries`, or *Sketch > Include Library > Add .ZIP Library*; then "
        "*Examples > @NAME@ > Check*. On a board without 32 KB of RAM keep the vector in flash.",
    ),
    "esp-idf": Layout(
        *("src/", "include/", "examples/check/main/main.c", "examples/check/main/"),
        "    idf.py -C examples/check build flash monitor\n\n"
        "In a project: this folder in `components`, or `override_path` in `idf_component.yml`.",
    ),
    "foxbms": Layout(
        *("", "", "example/example.c", "example/"),
        "Put this folder to `src/app/application/algorithm/state_estimation/soc/@NAME@` and name "
        "`@NAME@` as the SOC algorithm in `conf/bms/bms.json`. The model is that of a cell block: "
        "scale its capacity by the cells in parallel.",
    ),
}


def arranged(files: dict[str, str], layout: str, name: str, dt_s: float) -> dict[str, str]:
    """The files of a package where a tree wants them, with its own beside.

    Parameters
    ----------
    files : names and texts      of the flat package, before any prefix
    layout : str                 a key of :data:`LAYOUTS`
    name : str                   of the library

    Raises
    ------
    InputError        an unknown layout; a time step that is not a whole number of milliseconds,
                      which the foxBMS glue counts in
    """
    if layout not in LAYOUTS:
        raise InputError(f"layout '{layout}'", f"one of {', '.join(LAYOUTS)}", "Choose one.")
    milliseconds = round(1000.0 * dt_s)
    if layout == "foxbms" and abs(milliseconds - 1000.0 * dt_s) > 1e-6:
        raise InputError(
            f"a time step of {dt_s:g} s for foxBMS", "whole milliseconds", "Give `dt_s=0.1`, say."
        )
    wanted = LAYOUTS[layout]

    marks = {"@UPPER@": name.upper(), "@DT_MS@": str(milliseconds), "@NAME@": name}
    found: dict[str, str] = {}
    for file, text in files.items():
        if file == "example.c":
            if wanted.example is not None:
                found[wanted.example] = as_application(text) if layout == "esp-idf" else text
        elif file == "test_vector.h":
            found[wanted.vector + file] = text
        elif file.endswith(".h"):
            found[wanted.headers + file] = text
        elif file.endswith(".c"):
            found[wanted.sources + file] = (UNFUSED if layout == "arduino" else "") + text
        else:
            found[file] = text.replace(BUILD, filled(wanted.use, marks))
    folder = firmware_folder() / "layouts" / layout
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            text = filled(path.read_text(encoding="utf-8"), marks)
            found[path.relative_to(folder).as_posix()] = text
    return found


def as_application(example: str) -> str:
    """The example for a tree whose entry is ``app_main``."""
    text = example.replace("int main(void)", "static int check(void)")
    return text + "\nvoid app_main(void);\nvoid app_main(void)\n{\n    (void)check();\n}\n"
