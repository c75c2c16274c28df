"""Station "effects": which effects a cell needs, by the loads that predict what was held out best.

A candidate is fitted beside the plain model to everything that is not held out, and judged on what
is. It is part of the model where it is better there, by more than a share, and surely so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cellwise.cell.effects import Effect, SurfaceSoc
from cellwise.cell.metrics import HeldOutGain, held_out_gain
from cellwise.cell.model import CellModel
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
    ``fewest`` none can be held out; as many loads of one temperature at ``temperatures`` of them do
    as well, and activations of single tables need as many temperatures.
    """

    gain: float = 0.02
    ln_evidence: float = 5.0
    fewest: int = 3
    temperatures: int = 2


NEEDED = EffectEvidence()
TRIAL_ITERATIONS = 24  # an effect needs its tables moved
SOC_PARTS = 10  # pulses are held out by tenths of the SOC in turn
LOADED = 0.02  # of the largest current
# An electrolyte has half the activation of a reaction: it is not one for all resistances.
OWN_ACTIVATION_STD_K = 1000.0
# How far the surface's SOC lies below the mean at 1C [h], after how long [s], and how that grows
# in the cold [K]: solid diffusion takes minutes and slows down as diffusion coefficients do.
SURFACE = (0.06, EVIDENCE.memory_s, 2500.0)


@dataclass(frozen=True, eq=False)
class JointFit:
    """The fit of all logs, the effects that were tried, and what the model has of them.

    ``logs`` and ``settings`` are those of the fit, the accepted effects in them.
    """

    joint: JointLogs
    result: FitResult
    decided: tuple[Decided, ...]
    effects: tuple[Effect, ...]
    logs: tuple[FitLog, ...]
    settings: FitSettings

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
    """Logs with the numbers of those that are held out, what these are, and steps of a trial."""

    logs: tuple[FitLog, ...]
    held: frozenset[int]
    of: str
    steps: int


def fit_with_effects(joint: JointLogs) -> JointFit:
    """Fit all logs with the effects that predict held-out loads better.

    Of the drives of each temperature that has several one is held out; where there are too few,
    every second load of the pulse tests: several rates at one SOC show a charge transfer without
    any drive, in the cold above all.
    """
    first = joint.fit(joint.logs, joint.settings, quick=TRIAL_ITERATIONS)
    found = joint.as_found(first)
    held = frozenset(held_out(found))
    split = _Split(found, held, f"{len(held)} drive(s)", TRIAL_ITERATIONS)
    candidates = _candidates(joint)
    if not held:
        split = _without_pulses(found, TRIAL_ITERATIONS, joint.capacity_Ah)
        candidates = ("charge_transfer",)
    few = f"not tried: {NEEDED.fewest} drives are needed to hold one out"
    decided = {name: Decided(name, False, None, few) for name in ("charge_transfer", "surface_soc")}
    if not split.held:
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
    return JointFit(joint, result, tuple(decided.values()), best.effects, logs, best.settings)


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
    logs = _with_surface(split.logs, effects)
    trained = [item for k, item in enumerate(logs) if k not in split.held]
    result = joint.fit(trained, settings, theta, quick=split.steps)
    found = joint.residuals(result, [logs[k] for k in sorted(split.held)], settings)
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


def _without_pulses(logs: Sequence[FitLog], steps: int, capacity_Ah: float) -> _Split:
    """The logs without every second load of the pulse tests, and these loads beside them."""
    split, beside = [], []
    for item in logs:
        left = np.zeros(0, dtype=np.bool_)
        if not item.skewed and item.compare is None:
            left = every_second_load(item, capacity_Ah)
        if left.all() or not left.any():
            split.append(item)
        else:
            split.append(replace(item, compare=~left))
            beside.append(replace(item, compare=left))
    held = frozenset(range(len(split), len(split) + len(beside)))
    return _Split((*split, *beside), held, "every second load of the pulse tests", steps)


def every_second_load(item: FitLog, capacity_Ah: float) -> BoolArray:
    """Rows of every second load and the rest after it, from one tenth of SOC to the next in turn.

    In turn, or else of two pulses at every SOC the same one would be held out.
    """
    current_A = item.log.known_current_A()
    side = np.sign(np.where(np.abs(current_A) > LOADED * np.max(np.abs(current_A)), current_A, 0.0))
    begins = (side != 0.0) & (np.diff(side, prepend=0.0) != 0.0)
    turn = np.cumsum(begins) + np.floor(item.soc(capacity_Ah) * SOC_PARTS).astype(np.int64)
    return np.asarray(turn % 2 == 1, dtype=np.bool_)


def drive_temperatures(logs: Sequence[FitLog]) -> int:
    """At how many temperatures drives were measured."""
    warm = [item.log.temperature_C for item in logs if item.skewed]
    found = np.sort([float(np.nanmedian(t)) for t in warm if t is not None])
    return int(found.size > 0) + int(np.count_nonzero(np.diff(found) >= SAME_TEMPERATURE_K))


def held_out(logs: Sequence[FitLog]) -> tuple[int, ...]:
    """Logs to hold out: the last drive of every temperature that has two and more.

    Where no temperature has two, every second drive by temperature. Where drives are too few, one
    discharge of every temperature that has three and more loads, in turn of another rate.
    """
    drives = [k for k, item in enumerate(logs) if item.skewed]
    if len(drives) >= NEEDED.fewest:
        groups = _by_temperature(logs, drives)
        found = tuple(g[-1] for g in groups.values() if len(g) > 1)
        return found or tuple(groups[t][0] for t in sorted(groups, key=lambda t: t or 0.0)[1::2])
    steady = [k for k, item in enumerate(logs) if not item.skewed and not item.low_rate]
    rates = {k: float(np.max(logs[k].log.known_current_A())) for k in steady}
    groups = _by_temperature(logs, [*drives, *steady])
    several = [sorted(set(g) - set(drives), key=rates.__getitem__) for g in groups.values()]
    several = [g for g, all_ in zip(several, groups.values(), strict=True)
               if len(all_) >= NEEDED.fewest and len(g) > 1]  # fmt: skip
    if len(several) < NEEDED.temperatures:
        return ()
    return tuple(g[-1 - turn % 2] for turn, g in enumerate(several))


def _by_temperature(logs: Sequence[FitLog], which: Sequence[int]) -> dict[float | None, list[int]]:
    """Numbers of the logs of every temperature."""
    found: dict[float | None, list[int]] = {}
    for k in which:
        found.setdefault(logs[k].temperature_C, []).append(k)
    return found
