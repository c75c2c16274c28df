"""An exported folder as a program of this machine: its own C, checked against its own vector."""

from __future__ import annotations

import json
import subprocess
import tempfile
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.model import CellModel
from cellwise.cell.model_file import read_model
from cellwise.errors import InputError
from cellwise.estimate.filters.kalman import check_components
from cellwise.estimate.fixed.options import Options
from cellwise.estimate.fixed.stepper import FilterMemory
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.estimate.sensor import Sensor, sensor_of
from cellwise.export.c_tables import STRICT_FLAGS, firmware_folder, prefixed
from cellwise.export.firmware import (
    HostLibrary,
    LoadedLibrary,
    compile_rows,
    host_compiler,
    load_library,
)
from cellwise.export.package import DESCRIPTION, MODEL_FILE, model_sha256
from cellwise.export.patch import patched_rows, taken


@dataclass(frozen=True, eq=False)
class Exported:
    """A folder that `cellwise export` wrote, compiled for this machine.

    Parameters
    ----------
    folder : Path
    description : dict     cellwise_export.json
    model : CellModel      that the tables were made of
    """

    folder: Path
    description: dict[str, Any]
    model: CellModel
    stepper: HostLibrary

    def __reduce__(self) -> tuple[Any, ...]:
        """It is compiled again where it is unpacked: in another process, or on another machine."""
        return read_export, (self.folder, self.model)

    @property
    def dt_s(self) -> float:
        """Time step of the target [s]."""
        return float(self.description["dt_s"])

    @property
    def sensor(self) -> Sensor | None:
        """What it was made for, where somebody stated it."""
        stated = self.description.get("sensor", {"by_default": True})
        if stated["by_default"]:
            return None
        known = {k: v for k, v in stated.items() if k != "by_default" and v is not None}
        return sensor_of(known, DESCRIPTION)

    def run(
        self, records: NDArray[Any], soc: float, soc_std: float, patch: bytes | None = None
    ) -> NDArray[Any]:
        """Step the C through samples as its README says, from a start known to ``soc_std``.

        Parameters
        ----------
        records : (n,) of layout.INPUT
        patch : bytes or None     that it takes before its first sample

        Returns
        -------
        (n,) of layout.OUTPUT

        Raises
        ------
        InputError        a patch that the C refuses, or that it is not made for
        """
        memory = self.started(soc, soc_std)
        if patch is None:
            return self.stepper.filter_rows(memory, records)
        block = taken(patch, self.stepper.tables)
        return patched_rows(self.stepper, block, memory, records)

    def started(self, soc: float, soc_std: float) -> FilterMemory:
        """A state before its first sample; with a bank in, a bank of as many as the README says."""
        return self.stepper.start_filter(self.description["components"], soc, soc_std)

    def of_capacity(self, capacity_Ah: float) -> HostLibrary:
        """The same on tables of a cell of another capacity."""
        old = self.stepper.tables
        constants = old.constants.copy()
        constants["soc_per_A"] *= np.float32(self.model.capacity_Ah / capacity_Ah)
        return self.stepper.on(replace(old, constants=constants))


def read_export(folder: str | Path, model: CellModel | None = None) -> Exported:
    """Compile an exported folder, and compare every bit of its test vector.

    Parameters
    ----------
    folder : str or Path
    model : CellModel or None     that it was made of; None: the one in the folder

    Raises
    ------
    InputError        no folder of an export; another model than the tables'; no compiler; C that
                      does not compile, or whose bits are not those of its vector; a pack's export
    """
    place = Path(folder)
    description = _description(place)
    if description.get("cells"):
        raise InputError(
            f"'{place}', the export of a pack of {description['cells']} cells",
            "the export of one cell",
            "Export again without `cells`: the filter is the same.",
        )
    if model is None:
        if not (place / MODEL_FILE).is_file():
            raise InputError(
                f"no {MODEL_FILE} in '{place}'",
                "the model that the tables were made of",
                "Export again, or name it with `model`.",
            )
        model = read_model(place / MODEL_FILE)
    if model_sha256(model) != description["model_sha256"]:
        raise InputError(
            f"a model with sha256 {model_sha256(model)[:16]}...",
            f"the one of the tables, {description['model_sha256'][:16]}...",
            "Name the model that was exported, with what was left out left out.",
        )
    prefix = _prefix(place)
    patterns = (f"{prefix}_ekf.c", f"{prefix}_store.c", "*cell_table.c", "*.h")
    files = [path for pattern in patterns for path in place.rglob(pattern)]
    sources = tuple((path.name, path.read_bytes()) for path in files)
    loaded = _compiled(sources, prefix, tuple(host_compiler()))
    memory = bytes(loaded.ffi.buffer(loaded.cell, int(description["model_bytes"])))
    options = Options(**description["options"])
    tables = FixedStepTables.from_bytes(float(description["dt_s"]), options, memory)
    return Exported(place, description, model, HostLibrary(tables, loaded=loaded))


@lru_cache(maxsize=8)
def _compiled(
    sources: tuple[tuple[str, bytes], ...], prefix: str, compiler: tuple[str, ...]
) -> LoadedLibrary:
    """What sources are compiled to, their vector compared: once in a process, for every fleet."""
    with tempfile.TemporaryDirectory(prefix="certify-") as name:
        built = Path(name)
        for file, text in sources:
            (built / file).write_bytes(text)
        _check_vector(built, prefix)
        return load_library(compile_rows(built, prefix, compiler), prefix)


def _description(place: Path) -> dict[str, Any]:
    try:
        found = json.loads((place / DESCRIPTION).read_text(encoding="utf-8"))
        if not isinstance(found, dict):
            raise ValueError("no object")
        _ = found["model_sha256"], float(found["dt_s"]), int(found["model_bytes"])
        _ = Options(**found["options"])
        check_components(found["components"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"'{place}', in which {DESCRIPTION} is missing or damaged",
            "a folder that `cellwise export` wrote",
            "Export the model into a folder first.",
        ) from error
    return found


def _prefix(place: Path) -> str:
    """What the names of the C begin with; the files may lie in folders of their own."""
    found = sorted(place.rglob("*_ekf.c"))
    if len(found) != 1:
        raise InputError(f"{len(found)} filters in '{place}'", "one file *_ekf.c", "Export again.")
    return found[0].name.removesuffix("_ekf.c")


def _check_vector(built: Path, prefix: str) -> None:
    """Compile and run the example, which compares every bit of the vector."""
    text = (firmware_folder() / "example.c").read_text(encoding="utf-8")
    if prefix != "cellwise":
        headers = {path.name.replace(f"{prefix}_", "cellwise_"): "" for path in built.glob("*.h")}
        text = prefixed({"example.c": text, "test_vector.h": "", **headers}, prefix)[
            f"{prefix}_example.c"
        ]
    (built / "example.c").write_text(text, encoding="utf-8")
    program = built / "check_vector"
    command = [*host_compiler(), *STRICT_FLAGS, "-o", str(program), *map(str, built.glob("*.c"))]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    if made.returncode:
        raise InputError(
            f"C that does not compile: {made.stderr.strip()[:300]}",
            "the files as they were exported",
            "Export again into a new folder.",
        )
    ran = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    if ran.returncode:
        raise InputError(
            "bits that are not those of its test vector",
            "the files as they were exported, and a compiler that keeps IEEE 754 float",
            "Export again into a new folder, or set $CC to another compiler.",
        )
