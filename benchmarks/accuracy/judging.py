"""What a model is worth on a log that it has not seen: voltage, and SOC from a wrong start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.estimate.replay import Replay, reference_soc, replay
from cellwise.logs import CellLog

POINTS_OFF = 0.30
MIDDLE_SOC = 0.60


@dataclass(frozen=True)
class SocJudgement:
    """SOC estimated from a given start, judged by the tester's counter."""

    start: float
    convergence_s: float | None
    rmse: float
    late_rmse: float
    coverage: float


def voltage_rmse_mV(model: CellModel, log: CellLog, soc0: float) -> float:
    """RMSE of the simulated voltage above 10 % SOC [mV]."""
    return 1e3 * simulate(model, log, soc0).rmse_above_10pct_V


def judge_soc(
    model: CellModel,
    log: CellLog,
    *,
    start: float,
    true_start: float,
    reference_Ah: float,
    after_s: float,
) -> SocJudgement:
    """EKF from ``start``; ``late_rmse`` counts from ``after_s`` on."""
    found: Replay = replay(
        model,
        log,
        "ekf",
        soc0=start,
        reference_soc0=true_start,
        reference_capacity_Ah=reference_Ah,
    )
    error = found.error
    if error is None or found.errors is None or found.coverage_2sigma is None:
        raise ValueError(f"no counter in log '{log.name}': nothing to judge with")
    late = error[log.time_s - log.time_s[0] >= after_s]
    return SocJudgement(
        start=start,
        convergence_s=found.convergence_s,
        rmse=found.errors.rmse,
        late_rmse=float(np.sqrt(np.nanmean(late**2))),
        coverage=found.coverage_2sigma,
    )


def from_the_middle(
    log: CellLog, true_start: float, reference_Ah: float, soc: float = MIDDLE_SOC
) -> tuple[CellLog, float]:
    """The rest of a log from where the counter passes ``soc``, and the SOC there.

    The cell is under load there and its branches are charged: harder than a start from full.
    """
    reference = reference_soc(log, true_start, reference_Ah)
    if reference is None:
        raise ValueError(f"no counter in log '{log.name}'")
    row = int(np.argmax(reference <= soc))
    return log.part(row, len(log)), float(reference[row])
