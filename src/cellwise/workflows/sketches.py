"""Files of sketches to causes, and the pictures that a model needs for it."""

from __future__ import annotations

from collections.abc import Sequence
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
from cellwise.estimate.sketch.stored import SketchSums, read_sums
from cellwise.identify import Identification


class SketchFiles(NamedTuple):
    """What files show (``found``), and what each of them is of (``sketches``), as JSON values."""

    found: FleetDiagnosis
    sketches: list[dict[str, Any]]

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
    return SketchFiles(diagnose_fleet(model, units), heads)


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
