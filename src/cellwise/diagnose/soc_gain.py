"""What the extended model or corrected log means for the EKF, in points of SOC.

The referee is the tester's own counter over a capacity that the diagnosis did not estimate, from a
start that it did not estimate: else what is to be judged would judge itself.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from cellwise.cell.model import CellModel
from cellwise.diagnose.log_runs import LogRun
from cellwise.errors import InputError
from cellwise.estimate.replay import Replay, replay
from cellwise.logs.cell_log import CellLog


@dataclass(frozen=True)
class Reference:
    """A capacity [Ah] and where it is from, or why there is none (``capacity_Ah`` is None)."""

    capacity_Ah: float | None
    source: str


def reference_for(model: CellModel, stated_Ah: float | None, named: Collection[str]) -> Reference:
    """What SOC is judged over: the stated capacity, else the model file's.

    Parameters
    ----------
    stated_Ah : float or None     capacity that the user states [Ah]
    named : names of the causes that were found
    """
    if "initial_soc" in named:
        return Reference(None, "the initial SOC is one of the causes, so no SOC is known")
    if stated_Ah is not None:
        return Reference(float(stated_Ah), "stated")
    if "capacity" in named:
        return Reference(
            None,
            "the capacity is one of the causes, and a SOC over it would prove itself; "
            "state one that was measured (`reference_capacity_Ah=X`)",
        )
    choice = model.provenance.get("capacity", {})
    how = choice.get("choice", "") if isinstance(choice, dict) else ""
    return Reference(model.capacity_Ah, f"the model's own ({how or 'as its file says'})")


def soc_gain(
    model: CellModel, extended: CellModel, run: LogRun, reference: Reference
) -> tuple[dict[str, Any] | None, str]:
    """SOC RMSE [1] of the EKF with the model as it was and as it is now, on one log.

    Returns
    -------
    dict or None      ``log``, ``soc_rmse_before``, ``soc_rmse_after``, ``reference_capacity_Ah``,
                      ``reference``
    str               why there is none; empty if there is
    """
    capacity = reference.capacity_Ah
    if capacity is None:
        return None, reference.source
    if run.log.charge_Ah is None:
        return None, f"{run.log.name or 'the log'} has no counter of the tester"
    start = run.before.soc0

    def judged(cell: CellModel, seen: CellLog) -> Replay:
        return replay(
            cell,
            seen,
            "ekf",
            soc0=start,
            reference_soc0=start,
            reference_capacity_Ah=capacity,
        )

    try:
        before = judged(model, run.log).errors
        after = judged(extended, run.explained.log).errors
    except InputError as error:
        return None, error.found
    if before is None or after is None:
        return None, "the counter does not cover the log"
    return {
        "log": run.log.name,
        "soc_rmse_before": before.rmse,
        "soc_rmse_after": after.rmse,
        "reference_capacity_Ah": capacity,
        "reference": reference.source,
    }, ""
