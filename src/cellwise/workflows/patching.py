"""A diagnosis as a patch for a target in the field."""

from __future__ import annotations

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import known_temperature_C
from cellwise.diagnose.result import Diagnosis
from cellwise.errors import InputError
from cellwise.estimate.fixed.tables import FixedStepTables
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
