"""Which effects a cell needs: those that predict drives better that no fit has seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellwise.cell.effects import Effect, SelfHeating, SurfaceSoc
from cellwise.cell.metrics import HeldOutGain, held_out_gain
from cellwise.identify.refinement.layout import ASINH_UNIT_PER_V
from cellwise.identify.refinement.model_error import SAME_TEMPERATURE_K
from cellwise.identify.refinement.problem import RefineSettings, StartTables
from cellwise.identify.refinement.refine import RefineResult, refine, residuals_of
from cellwise.identify.refinement.refine_data import RefineLog, warmed
from cellwise.typing import BoolArray, FloatArray, IndexArray

TRIED = ("charge_transfer", "surface_soc", "self_heating")
LEAST_GAIN = 0.02  # of the held-out RMSE: less is not worth a parameter
LEAST_DRIVES = 3  # below, nothing can be held out
LEAST_LOADS = 3  # of one temperature, where drives are too few
LEAST_TEMPERATURES = 2  # with so many loads: at one, tests and drives are what the tables are of
QUICK_ROWS = 800  # compared of one log while effects are compared
QUICK_ITERATIONS = 12
BLOCK_S = 120.0
SOC_PARTS = 10
LOADED = 0.02  # of the largest current
FAST_S = 0.2  # time constant from which the law is fitted where R0 holds a part of it
# An electrolyte has half the activation of a reaction: it is not one for all resistances.
OWN_ACTIVATION_STD_K = 1000.0
LEAST_OF_ACTIVATIONS = 3  # temperatures: at two, tables that are off look like activations
HEATING_K_PER_W, HEATING_S = 3.0, 120.0
# How far the surface's SOC is tried to lie below the mean at 1C, and what goes with it: solid
# diffusion takes minutes and slows down in the cold as usual diffusion coefficients do.
SURFACE_H, SURFACE_S, SURFACE_ACTIVATION_K = (0.06, 0.12), 300.0, 2500.0


@dataclass(frozen=True)
class Decided:
    """An effect that was tried: whether the model has it, its gain on held-out drives, and why."""

    name: str
    accepted: bool
    gain: float | None
    reason: str

    def to_dict(self) -> dict[str, Any]:
        """As the command prints it."""
        return vars(self)


@dataclass(frozen=True, eq=False)
class Decision:
    """The refinement of all logs, the effects that were tried, and what the model has of them.

    ``logs`` and ``settings`` are those of the refinement, the accepted effects in them.
    """

    result: RefineResult
    decided: tuple[Decided, ...]
    effects: tuple[Effect, ...]
    logs: tuple[RefineLog, ...]
    settings: RefineSettings


@dataclass(frozen=True, eq=False)
class _Trial:
    """A refinement of the logs that are not held out, and its residuals on those that are."""

    settings: RefineSettings
    logs: tuple[RefineLog, ...]
    effects: tuple[Effect, ...]
    result: RefineResult
    residual_V: tuple[FloatArray, ...]
    block: IndexArray


class Judge:
    """Fits without and with a candidate, and compares on held-out drives.

    ``how`` is what every refinement is called with.
    """

    def __init__(
        self,
        logs: Sequence[RefineLog],
        start: StartTables,
        held: Sequence[int],
        *,
        iterations: int = QUICK_ITERATIONS,
        **how: Any,
    ) -> None:
        self.start, self.held, self.how, self.iterations = start, set(held), how, iterations
        self.trained = [k for k in range(len(logs)) if k not in self.held]

    def fit(
        self,
        logs: Sequence[RefineLog],
        settings: RefineSettings,
        theta: FloatArray | None = None,
        most_rows: int | None = None,
    ) -> RefineResult:
        """A refinement."""
        return refine(
            logs, self.start, settings=settings, theta=theta, most_rows=most_rows,
            with_errors=most_rows is None, **self.how,
        )  # fmt: skip

    def trial(
        self,
        logs: Sequence[RefineLog],
        settings: RefineSettings,
        effects: tuple[Effect, ...] = (),
        theta: FloatArray | None = None,
    ) -> _Trial:
        """A quick refinement and its residuals on what is held out."""
        quick = replace(settings, iterations=self.iterations)
        result = self.fit([logs[k] for k in self.trained], quick, theta, QUICK_ROWS)
        found = residuals_of(result, self.start, [logs[k] for k in sorted(self.held)], settings,
                             self.how["capacity_Ah"], QUICK_ROWS)  # fmt: skip
        blocks, last = [], 0
        for log, _ in found:
            block = last + (log.time_s // BLOCK_S).astype(np.int64)
            last = int(block.max()) + 1
            blocks.append(block)
        return _Trial(settings, tuple(logs), effects, result, tuple(r for _, r in found),
                      np.concatenate(blocks))  # fmt: skip

    def without_and_with(self, name: str, before: _Trial, after: _Trial) -> _Verdict:
        """Whether a trial is surely better, in volts: where a model is most wrong counts most."""
        gain = held_out_gain(
            np.concatenate(before.residual_V), np.concatenate(after.residual_V), before.block
        )
        accepted = gain.gain > LEAST_GAIN and gain.low > 0.0
        return _Verdict(name, after if accepted else before, gain, accepted)


@dataclass(frozen=True, eq=False)
class _Verdict:
    name: str
    trial: _Trial
    gain: HeldOutGain
    accepted: bool

    def decided(self, held: str) -> Decided:
        """As it is reported."""
        g = self.gain
        reason = (
            f"RMSE on {held} held out: {1e3 * g.before_V:.1f} mV without, "
            f"{1e3 * g.after_V:.1f} mV with it, {100 * g.low:+.0f} to {100 * g.high:+.0f} % gained"
        )
        if not self.accepted:
            reason += f"; needed: surely better, and by {100 * LEAST_GAIN:.0f} %"
        return Decided(self.name, self.accepted, round(g.gain, 4), reason)


def decide(
    logs: Sequence[RefineLog],
    start: StartTables,
    settings: RefineSettings,
    capacity_Ah: float,
    reference_C: float,
    grid_C: FloatArray,
) -> Decision:
    """Fit all logs with the effects that predict held-out drives better.

    Of the drives of each temperature that has several one is held out; the other logs are refined
    without and with each candidate. What gains more than LEAST_GAIN, surely, stays; then
    everything is refined.
    """
    held = held_out(logs)
    judge = Judge(logs, start, held, capacity_Ah=capacity_Ah, reference_C=reference_C,
                  grid_C=grid_C)  # fmt: skip
    if not held:
        drives = sum(item.skewed for item in logs)
        why = f"not tried: {drives} drive(s), {LEAST_DRIVES} are needed to hold one out"
        decided = tuple(Decided(n, False, None, why) for n in TRIED)
        return _by_pulses(Decision(judge.fit(logs, settings), decided, (), tuple(logs), settings),
                          judge)  # fmt: skip
    best = judge.trial(logs, settings)
    last: dict[str, _Verdict] = {}
    candidates = _candidates(reference_C, grid_C.size > 1)
    if grid_C.size == 1 and _temperatures(logs) >= LEAST_OF_ACTIVATIONS:
        candidates = {"temperature_dependence": (_own_activations,), **candidates}
    # What was refused is tried again once something else was accepted: two may need each other.
    while candidates:
        refused = {}
        before = best
        for name, changes in candidates.items():
            for change in changes:
                verdict = judge.without_and_with(name, best, change(judge, best))
                if verdict.accepted or name not in last:
                    last[name] = verdict
                best = verdict.trial
                if not verdict.accepted:
                    break
            if not last[name].accepted:
                refused[name] = changes
        candidates = refused if best is not before and len(refused) < len(candidates) else {}
    result = judge.fit(best.logs, best.settings, best.result.theta)
    decided = tuple(v.decided(f"{len(held)} drive(s)") for v in last.values())
    return Decision(result, decided, best.effects, best.logs, best.settings)


def _by_pulses(without: Decision, judge: Judge) -> Decision:
    """Whether pulses need the asinh law: it must predict those that were held out.

    Pulses of several rates at one SOC show it without any drive, in the cold above all.
    """
    split, held = _without_pulses(without.logs)
    if not held:
        return without
    trials = Judge(split, judge.start, held, iterations=without.settings.iterations, **judge.how)
    best = trials.trial(split, without.settings, theta=without.result.theta)
    starts = _asinh_starts(without.result, judge.start)
    verdicts = [
        trials.without_and_with(TRIED[0], best, _transfer(trials, best, theta)) for theta in starts
    ]
    verdict = max(verdicts, key=lambda v: v.gain.low)
    decided = (
        verdict.decided("every second load of the pulse tests"),
        *without.decided[1:],
    )
    if not verdict.accepted:
        return replace(without, decided=decided)
    settings = verdict.trial.settings
    results = [
        judge.fit(without.logs, settings, theta) for theta in (verdict.trial.result.theta, *starts)
    ]
    result = min(results, key=lambda r: float(np.mean(np.square(r.rmse_V))))
    return Decision(result, decided, (), without.logs, settings)


def _without_pulses(logs: Sequence[RefineLog]) -> tuple[list[RefineLog], list[int]]:
    """The logs without every second load of the pulse tests, and the numbers of those beside."""
    split, beside = [], []
    for item in logs:
        if item.skewed or item.compare is not None:
            split.append(item)
            continue
        left = _every_second_load(item)
        if left.all() or not left.any():
            split.append(item)
            continue
        split.append(replace(item, compare=~left))
        beside.append(replace(item, compare=left))
    return [*split, *beside], list(range(len(split), len(split) + len(beside)))


def _every_second_load(item: RefineLog) -> BoolArray:
    """Rows of every second load and the rest after it, from one tenth of SOC to the next in turn.

    In turn, or else of two pulses at every SOC the same one would be held out.
    """
    current_A = item.log.known_current_A()
    side = np.sign(np.where(np.abs(current_A) > LOADED * np.max(np.abs(current_A)), current_A, 0.0))
    begins = (side != 0.0) & (np.diff(side, prepend=0.0) != 0.0)
    turn = np.cumsum(begins) + np.floor(item.soc * SOC_PARTS).astype(np.int64)
    return np.asarray(turn % 2 == 1, dtype=np.bool_)


Change = Callable[[Judge, _Trial], _Trial]


def _asinh_starts(result: RefineResult, start: StartTables) -> tuple[FloatArray, FloatArray]:
    """From where the law is fitted: the tables as they are, or half of R0 in the fast branch.

    Where the reaction is faster than the rows are apart, a linear fit has put it into R0, and from
    there the time constant is minutes of fitting away.
    """
    lay, theta = result.layout, result.theta.copy()
    theta[lay.asinh] = start.asinh_per_V / ASINH_UNIT_PER_V
    r0, r1, tau1 = (slice(at, at + lay.block) for at in (lay.r0, lay.r(0), lay.tau(0)))
    shared = theta.copy()
    half = theta[r0] - np.log(2.0)
    shared[r0], shared[r1] = half, np.logaddexp(theta[r1], half)
    shared[tau1] = np.log(FAST_S)
    return theta, shared


def _transfer(judge: Judge, best: _Trial, theta: FloatArray | None = None) -> _Trial:
    """The asinh law of the fast branch."""
    if theta is None:
        theta = best.result.theta.copy()
        theta[best.result.layout.asinh] = judge.start.asinh_per_V / ASINH_UNIT_PER_V
    law = replace(best.settings, charge_transfer=True)
    return judge.trial(best.logs, law, best.effects, theta)


def _own_activations(judge: Judge, best: _Trial) -> _Trial:
    """Beside the common activation one of each resistance and time constant."""
    freed = replace(best.settings, own_activation_std_K=OWN_ACTIVATION_STD_K)
    return judge.trial(best.logs, freed, best.effects, best.result.theta)


def _temperatures(logs: Sequence[RefineLog]) -> int:
    """At how many temperatures drives were measured."""
    warm = [item.log.temperature_C for item in logs if item.skewed]
    found = np.sort([float(np.nanmedian(t)) for t in warm if t is not None])
    return int(found.size > 0) + int(np.count_nonzero(np.diff(found) >= SAME_TEMPERATURE_K))


def _candidates(reference_C: float, several: bool) -> dict[str, tuple[Change, ...]]:
    """Changes to a trial by the effect's name; of several sizes one after another."""

    def surface(depth_h: float) -> Change:
        activation = SURFACE_ACTIVATION_K if several else 0.0
        effect = SurfaceSoc(depth_h, SURFACE_S, activation, reference_C)

        def change(judge: Judge, best: _Trial) -> _Trial:
            logs = [replace(item, surface=effect) for item in best.logs]
            others = tuple(e for e in best.effects if e.name != effect.name)
            return judge.trial(logs, best.settings, (*others, effect), best.result.theta)

        return change

    def heating(judge: Judge, best: _Trial) -> _Trial:
        effect = SelfHeating(HEATING_K_PER_W, HEATING_S)
        ocv = judge.start.ocv
        logs = [warmed(item, ocv, effect.rth_K_per_W, effect.thermal_s) for item in best.logs]
        return judge.trial(logs, best.settings, (*best.effects, effect), best.result.theta)

    found: dict[str, tuple[Change, ...]] = {
        "charge_transfer": (_transfer,),
        "surface_soc": tuple(surface(h) for h in SURFACE_H),
    }
    return found | ({"self_heating": (heating,)} if several else {})


def held_out(logs: Sequence[RefineLog]) -> tuple[int, ...]:
    """Logs to hold out: the last drive of every temperature that has two and more.

    Where no temperature has two, every second drive by temperature. Where drives are too few, one
    discharge of every temperature that has three and more loads, in turn of another rate.
    """
    drives = [k for k, item in enumerate(logs) if item.skewed]
    if len(drives) >= LEAST_DRIVES:
        groups = _by_temperature(logs, drives)
        found = tuple(g[-1] for g in groups.values() if len(g) > 1)
        return found or tuple(groups[t][0] for t in sorted(groups, key=lambda t: t or 0.0)[1::2])
    steady = [k for k, item in enumerate(logs) if not item.skewed and item.weight >= 1.0]
    rates = {k: float(np.max(logs[k].log.known_current_A())) for k in steady}
    groups = _by_temperature(logs, [*drives, *steady])
    several = [sorted(set(g) - set(drives), key=rates.__getitem__) for g in groups.values()]
    several = [g for g, all_ in zip(several, groups.values(), strict=True)
               if len(all_) >= LEAST_LOADS and len(g) > 1]  # fmt: skip
    if len(several) < LEAST_TEMPERATURES:
        return ()
    return tuple(g[-1 - turn % 2] for turn, g in enumerate(several))


def _by_temperature(
    logs: Sequence[RefineLog], which: Sequence[int]
) -> dict[float | None, list[int]]:
    """Numbers of the logs of every temperature."""
    found: dict[float | None, list[int]] = {}
    for k in which:
        found.setdefault(logs[k].temperature_C, []).append(k)
    return found
