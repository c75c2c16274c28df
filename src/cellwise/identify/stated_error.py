"""Station "error": what the model errs on loads that its fit has not seen, each left out once.

Of drives one of every temperature is left out at a time; of a single load, or of pulses alone,
every other stretch of SOC. The tables begin at those of all logs, so a fit takes few steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.model_error import ModelError
from cellwise.cell.posterior import POINTS, Posterior
from cellwise.cell.simulate import known_temperature_C, simulate
from cellwise.fit.model_error import (
    SAME_TEMPERATURE_K,
    ResidualLog,
    estimate_model_error,
    polarisation_of,
    unseen_shares,
)
from cellwise.fit.rows import FitLog
from cellwise.identify.assemble import own_model
from cellwise.identify.effect_selection import NEEDED, JointFit, drive_temperatures
from cellwise.identify.joint_fit import QUICK_ITERATIONS
from cellwise.typing import BoolArray, FloatArray

MOST_FOLDS = 4
STRETCH_SOC = 0.1  # left out at a time where a log cannot be left out whole


class Fold(NamedTuple):
    """Of each log left out the rows that are, and what a model fitted without them leaves there."""

    rows: dict[int, BoolArray]
    residuals: dict[int, ResidualLog]


def stated_error(
    fit: JointFit,
    model: CellModel,
    folds: Sequence[Fold],
    posterior: Posterior,
    other_share: float = 0.0,
) -> ModelError:
    """What a filter under load must expect: loads that a fit has left out, low-rate tests do not.

    But where no load has been at a SOC, tests at constant current are all there is to go by; and
    what the posterior leaves open is the least.

    Parameters
    ----------
    model : CellModel             of all logs of the fit
    folds : sequence of Fold      what models of its kind leave of what they have not seen
    other_share : float           by which the resistances may be another log's, that no log can
                                  show
    """
    joint = fit.joint
    others = [
        residual_log(own_model(model, math.exp(item.ln_sample)), item)
        for item in joint.as_found(fit.result)
        if item.compare is not None
    ]
    unseen = unseen_shares(model, [s.log for s in joint.used])
    error = estimate_model_error(list(left_out_logs(folds).values()), others, unseen)
    grid = np.linspace(0.0, 1.0, POINTS)
    open_V = np.sqrt(np.maximum(posterior.ocv_std_V**2 - error.at(grid) ** 2, 0.0))
    left_open = float(np.median(posterior.ln_r_std)) ** 2 - error.shown_share() ** 2
    open_share = math.sqrt(max(left_open, 0.0))
    error = error.with_slow(open_V, math.hypot(open_share, other_share))
    beyond_K = joint.cells.activation_K[1] if joint.grid_C.size > 1 else None
    if joint.grid_C.size == 1 and drive_temperatures(joint.logs) >= NEEDED.fewest:
        # One activation for all of them: colder, another process limits, and may have none or two.
        beyond_K = abs(fit.result.activation_K)
    return replace(error, activation_std_K=beyond_K)


def leave_out(fit: JointFit) -> tuple[Fold, ...]:
    """Residuals of every load at its own rate, of a model that was fitted without it."""
    logs = tuple(
        replace(item, surface=done.surface)
        for item, done in zip(fit.joint.as_found(fit.result), fit.logs, strict=True)
    )
    capacity_Ah = fit.joint.capacity_Ah
    found = []
    for rows in _folds(logs, capacity_Ah):
        kept = [_without(item, rows.get(k), capacity_Ah) for k, item in enumerate(logs)]
        left = [item for item in kept if item is not None]
        result = fit.joint.fit(left, fit.settings, fit.result.theta, quick=QUICK_ITERATIONS)
        model = fit.joint.model_of(result, fit.effects)
        parts = {
            k: residual_log(own_model(model, math.exp(logs[k].ln_sample)), logs[k], part)
            for k, part in rows.items()
        }
        found.append(Fold(rows, parts))
    return tuple(found)


def left_out_logs(folds: Sequence[Fold]) -> dict[int, ResidualLog]:
    """What was left of every log that was left out, its stretches together."""
    parts: dict[int, list[ResidualLog]] = {}
    for fold in folds:
        for k, part in fold.residuals.items():
            parts.setdefault(k, []).append(part)
    return {k: _joined(each) for k, each in parts.items()}


def residual_log(model: CellModel, item: FitLog, rows: BoolArray | None = None) -> ResidualLog:
    """What a model leaves of a log, at the rows given and measured."""
    log = item.log
    if log.temperature_C is None and item.temperature_C is not None:
        log = replace(log, temperature_C=np.full(len(log), item.temperature_C))
    simulation = simulate(model, log, min(max(item.soc0, 0.0), 1.0), item.h0)
    use = np.isfinite(simulation.residual_V) & (simulation.soc >= 0.0)
    use &= item.compare if rows is None and item.compare is not None else True
    use &= True if rows is None else rows
    warm = known_temperature_C(model, log)[use]
    soc = simulation.soc[use]
    drop = polarisation_of(model, soc, warm, simulation.voltage_V[use])
    usual = float(np.median(warm)) if warm.size else 0.0
    return ResidualLog(log.time_s[use], soc, drop, simulation.residual_V[use], usual)


def _joined(parts: Sequence[ResidualLog]) -> ResidualLog:
    """The stretches of one log, in the order of time."""
    order = np.argsort(np.concatenate([p.time_s for p in parts]), kind="stable")

    def of(name: str) -> FloatArray:
        return np.concatenate([getattr(p, name) for p in parts])[order]

    warm = float(np.mean([p.temperature_C for p in parts]))
    return ResidualLog(of("time_s"), of("soc"), of("polarisation_V"), of("residual_V"), warm)


def _folds(logs: Sequence[FitLog], capacity_Ah: float) -> list[dict[int, BoolArray]]:
    """Of each fold the logs left out and the rows of them that are, shape (n,); whether all are."""
    loads = [k for k, item in enumerate(logs) if item.compare is None]
    drives = [k for k in loads if logs[k].skewed]
    if len(drives) > 1:
        turns: dict[int, int] = {}
        folds: list[dict[int, BoolArray]] = [{} for _ in range(MOST_FOLDS)]
        for k in drives:
            warm = round(_warm_C(logs[k]) / SAME_TEMPERATURE_K)
            turn = turns[warm] = turns.get(warm, -1) + 1
            folds[turn % MOST_FOLDS][k] = np.ones(len(logs[k].log), dtype=np.bool_)
        if len(turns) == 1 or max(turns.values()) > 0:
            return [fold for fold in folds if fold]
    if drives and len(loads) > len(drives):
        return [{k: np.ones(len(logs[k].log), dtype=np.bool_)} for k in drives]
    # Where one log is left out the next one is not: no stretch is left out of all. Of a log that
    # moves little the stretches are shorter, so that something stays.
    soc = [logs[k].soc(capacity_Ah) for k in loads]
    most = max((float(np.nanmax(s) - np.nanmin(s)) for s in soc), default=0.0)
    wide = min(STRETCH_SOC, 0.25 * most) or STRETCH_SOC
    stretch = [(np.floor(s / wide) + turn) % 2 for turn, s in enumerate(soc)]
    return [{k: part == odd for k, part in zip(loads, stretch, strict=True)} for odd in (0, 1)]


def _warm_C(item: FitLog) -> float:
    """Median as measured, else what the log is said to be at; 0 where nobody knows."""
    measured = item.log.temperature_C
    known = np.empty(0) if measured is None else measured[np.isfinite(measured)]
    return float(np.median(known)) if known.size else item.temperature_C or 0.0


def _without(item: FitLog, out: BoolArray | None, capacity_Ah: float) -> FitLog | None:
    """A log without the rows left out; None where nothing stays."""
    if out is None:
        return item
    kept = np.isfinite(item.soc(capacity_Ah)) & ~out
    return replace(item, compare=kept) if kept.any() else None
