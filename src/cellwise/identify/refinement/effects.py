"""Which effects a cell needs: those that predict drives better that no fit has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellwise.cell.effects import SelfHeating
from cellwise.cell.metrics import HeldOutGain, held_out_gain
from cellwise.identify.refinement.layout import ASINH_UNIT_PER_V
from cellwise.identify.refinement.problem import RefineSettings, StartTables
from cellwise.identify.refinement.refine import RefineResult, refine, residuals_of
from cellwise.identify.refinement.refine_data import RefineLog, warmed
from cellwise.typing import FloatArray, IndexArray

LEAST_GAIN = 0.02  # of the held-out RMSE: less is not worth a parameter
LEAST_DRIVES = 3  # below, nothing can be held out
QUICK_ROWS = 1500  # compared of one log while effects are compared
QUICK_ITERATIONS = 20
BLOCK_S = 300.0
HEATING_K_PER_W, HEATING_S = (3.0, 8.0), 120.0


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
    """The refinement of all logs, the effects that were tried, and what the model has of them."""

    result: RefineResult
    decided: tuple[Decided, ...]
    heating: SelfHeating | None = None


@dataclass(frozen=True, eq=False)
class _Trial:
    """A refinement of the logs that are not held out, and its residuals on those that are."""

    settings: RefineSettings
    logs: tuple[RefineLog, ...]
    heating: SelfHeating | None
    result: RefineResult
    residual_V: tuple[FloatArray, ...]
    block: IndexArray


class Judge:
    """Fits without and with a candidate, and compares on held-out drives.

    ``how`` is what every refinement is called with.
    """

    def __init__(
        self, logs: Sequence[RefineLog], start: StartTables, held: Sequence[int], **how: Any
    ) -> None:
        self.start, self.held, self.how = start, set(held), how
        self.trained = [k for k in range(len(logs)) if k not in self.held]

    def fit(
        self,
        logs: Sequence[RefineLog],
        settings: RefineSettings,
        theta: FloatArray | None = None,
        most_rows: int | None = None,
    ) -> RefineResult:
        """A refinement."""
        more = {} if most_rows is None else {"most_rows": most_rows}
        return refine(logs, self.start, settings=settings, theta=theta, **more, **self.how)

    def trial(
        self,
        logs: Sequence[RefineLog],
        settings: RefineSettings,
        heating: SelfHeating | None = None,
        theta: FloatArray | None = None,
    ) -> _Trial:
        """A quick refinement and its residuals on the held-out drives."""
        quick = replace(settings, iterations=QUICK_ITERATIONS)
        result = self.fit([logs[k] for k in self.trained], quick, theta, QUICK_ROWS)
        found = residuals_of(result, self.start, [logs[k] for k in sorted(self.held)], settings,
                             self.how["capacity_Ah"], QUICK_ROWS)  # fmt: skip
        blocks, last = [], 0
        for log, _ in found:
            block = last + (log.time_s // BLOCK_S).astype(np.int64)
            last = int(block.max()) + 1
            blocks.append(block)
        return _Trial(settings, tuple(logs), heating, result, tuple(r for _, r in found),
                      np.concatenate(blocks))  # fmt: skip

    def without_and_with(self, name: str, before: _Trial, after: Sequence[_Trial]) -> _Verdict:
        """Whether the best of some trials is better; every log counts by what it was before."""
        size = [float(np.sqrt(np.mean(r * r))) + 1e-12 for r in before.residual_V]
        scaled = np.concatenate([r / s for r, s in zip(before.residual_V, size, strict=True)])
        gains = [
            held_out_gain(
                scaled,
                np.concatenate([r / s for r, s in zip(t.residual_V, size, strict=True)]),
                before.block,
            )
            for t in after
        ]
        best = int(np.argmax([g.gain for g in gains]))
        gain = gains[best]
        accepted = gain.gain > LEAST_GAIN and gain.low > 0.0
        return _Verdict(name, after[best] if accepted else before, gain, accepted)


@dataclass(frozen=True, eq=False)
class _Verdict:
    name: str
    trial: _Trial
    gain: HeldOutGain
    accepted: bool

    def decided(self, held: int) -> Decided:
        """As it is told."""
        g = self.gain
        reason = (
            f"held-out RMSE of {held} drive(s) {100 * g.gain:+.1f} % lower "
            f"({100 * g.low:+.1f} to {100 * g.high:+.1f} %)"
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
        decided = tuple(Decided(n, False, None, why) for n in ("charge_transfer", "self_heating"))
        return Decision(judge.fit(logs, settings), decided)
    best = judge.trial(logs, settings)
    verdicts = []
    theta = best.result.theta.copy()
    theta[best.result.layout.asinh] = start.asinh_per_V / ASINH_UNIT_PER_V
    law = replace(settings, charge_transfer=True)
    verdicts.append(
        judge.without_and_with("charge_transfer", best, [judge.trial(logs, law, theta=theta)])
    )
    best = verdicts[-1].trial
    if any(item.log.temperature_C is not None for item in logs) and grid_C.size > 1:
        trials = []
        for rth in HEATING_K_PER_W:
            warm = [warmed(item, start.ocv, rth, HEATING_S) for item in logs]
            heating = SelfHeating(rth, HEATING_S)
            trials.append(judge.trial(warm, best.settings, heating, best.result.theta))
        verdicts.append(judge.without_and_with("self_heating", best, trials))
        best = verdicts[-1].trial
    result = judge.fit(best.logs, best.settings, best.result.theta)
    return Decision(result, tuple(v.decided(len(held)) for v in verdicts), best.heating)


def held_out(logs: Sequence[RefineLog]) -> tuple[int, ...]:
    """Drives to hold out: the last of every temperature that has two and more."""
    drives = [k for k, item in enumerate(logs) if item.skewed]
    if len(drives) < LEAST_DRIVES:
        return ()
    by_temperature: dict[float | None, list[int]] = {}
    for k in drives:
        by_temperature.setdefault(logs[k].temperature_C, []).append(k)
    return tuple(group[-1] for group in by_temperature.values() if len(group) > 1)
