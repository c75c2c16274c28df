"""A diagnosis as a patch for a target in the field."""

from __future__ import annotations

import numpy as np

from cellwise.benchmark.certify.exported import Exported
from cellwise.cell.simulate import known_temperature_C
from cellwise.diagnose.result import Diagnosis
from cellwise.errors import InputError
from cellwise.export.patch import patch_of


def patch_for(found: Diagnosis, exported: Exported, generation: int) -> bytes:
    """A patch of what was found for an exported folder.

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
        exported.model,
        generation,
        found.extended_model or found.model,
        (float(warm.min()), float(warm.max())),
    )
    return patch.block(exported.stepper.tables)
