"""Causes as a user applies them: an extended model, corrected logs, other starts, and the gain.

What a diagnosis says of itself is said in the figures of `simulate`: all rows, every row counts
once, the start that `simulate` takes, the same one for both models. The likelihood forgives what is
correlated, a simulation does not: so causes that leave the held-out rows no better off are not
kept. Whether the extended model is better, in voltage and in the EKF's SOC, is said of logs that
the fit has not seen.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.cell import effects
from cellwise.cell.equations import ZERO_CELSIUS_K
from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.metrics import held_out_gain
from cellwise.cell.model import CellModel
from cellwise.cell.model_error import with_temperature
from cellwise.cell.plausibility.validity import Validity
from cellwise.cell.point_kernels import ENTROPY, OCV, R0, R1, R2, R3, TAU1, TAU2, TAU3, M
from cellwise.cell.simulate import Simulation, simulate
from cellwise.diagnose.causes.catalogue import Cause, kept_coordinates
from cellwise.diagnose.causes.coordinates import (
    CURRENT_NAMES,
    MEASURED_NAMES,
    UNSEEN_NAMES,
    Coordinates,
)
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.coordinate_fit import Fit
from cellwise.diagnose.fit.rows import FITTED, ScoredRows, shifted_current
from cellwise.diagnose.result import LogRun, judged_runs
from cellwise.diagnose.sets import SearchOutcome
from cellwise.estimate.replay import replay
from cellwise.identify.own_logs import joined, log_validity
from cellwise.logs.cell_log import CellLog
from cellwise.wording import arg

# Effects that have tables over the temperatures: made again from the tables of the point.
TABULATED = (effects.SlowDiffusion, effects.Hysteresis, effects.Entropy)


class Gain(NamedTuple):
    """RMSE [V] without and with a cause; ``gain`` is 1 - after / before of the held-out rows."""

    train_rmse_before_V: float
    train_rmse_after_V: float
    holdout_rmse_before_V: float
    holdout_rmse_after_V: float
    gain: float
    gain_ci95: tuple[float, float]


def gain_between(
    evidence: ScoredRows, one: Iterable[Simulation], two: Iterable[Simulation], seed: int
) -> Gain:
    """What one more cause gains; simulations of all logs without and with it.

    Held out are whole logs, else the later blocks of every log. Blocks of time are drawn whole.
    """
    before, after = (np.concatenate([s.residual_V for s in runs]) for runs in (one, two))
    known = np.isfinite(before) & np.isfinite(after)

    def of_rows(scored: Iterable[NDArray[Any]]) -> NDArray[Any]:
        # A row that was thinned away is what the scored row before it is.
        each = zip(scored, evidence.logs, strict=True)
        return np.concatenate([np.repeat(v, g.stride)[: len(g.log)] for v, g in each])

    fitted = of_rows(g.role == FITTED for g in evidence.logs)
    train, held = known & fitted, known & ~fitted
    one_V, two_V = (float(np.sqrt(np.mean(e[train] ** 2))) for e in (before, after))
    if not held.any():
        none = float("nan")
        return Gain(one_V, two_V, none, none, none, (none, none))
    block = of_rows(g.block for g in evidence.logs)[held]
    g = held_out_gain(before[held], after[held], block, seed)
    return Gain(one_V, two_V, g.before_V, g.after_V, g.gain, (g.low, g.high))


def plain_runs(
    model: CellModel,
    fitted: Sequence[tuple[CellLog, InitialSoc]],
    held: Sequence[tuple[CellLog, InitialSoc]] = (),
) -> tuple[LogRun, ...]:
    """Every log, those that are fitted first, with the model as it is."""
    simulated = [(g, simulate(model, g, _inside(start.soc))) for g, start in (*fitted, *held)]
    many = len(fitted)
    return tuple(
        LogRun(g, "fit" if k < many else "holdout", s, s) for k, (g, s) in enumerate(simulated)
    )


def with_own_starts(
    model: CellModel, runs: Sequence[LogRun], evidence: ScoredRows
) -> tuple[LogRun, ...]:
    """The runs with what a new model shows from the starts that it finds itself."""
    found = []
    for run, rows in zip(runs, evidence.logs, strict=True):
        if rows.start.how not in ("given", "stated"):
            own = _inside(initial_soc(model, run.log, whole_log=True).soc)
            if own != run.after.soc0:
                run = replace(run, own_start=simulate(model, run.log, own))
        found.append(run)
    return tuple(found)


def _inside(soc: float) -> float:
    return min(max(float(soc), 0.0), 1.0)


@dataclass(frozen=True, eq=False)
class Applied:
    """Causes, the fit that they are taken from, and every log before and after.

    ``of_log`` are coordinates of the instrument.
    """

    causes: tuple[Cause, ...]
    fit: Fit
    model: CellModel
    of_log: Mapping[str, float]
    runs: tuple[LogRun, ...]
    gain: Gain


def apply(fits: CauseFits, causes: Sequence[Cause], near: Fit, plain: Sequence[LogRun]) -> Applied:
    """The causes applied to all logs, the cell's tolerances at neutral.

    A filter can live with a voltage that is late by up to one interval, so that belongs to the
    model (`TimeSkew`); any other skew is taken out of the log.
    """
    evidence, coordinates = fits.evidence, near.coordinates
    point = fits.point(near, kept_coordinates(causes))
    interval_s = float(np.median(np.concatenate([g.dt_s[1:] for g in evidence.logs])))
    of_cell = 0.0 <= coordinates.inputs(point).skew_s <= interval_s
    of_model, of_log = (
        {n: v for n, v in point.items() if n != "skew_s" or own} for own in (of_cell, not of_cell)
    )
    model = extend_model(coordinates, of_model, {"causes": [c.name for c in causes]})
    old_ocv_V = coordinates.model.ocv_V
    moved = not np.array_equal(model.ocv_V, old_ocv_V) or point.get("m_V", 0.0) != 0.0
    starts = starts_with({c.kind for c in causes}, moved, near.z, [g.start for g in evidence.logs])
    runs = []
    for k, run in enumerate(plain):
        seen = None
        if starts is not None:
            seen = simulate(model, correct_log(run.log, of_log, k), starts[k])
        runs.append(replace(run, after=simulate(model, run.log, run.before.soc0), corrected=seen))
    before, after = [r.before for r in runs], [r.explained for r in runs]
    gain = gain_between(evidence, before, after, fits.seed)
    return Applied(tuple(causes), near, model, of_log, tuple(runs), gain)


def starts_with(
    kinds: set[str], ocv_moved: bool, z: Mapping[str, float], starts: Sequence[InitialSoc]
) -> tuple[float, ...] | None:
    """Where every log starts once causes of these kinds are known; None: where it did.

    Starts that were given stay, unless a cause is one. A rest is read through the OCV: where that
    has ``ocv_moved``, by a hysteresis or otherwise, it says another SOC. Where the model alone is
    corrected, only those move that all of the log had chosen with the model as it was.
    """

    def stays(start: InitialSoc) -> bool:
        if "start" in kinds:
            return False
        if "measurement" in kinds or ocv_moved:
            return start.how in ("given", "stated")
        return start.beginning is None

    if all(map(stays, starts)) and not {"measurement", "start"} & kinds:
        return None
    return tuple(
        s.soc if stays(s) else _inside(s.soc + z.get(f"soc0:{k}", 0.0))
        for k, s in enumerate(starts)
    )


def applied(fits: CauseFits, outcome: SearchOutcome, plain: Sequence[LogRun]) -> Applied | None:
    """The accepted causes applied, without those that leave held-out rows no better off.

    The last first; None where nothing is left. What is of one fitted log alone moves no other, and
    is judged there.
    """
    causes, near = list(outcome.causes), outcome.fit
    while causes:
        found = apply(fits, causes, near, plain)
        train_V, train_after_V, held_V, held_after_V, *_ = found.gain
        alone = all(c.log is not None for c in causes) and train_after_V < train_V
        if held_after_V < held_V or (alone and held_after_V == held_V):
            return found
        causes.pop()
        if causes:
            near = fits.fit_causes(causes, near, outcome.scale)
    return None


def soc_gain(
    known: Applied, old: CellModel, extended: CellModel, stated_Ah: float | None
) -> tuple[dict[str, Any] | None, str]:
    """SOC RMSE [1] of the EKF with the model as it was and as it is now.

    Of several logs the one that loses most, where one loses; else the first. The referee is the
    tester's own counter over a capacity that the diagnosis did not estimate (``stated_Ah``, else
    the model file's), from a start that it did not estimate: else what is to be judged would judge
    itself.

    Returns
    -------
    dict or None      ``log``, ``soc_rmse_before``, ``soc_rmse_after``, ``reference_capacity_Ah``,
                      ``reference``
    str               why there is none; empty if there is
    """
    named = {c.name for c in known.causes}
    if "initial_soc" in named:
        return None, "the initial SOC is one of the causes, so no SOC is known"
    if stated_Ah is None and "capacity" in named:
        return None, (
            "the capacity is one of the causes, and a SOC over it would prove itself; "
            "state one that was measured (" + arg("reference_capacity_Ah", letter="X") + ")"
        )
    choice = old.provenance.get("capacity", {})
    how = choice.get("choice", "") if isinstance(choice, dict) else ""
    source = f"the model's own ({how or 'as its file says'})" if stated_Ah is None else "stated"
    reference_Ah = old.capacity_Ah if stated_Ah is None else float(stated_Ah)
    gains: list[dict[str, Any]] = []
    why = ""
    for run in judged_runs(known.runs):
        name, start, errors = run.log.name or "the log", run.before.soc0, []
        if run.log.charge_Ah is None:
            why = why or f"{name} has no counter of the tester"
            continue
        for cell, seen in ((old, run.log), (extended, run.explained.log)):
            errors.append(
                replay(
                    cell, seen, "ekf", soc0=start, reference_soc0=start,
                    reference_capacity_Ah=reference_Ah,
                ).errors
            )  # fmt: skip
        if None in errors:
            why = why or f"the counter does not cover {name}"
            continue
        before, after = (e.rmse for e in errors if e is not None)
        gains.append(
            {
                "log": run.log.name,
                "soc_rmse_before": before,
                "soc_rmse_after": after,
                "reference_capacity_Ah": reference_Ah,
                "reference": source,
            }
        )
    if not gains:
        return None, why
    worst = max(gains, key=lambda g: g["soc_rmse_after"] - g["soc_rmse_before"])
    return (worst if worst["soc_rmse_after"] > worst["soc_rmse_before"] else gains[0]), ""


def extend_model(
    coordinates: Coordinates, z: Mapping[str, float], note: Mapping[str, Any]
) -> CellModel:
    """The model with everything of a point that belongs to the cell, and the sampling delay."""
    model = coordinates.model
    cell = {n: v for n, v in z.items() if n not in MEASURED_NAMES and ":" not in n}
    inputs = coordinates.inputs({**cell, "skew_s": z.get("skew_s", 0.0)})
    t, s = inputs.table, inputs.scalars
    grid = inputs.grid
    if not any(cell.get(n, 0.0) for n in UNSEEN_NAMES):
        seen = np.isin(grid, model.temperature_C)
        t, grid = t[seen], grid[seen]
    ocv = np.maximum.accumulate(t[..., OCV], axis=1)
    tau1 = np.minimum(t[..., TAU1], 0.99 * t[..., TAU2])
    new = replace(
        model,
        temperature_C=grid,
        effects=tuple(e for e in model.effects if not isinstance(e, TABULATED)),
        capacity_Ah=s.charge_As / 3600.0,
        ocv_V=ocv,
        r0_ohm=t[..., R0],
        r1_ohm=t[..., R1],
        tau1_s=tau1,
        r2_ohm=t[..., R2],
        tau2_s=t[..., TAU2],
        provenance={**model.provenance, "diagnosed": dict(note)},
    )
    if coordinates.has_slow or np.any(t[..., R3] > 0.0):
        new = new.with_effect(effects.SlowDiffusion(np.maximum(t[..., R3], 0.0), t[..., TAU3]))
    if np.any(t[..., M]):
        new = new.with_effect(effects.Hysteresis(t[..., M], s.hysteresis_rate))
    if s.activation_K != 0.0 or s.branch_activation != 0.0:
        own = model.effect(effects.TemperatureDependence)
        of_branches = {
            f"{b}_K": getattr(s, f"{b}_activation_K") for b in effects.BRANCH_ACTIVATIONS
        }
        new = new.with_effect(replace(own, activation_K=s.activation_K, **of_branches))
    if np.any(t[..., ENTROPY]):
        new = new.with_effect(effects.Entropy(t[..., ENTROPY], s.entropy_K - ZERO_CELSIUS_K))
    if s.rate_per_A != 0.0:
        least = effects.RateDependence.bounds["rate_h"][0]  # by rounding it may lie beyond
        new = new.with_effect(effects.RateDependence(max(s.rate_per_A * new.capacity_Ah, least)))
    if s.surface_per_A != 0.0:
        own_surface = model.effect(effects.SurfaceSoc)
        depth = s.surface_per_A * new.capacity_Ah
        new = new.with_effect(replace(own_surface, depth_h=depth, tau_s=s.surface_s))
    if s.asinh_per_V > 0.0:
        new = new.with_effect(effects.ChargeTransfer(s.asinh_per_V))
    if s.charge_scale != 1.0:
        new = new.with_effect(effects.ChargeAsymmetry(s.charge_scale))
    if s.heating_K_per_W > 0.0:
        new = new.with_effect(effects.SelfHeating(s.heating_K_per_W, s.heating_s))
    if s.leak_A > 0.0:
        new = new.with_effect(effects.SelfDischarge(s.leak_A))
    if inputs.skew_s > 0.0:
        new = new.with_effect(effects.TimeSkew(min(inputs.skew_s, 60.0)))
    return new


def extended_validity(model: CellModel, logs: Sequence[CellLog], soc0: Sequence[float]) -> Validity:
    """Where the model is valid once it has explained these logs, too.

    Parameters
    ----------
    logs : sequence of CellLog      corrected
    soc0 : sequence of float        SOC at the first row of each
    """
    if not model.validity.known:
        return model.validity
    starts = (min(max(s, 0.0), 1.0) for s in soc0)
    parts = [
        log_validity(log, simulate(model, log, start).soc)
        for log, start in zip(logs, starts, strict=True)
    ]
    return model.validity.extended(joined(parts))


def with_error_at(model: CellModel, temperature_C: float, times: float) -> CellModel:
    """The model stating so many times the error that it stated at a temperature."""
    error = model.error
    for t in model.temperature_C if not error.temperature_C else ():
        error = with_temperature(error, float(t), 1.0)
    return replace(model, error=with_temperature(error, temperature_C, times))


def correct_log(log: CellLog, z: Mapping[str, float], number: int) -> CellLog:
    """The log without what belongs to the instrument: offset, gain, voltage offset, skew.

    ``number`` is its place among all logs. The model's own sampling delay stays in the model; one
    that was found is removed here.
    """
    offset_V = z.get("offset_V", 0.0) + z.get(f"offset_V:{number}", 0.0)
    if not (offset_V or any(z.get(n, 0.0) for n in CURRENT_NAMES)):
        return log
    known = log.known_current_A()
    shifted = shifted_current(log.time_s, log.interval_s, known, z.get("skew_s", 0.0))
    current = (shifted - z.get("offset_A", 0.0)) / math.exp(z.get("ln_gain", 0.0))
    current[~np.isfinite(log.current_A)] = np.nan
    return replace(log, current_A=current, voltage_V=log.voltage_V - offset_V)
