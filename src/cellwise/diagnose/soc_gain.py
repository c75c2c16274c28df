"""What the extended model or corrected log means for the EKF, in points of SOC."""

from __future__ import annotations

from typing import Any

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.replay import Replay, replay
from cellwise.logs.cell_log import CellLog


def soc_gain(
    model: CellModel, extended: CellModel, log: CellLog, corrected: CellLog, soc0: float
) -> dict[str, Any] | None:
    """SOC RMSE [1] of the EKF with the model as it was and as it is now, on one log.

    The reference is the tester's own counter over the extended model's capacity from ``soc0``;
    without a counter there is none, and the answer is None.
    """
    if log.charge_Ah is None:
        return None
    start = min(max(soc0, 0.0), 1.0)

    def judged(cell: CellModel, seen: CellLog) -> Replay:
        return replay(
            cell,
            seen,
            "ekf",
            soc0=start,
            reference_soc0=start,
            reference_capacity_Ah=extended.capacity_Ah,
        )

    try:
        before, after = judged(model, log).errors, judged(extended, corrected).errors
    except InputError:
        return None
    if before is None or after is None:
        return None
    return {"log": log.name, "soc_rmse_before": before.rmse, "soc_rmse_after": after.rmse}
