"""The exported filter beside the float64 EKF, over a log."""

from __future__ import annotations

from dataclasses import dataclass

from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model import CellModel
from cellwise.estimate.filters.ekf import Ekf
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.noise import Noise
from cellwise.logs.cell_log import CellLog
from cellwise.logs.resample import resample
from cellwise.plotting import Line, Panel, Plottable
from cellwise.typing import FloatArray


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
    even = resample(log, dt_s)
    start = initial_soc(model, even, soc0)
    reference = Ekf(model, noise).run(even, start.soc, start.std)
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
