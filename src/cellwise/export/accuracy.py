"""The exported filter against the float64 EKF over a log: what float32 and small tables cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.model import CellModel
from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.noise import Noise
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog
from cellwise.logs.resample import resample
from cellwise.plotting import Line, Panel, Plottable
from cellwise.typing import FloatArray

GRIDS = (11, 21, 51, 101, 201)


@dataclass(frozen=True)
class GridAccuracy:
    """SOC of the fixed step minus SOC of the float64 EKF, for one number of SOC points."""

    points: int
    flash_bytes: int
    soc_rmse: float
    soc_max: float


@dataclass(frozen=True, eq=False)
class FixedAndFloat(Plottable):
    """Both filters over a log at the target's time step, from the same start; shapes (n,)."""

    log: CellLog
    float_soc: FloatArray
    float_soc_std: FloatArray
    fixed_soc: FloatArray

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """Both SOCs, their difference, and what the filters see."""
        hours = self.log.time_s / 3600.0
        both = (
            Line("float64 EKF", hours, self.float_soc, 2.0 * self.float_soc_std),
            Line("exported", hours, self.fixed_soc),
        )
        lost = Line("exported - float64", hours, 100.0 * (self.fixed_soc - self.float_soc))
        return "time [h]", (
            Panel("SOC", both),
            Panel("difference [points]", (lost,)),
            Panel("voltage [V]", (Line("voltage", hours, self.log.voltage_V),)),
            Panel("current [A]", (Line("current", hours, self.log.current_A),)),
        )


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
    even, start, reference = _float_ekf(model, log, dt_s, soc0, noise)
    found = []
    for points in sorted({*grids, model.points}):
        step = FixedStep(model, noise, dt_s=dt_s, points=points, wide=wide, watch=wide)
        error = step.run(even, start.soc, start.std).soc - reference.soc
        found.append(
            GridAccuracy(
                points,
                step.stepper(dt_s).tables.flash_bytes,
                float(np.sqrt(np.mean(error * error))),
                float(np.max(np.abs(error))),
            )
        )
    return found


def fixed_and_float(
    model: CellModel,
    log: CellLog,
    dt_s: float,
    *,
    soc0: float | None = None,
    points: int | None = None,
    offset_std_A: float = 0.0,
    lean: bool = False,
    noise: Noise | None = None,
) -> FixedAndFloat:
    """Run what is exported (in Python, the same bits) and the float64 EKF over a log.

    Parameters as of `accuracy_by_grid` and of `FixedStep`; soc0 None: as found at the log's start.
    """
    even, start, reference = _float_ekf(model, log, dt_s, soc0, noise)
    step = FixedStep(
        model,
        noise,
        dt_s=dt_s,
        points=points,
        offset_std_A=offset_std_A,
        wide=not lean,
        watch=not lean,
    )
    exported = step.run(even, start.soc, start.std)
    return FixedAndFloat(even, reference.soc, reference.soc_std, exported.soc)


def _float_ekf(
    model: CellModel, log: CellLog, dt_s: float, soc0: float | None, noise: Noise | None
) -> tuple[CellLog, InitialSoc, Trace]:
    """The log at the target's time step, its start, and the float64 EKF over it."""
    even = resample(log, dt_s)
    start = initial_soc(model, even, soc0)
    return even, start, Ekf(model, noise).run(even, start.soc, start.std)
