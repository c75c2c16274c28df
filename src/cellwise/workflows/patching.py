"""A diagnosis as a patch for a target in the field."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import known_temperature_C
from cellwise.diagnose.result import Diagnosis
from cellwise.diagnose.sketched import SketchDiagnosis
from cellwise.errors import InputError
from cellwise.estimate.equations.constants import LOST_RATE
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.estimate.sketch.stored import SketchSums
from cellwise.export.patch import patch_of


def patch_for(
    found: Diagnosis, model: CellModel, tables: FixedStepTables, generation: int
) -> bytes:
    """A patch of what was found, for a target with the ``tables`` of a ``model``.

    Raises
    ------
    InputError        nothing was found that helps; causes that need new tables
    """
    if found.adopt is False:
        raise InputError(
            "logs held out that lose by it", "a gain there", "Give logs that show the cause more."
        )
    warm = np.concatenate([known_temperature_C(found.model, log) for log in found.logs])
    patch = patch_of(
        {c.name: c.parameters for c in found.causes if c.log is None},
        model,
        generation,
        found.extended_model or found.model,
        (float(warm.min()), float(warm.max())),
    )
    return patch.block(tables)


def patch_from_sketch(
    found: SketchDiagnosis, kept: SketchSums, model: CellModel, generation: int
) -> bytes:
    """A patch of what a target's sketches named, for the tables of a ``model`` that it has.

    ``kept`` are the sums of its last sketch, which says of which tables and temperature it is.

    Raises
    ------
    InputError        nothing was named; a cause that needs new tables
    """
    causes = {c.name: c.parameters for c in found.causes}
    added_ohm = causes.get("ohmic_resistance", {}).get("added_ohm", 0.0)
    new = replace(model, r0_ohm=model.r0_ohm + added_ohm)
    warm = (kept.temperature_C, kept.temperature_C)
    patch = patch_of(causes, model, generation, new, warm)
    return patch.block_of(kept.model_crc, LOST_RATE * model.capacity_Ah)


def check_tables(sketches: Iterable[SketchSums], tables: FixedStepTables) -> None:
    """Refuse sketches that a target with other tables kept.

    Raises
    ------
    InputError        as said
    """
    if any(s.model_crc != zlib.crc32(tables.to_bytes()) for s in sketches):
        raise InputError(
            "sketches of other tables than the export's",
            "sketches and the export of one firmware",
            "Name the folder that these targets were built from.",
        )
