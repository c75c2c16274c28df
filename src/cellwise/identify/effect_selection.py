"""Sixth station: which effects a cell needs, by the loads that predict what was held out best.

A candidate is fitted beside the plain model to everything that is not held out, and judged on what
is. It is part of the model where it is better there, by more than a share, and surely so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cellwise.cell.effects import Effect, SurfaceSoc
from cellwise.cell.metrics import HeldOutGain, held_out_gain
from cellwise.cell.model import CellModel
from cellwise.fit.capacity import TRIED
from cellwise.fit.model_error import SAME_TEMPERATURE_K
from cellwise.fit.problem import EVIDENCE
from cellwise.fit.rows import FitLog
from cellwise.fit.solve import FitResult
from cellwise.fit.unknowns import ASINH_UNIT_PER_V, FitSettings
from cellwise.identify.identification import Decided, Start
from cellwise.identify.joint_fit import JointLogs
from cellwise.typing import BoolArray, FloatArray, IndexArray


class EffectEvidence(NamedTuple):
    """What an effect must show, and on how much.

    ``gain``: of the held-out RMSE, less is no reason for a parameter; surely so, or with a marginal
    likelihood of what is not held out that is ``ln_evidence`` larger. With fewer drives than
    ``fewest`` none can be held out, and activations of single tables need as many temperatures.
    """

    gain: float = 0.02
    ln_evidence: float = 5.0
    fewest: int = 3


NEEDED = EffectEvidence()
TRIAL_ITERATIONS = 24  # an effect needs its tables moved
MOST_FOLDS = 4
STRETCH_SOC = 0.1  # left out at a time where a log cannot be left out whole
# An electrolyte has half the activation of a reaction: it is not one for all resistances.
OWN_ACTIVATION_STD_K = 1000.0
# How far the surface's SOC lies below the mean at 1C [h], after how long [s], and how that grows
# in the cold [K]: solid diffusion takes minutes and slows down as diffusion coefficients do.
SURFACE = (0.06, EVIDENCE.memory_s, 2500.0)


@dataclass(frozen=True, eq=False)
class JointFit:
    """The fit of all logs, the effects that were tried, and what the model has of them.

    ``logs`` and ``settings`` are those of the fit, the accepted effects in them. ``without_last``:
    a fit without the last of the folds that loads are left out by; None where there was none.
    """

    joint: JointLogs
    result: FitResult
    decided: tuple[Decided, ...]
    effects: tuple[Effect, ...]
    logs: tuple[FitLog, ...]
    settings: FitSettings
    without_last: FitResult | None = None

    @property
    def model(self) -> CellModel:
        """What was made of it."""
        return self.joint.model_of(self.result, self.effects)

    @property
    def starts(self) -> tuple[Start, ...]:
        """Where every log begins, and what the cell of one that keeps its own capacity held."""
        each = range(len(self.logs))
        held = {id(self.logs[k].log): self.result.capacity_scale(k) for k in each}
        soc0 = {id(self.logs[k].log): self.result.start(k)[0] for k in each}
        return tuple(
            s._replace(
                soc0=min(max(soc0.get(id(s.log), s.soc0), 0.0), 1.0),
                capacity_scale=held.get(id(s.log), 1.0),
            )
            for s in self.joint.starts
        )


@dataclass(frozen=True, eq=False)
class _Trial:
    """A fit to what is not held out, and its residuals on what is."""

    settings: FitSettings
    effects: tuple[Effect, ...]
    result: FitResult
    residual_V: FloatArray
    block: IndexArray


class _Split(NamedTuple):
    """Logs with the rows that are left out of each (none: of all others), and what these are."""

    logs: tuple[FitLog, ...]
    out: Mapping[int, BoolArray]
    of: str
    capacity_Ah: float

    def parts(self, effects: Sequence[Effect]) -> tuple[list[FitLog], list[FitLog]]:
        """What is fitted, and what is held out of it."""
        logs = _with_surface(self.logs, effects)
        kept = [without(item, self.out.get(k), self.capacity_Ah) for k, item in enumerate(logs)]
        held = [replace(logs[k], compare=rows) for k, rows in self.out.items() if rows.any()]
        return [item for item in kept if item is not None], held


def fit_with_effects(joint: JointLogs) -> JointFit:
    """Fit all logs with the effects that predict held-out loads better.

    Of the drives of each temperature the last is held out; where there are too few, every other
    stretch of SOC of the other loads: several rates show a charge transfer without any drive, in
    the cold above all.
    """
    first = joint.fit(joint.logs, joint.settings, quick=TRIAL_ITERATIONS)
    found = joint.as_found(first)
    drives = [k for k, item in enumerate(found) if item.skewed]
    if len(drives) >= NEEDED.fewest:
        folds = folds_of(found, joint.capacity_Ah)
        out, candidates = folds[-1], _candidates(joint)
        split = _Split(found, out, f"{len(out)} drive(s)", joint.capacity_Ah)
    else:
        others = [k for k, x in enumerate(found) if x.compare is None and k not in drives]
        out, candidates = stretches_of(found, others, joint.capacity_Ah)[0], ("charge_transfer",)
        split = _Split(found, out, "stretches of the loads", joint.capacity_Ah)
    few = f"not tried: {NEEDED.fewest} drives are needed to hold one out"
    decided = {name: Decided(name, False, None, few) for name in ("charge_transfer", "surface_soc")}
    if not all(split.parts(())):
        result = joint.fit(joint.logs, joint.settings, first.theta)
        result = joint.with_open_capacity(result, joint.logs, joint.settings)
        return JointFit(joint, result, tuple(decided.values()), (), joint.logs, joint.settings)
    best = _tried(joint, split, joint.settings, theta=first.theta)
    # What was refused is tried again once something else was accepted: two may need each other.
    while candidates:
        refused = []
        before = best
        for name in candidates:
            trial = _tried(joint, split, *_changed(name, joint, best))
            # In volts: where a model is most wrong counts most.
            gain = held_out_gain(best.residual_V, trial.residual_V, best.block)
            proof = trial.result.log_evidence - best.result.log_evidence
            surely = gain.low > 0.0 or proof > NEEDED.ln_evidence
            accepted = bool(gain.gain > NEEDED.gain and surely)
            if accepted:
                best = trial
            else:
                refused.append(name)
            if accepted or decided.get(name) is None or decided[name].gain is None:
                decided[name] = _decided(name, gain, accepted, split.of)
        candidates = tuple(refused) if best is not before else ()
    logs = _with_surface(joint.logs, best.effects)
    result = joint.fit(logs, best.settings, best.result.theta)
    result = joint.with_open_capacity(result, logs, best.settings)
    known = joint.settings.ln_capacity_std < TRIED.measured  # else a trial has another capacity
    last = best.result if known and len(drives) >= NEEDED.fewest else None
    return JointFit(joint, result, tuple(decided.values()), best.effects, logs, best.settings, last)


def _with_surface(logs: Sequence[FitLog], effects: Sequence[Effect]) -> tuple[FitLog, ...]:
    surface = next((e for e in effects if isinstance(e, SurfaceSoc)), SurfaceSoc())
    return tuple(replace(item, surface=surface) for item in logs)


def _tried(
    joint: JointLogs,
    split: _Split,
    settings: FitSettings,
    effects: tuple[Effect, ...] = (),
    theta: FloatArray | None = None,
) -> _Trial:
    """A quick fit and its residuals on what is held out."""
    trained, held = split.parts(effects)
    result = joint.fit(trained, settings, theta, quick=TRIAL_ITERATIONS)
    found = joint.residuals(result, held, settings)
    blocks, last = [], 0
    for log, _ in found:
        block = last + (log.time_s // EVIDENCE.memory_s).astype(np.int64)
        last = int(block.max()) + 1
        blocks.append(block)
    residual = np.concatenate([r for _, r in found])
    return _Trial(settings, effects, result, residual, np.concatenate(blocks))


def _decided(name: str, g: HeldOutGain, accepted: bool, held: str) -> Decided:
    """As it is reported."""
    reason = (
        f"RMSE on {held} held out: {1e3 * g.before_V:.1f} mV without, "
        f"{1e3 * g.after_V:.1f} mV with it, {100 * g.low:+.0f} to {100 * g.high:+.0f} % gained"
    )
    if not accepted:
        reason += f"; needed: surely better, and by {100 * NEEDED.gain:.0f} %"
    return Decided(name, accepted, round(g.gain, 4), reason)


def _candidates(joint: JointLogs) -> tuple[str, ...]:
    """Effects that drives can show."""
    several = joint.grid_C.size > 1 or drive_temperatures(joint.logs) < NEEDED.fewest
    return ("temperature_dependence",) * (not several) + ("charge_transfer", "surface_soc")


def _changed(
    name: str, joint: JointLogs, best: _Trial
) -> tuple[FitSettings, tuple[Effect, ...], FloatArray]:
    """Settings, effects and beginning of a trial of one more effect."""
    settings, effects, theta = best.settings, best.effects, best.result.theta.copy()
    if name == "charge_transfer":  # the asinh law of the fast branch
        settings = replace(settings, charge_transfer=True)
        theta[best.result.layout.asinh] = settings.asinh_per_V / ASINH_UNIT_PER_V
    elif name == "temperature_dependence":  # one of each resistance and time constant
        settings = replace(settings, own_activation_std_K=OWN_ACTIVATION_STD_K)
    else:  # tables at the SOC of the particles' surface
        depth_h, tau_s, activation_K = SURFACE
        activation_K *= joint.grid_C.size > 1
        effects = (*effects, SurfaceSoc(depth_h, tau_s, activation_K, joint.reference_C))
    return settings, effects, theta


def folds_of(logs: Sequence[FitLog], capacity_Ah: float) -> list[dict[int, BoolArray]]:
    """Of each fold the logs left out and the rows of them that are, shape (n,).

    Of drives one of every temperature at a time, or one; else stretches of all loads.
    """
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
    return stretches_of(logs, loads, capacity_Ah)


def stretches_of(
    logs: Sequence[FitLog], loads: Sequence[int], capacity_Ah: float
) -> list[dict[int, BoolArray]]:
    """Every other stretch of SOC of some loads, and the others.

    Where one log is left out the next one is not: no stretch is left out of all. Of a log that
    moves little the stretches are shorter, so that something stays.
    """
    soc = [logs[k].soc(capacity_Ah) for k in loads]
    most = max((float(np.nanmax(s) - np.nanmin(s)) for s in soc), default=0.0)
    wide = min(STRETCH_SOC, 0.25 * most) or STRETCH_SOC
    stretch = [(np.floor(s / wide) + turn) % 2 for turn, s in enumerate(soc)]
    return [{k: part == odd for k, part in zip(loads, stretch, strict=True)} for odd in (0, 1)]


def without(item: FitLog, out: BoolArray | None, capacity_Ah: float) -> FitLog | None:
    """A log without the rows left out; None where nothing stays."""
    if out is None:
        return item
    kept = np.isfinite(item.soc(capacity_Ah)) & ~out
    return replace(item, compare=kept) if kept.any() else None


def _warm_C(item: FitLog) -> float:
    """Median as measured, else what the log is said to be at; 0 where nobody knows."""
    measured = item.log.temperature_C
    known = np.empty(0) if measured is None else measured[np.isfinite(measured)]
    return float(np.median(known)) if known.size else item.temperature_C or 0.0


def drive_temperatures(logs: Sequence[FitLog]) -> int:
    """At how many temperatures drives were measured."""
    warm = [item.log.temperature_C for item in logs if item.skewed]
    found = np.sort([float(np.nanmedian(t)) for t in warm if t is not None])
    return int(found.size > 0) + int(np.count_nonzero(np.diff(found) >= SAME_TEMPERATURE_K))
