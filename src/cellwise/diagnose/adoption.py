"""Whether the extended model is better: its voltage and its SOC, on logs the fit has not seen."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from cellwise.cell.model import CellModel
from cellwise.diagnose.log_runs import LogRun
from cellwise.errors import InputError
from cellwise.estimate.replay import replay


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
    model: CellModel, extended: CellModel, runs: Sequence[LogRun], reference: Reference
) -> tuple[dict[str, Any] | None, str]:
    """SOC RMSE [1] of the EKF with the model as it was and as it is now.

    Of several logs the one that loses most, where one loses; else the first. The referee is the
    tester's own counter over a capacity that the diagnosis did not estimate, from a start that it
    did not estimate: else what is to be judged would judge itself.

    Returns
    -------
    dict or None      ``log``, ``soc_rmse_before``, ``soc_rmse_after``, ``reference_capacity_Ah``,
                      ``reference``
    str               why there is none; empty if there is
    """
    if reference.capacity_Ah is None:
        return None, reference.source
    gains: list[dict[str, Any]] = []
    why = ""
    for run in runs:
        try:
            gains.append(_soc_gain(model, extended, run, reference))
        except InputError as error:
            why = why or error.found
    if not gains:
        return None, why

    def loss(gain: dict[str, Any]) -> float:
        return float(gain["soc_rmse_after"] - gain["soc_rmse_before"])

    worst = max(gains, key=loss)
    return (worst if loss(worst) > 0.0 else gains[0]), ""


def _soc_gain(
    model: CellModel, extended: CellModel, run: LogRun, reference: Reference
) -> dict[str, Any]:
    """Of one log.

    Raises
    ------
    InputError        there is no counter, or it does not cover the log
    """
    name = run.log.name or "the log"
    if run.log.charge_Ah is None:
        raise InputError(f"{name} has no counter of the tester", "one", "")
    start = run.before.soc0
    errors = []
    for cell, seen in ((model, run.log), (extended, run.explained.log)):
        found = replay(
            cell,
            seen,
            "ekf",
            soc0=start,
            reference_soc0=start,
            reference_capacity_Ah=reference.capacity_Ah,
        ).errors
        if found is None:
            raise InputError(f"the counter does not cover {name}", "one that does", "")
        errors.append(found.rmse)
    return {
        "log": run.log.name,
        "soc_rmse_before": errors[0],
        "soc_rmse_after": errors[1],
        "reference_capacity_Ah": reference.capacity_Ah,
        "reference": reference.source,
    }
