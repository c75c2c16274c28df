"""Files of sketches to causes, and the pictures that a model needs for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from cellwise.cell.model import CellModel
from cellwise.diagnose.sketch_pictures import make_pictures
from cellwise.diagnose.sketched import (
    FleetDiagnosis,
    SketchDiagnosis,
    diagnose_fleet,
    without_details,
)
from cellwise.errors import InputError
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.estimate.sketch.stored import SketchSums, read_sums
from cellwise.files import write_atomically
from cellwise.identify import Identification
from cellwise.workflows.patching import check_tables, patch_from_sketch


class SketchFiles(NamedTuple):
    """What files show (``found``), and what each of them is of (``sketches``), as JSON values.

    ``last`` are the sums of each target's last file, by its number.
    """

    found: FleetDiagnosis
    sketches: list[dict[str, Any]]
    last: Mapping[int, SketchSums]

    @property
    def shown(self) -> SketchDiagnosis:
        """Of all, or of the one target that there is."""
        units = self.found.units
        return self.found.common or next(iter(units.values()))

    def to_dict(self) -> dict[str, Any]:
        """As JSON values: the keys of a diagnosis; of several targets ``cells`` beside them."""
        cells = [
            {"unit": unit, **without_details(one).to_dict()}
            for unit, one in self.found.units.items()
        ]
        return {**self.shown.to_dict(), "cells": cells, "sketches": self.sketches}


def diagnose_sketch_files(model: CellModel, files: Sequence[str]) -> SketchFiles:
    """Diagnose sketches of targets; those of one target in order of time.

    Raises
    ------
    InputError        no such file, no sketch, other tables; a model without pictures
    """
    units: dict[int, list[SketchSums]] = {}
    heads = []
    for file in files:
        if not Path(file).is_file():
            raise InputError(f"no file '{file}'", "bytes of a sketch", "Correct the path.")
        sums = read_sums(Path(file).read_bytes(), file)
        units.setdefault(sums.unit, []).append(sums)
        heads.append({"file": file, **sums.head()})
    last = {unit: of[-1] for unit, of in units.items()}
    return SketchFiles(diagnose_fleet(model, units), heads, last)


def write_patches(
    files: SketchFiles, place: str, model: CellModel, tables: FixedStepTables, generation: int
) -> dict[int, dict[str, str | None]]:
    """A patch for every target that has a cause, at ``place``; of several with its number there.

    Returns
    -------
    dict        by target ``patch``, where it was written; else None and why (``no_patch``)

    Raises
    ------
    InputError        sketches of other tables than these
    """
    check_tables(files.last.values(), tables)
    written: dict[int, dict[str, str | None]] = {}
    for unit, sketch in files.last.items():
        found, path = files.found.units[unit], Path(place)
        if len(files.last) > 1:
            path = path.with_stem(f"{path.stem}_{unit}")
        try:
            block = patch_from_sketch(found, sketch.temperature_C, model, tables, generation)
        except InputError as error:  # said beside what was found
            written[unit] = {"patch": None, "no_patch": str(error.found)}
            continue
        write_atomically(path, block)
        written[unit] = {"patch": str(path)}
    return written


def with_pictures(found: Identification) -> Identification:
    """An identification whose model knows how causes look in sketches of its own drives.

    Raises
    ------
    InputError        no log under load that took part
    """
    used = [o for o in found.own_logs if o.used]
    taken = [o for o in used if o.role == "drive"] or [o for o in used if o.role == "hppc"]
    logs = [replace(o.simulation.log, soc0=o.simulation.soc0) for o in taken]
    return replace(found, model=make_pictures(found.model, logs))
