"""What float32 and the size of the tables cost in accuracy, on a log, against the float64 EKF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model import CellModel
from cellwise.estimate.filters.ekf import Ekf
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.noise import Noise
from cellwise.logs.cell_log import CellLog
from cellwise.logs.resample import resample

GRIDS = (11, 21, 51, 101, 201)


@dataclass(frozen=True)
class GridAccuracy:
    """SOC of the fixed step minus SOC of the float64 EKF, for one number of SOC points."""

    points: int
    flash_bytes: int
    soc_rmse: float
    soc_max: float


def accuracy_by_grid(
    model: CellModel,
    log: CellLog,
    dt_s: float,
    *,
    soc0: float | None = None,
    wide: bool = True,
    grids: Sequence[int] = GRIDS,
    noise: Noise | None = None,
) -> list[GridAccuracy]:
    """Accuracy lost by every grid, the model's own among them.

    Both filters take the log resampled to ``dt_s``, and the same start; soc0 None: as found at the
    log's start. wide False: as with ``--lean``. noise None: the model's.
    """
    even = resample(log, dt_s)
    start = initial_soc(model, even, soc0)
    reference = Ekf(model, noise).run(even, start.soc, start.std).soc
    found = []
    for points in sorted({*grids, model.points}):
        step = FixedStep(model, noise, dt_s=dt_s, points=points, wide=wide, watch=wide)
        error = step.run(even, start.soc, start.std).soc - reference
        found.append(
            GridAccuracy(
                points,
                step.stepper(dt_s).tables.flash_bytes,
                float(np.sqrt(np.mean(error * error))),
                float(np.max(np.abs(error))),
            )
        )
    return found
