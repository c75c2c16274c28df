"""The judge: which causes are accepted, in which order, and when it must leave it open."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from cellwise.diagnose.acceptance import (
    AGED_GAIN,
    LEAST_SCORE,
    SIMPLER,
    immaterial,
    likelier_first,
    rivals_of,
    unphysical,
)
from cellwise.diagnose.causes import Cause
from cellwise.diagnose.coordinates import Coordinates
from cellwise.diagnose.evidence import IGNORED, Evidence
from cellwise.diagnose.fit import Fit, Frozen, Objective, Prior, complete, fit, freeze
from cellwise.diagnose.judgement import Accepted, Judgement, kept_coordinates
from cellwise.diagnose.noise import Noise, at_least, estimate_noise, log_scales
from cellwise.diagnose.prediction import Prediction, predict
from cellwise.diagnose.priors import USUAL_ACTIVATION_K, freed, needs_activation, shapes_to_try
from cellwise.diagnose.rest_reading import RestReading
from cellwise.diagnose.rivals import (
    Candidate,
    Gain,
    clearly_ahead,
    gain_of,
    held_interval_low,
)
from cellwise.diagnose.whitening_kernels import NoiseLevel
from cellwise.typing import BoolArray, FloatArray

Progress = Callable[[float, str], None]

MOST_CAUSES = 5
FINALISTS = 5
# The search begins with a noise that is forgiving at once and firm in the long run, so that what
# drifts is not taken for noise before any cause was tried.
FIRM_SLOW_V = 1e-3
# From this ratio on logs are not alike in what they leave.
LOGS_DIFFER = 1.15


@dataclass(eq=False)
class Judge:
    """One diagnosis at work; :meth:`run` gives the :class:`Judgement`.

    ``floor`` is a noise below which nothing counts; ``most_slow_V`` is the slow error that the
    model owns up to: what lasts and is larger is to be explained, or noise would explain all.
    ``rest`` is what the log reads at rest, ``foreign`` whether its temperature is not the model's.
    """

    evidence: Evidence
    coordinates: Coordinates
    seed: int
    prior: Prior
    floor: NoiseLevel
    most_slow_V: float
    rest: RestReading
    foreign: bool = False
    progress: Progress | None = None
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    rng: np.random.Generator = field(init=False)
    _said: float = field(default=0.0)
    _accepted: list[Accepted] = field(default_factory=list)
    _amplitude: FloatArray = field(default_factory=lambda: np.ones(1))

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)

    def run(self, causes: Sequence[Cause], base: Fit, noise: Noise) -> Judgement:
        """Accept causes one by one on top of the :meth:`base` until nothing is left to explain."""
        accepted = self._accepted
        accepted.clear()
        prior = self.prior
        plain_base = base
        first: tuple[Candidate, ...] = ()
        between: tuple[Candidate, ...] = ()
        reasons: list[str] = []
        cleared: set[str] = set()
        for turn in range(MOST_CAUSES):
            left = [c for c in causes if c.name not in {a.cause.name for a in accepted} | cleared]
            if not left:
                break
            ranked = self._rank(left, prior, base, noise, turn)
            first = first or ranked
            aged = self._is_age(ranked, prior, base, noise)
            if aged:
                cleared.add("current_gain")
                ranked = tuple(sorted(ranked[1:], key=lambda c: (c.name != "capacity", -c.score)))
            ranked, gain, refused = self._material(ranked, prior, base, accepted)
            if gain is None:
                reasons += refused
                break
            best = ranked[0]
            rivals = () if aged else rivals_of(ranked, self.evidence, self.foreign)
            if rivals and not self._both_needed(best, rivals, prior):
                between = (best, *rivals)
                ahead = self._ahead(between, accepted)
                if ahead is None:
                    break
                best, between = between[ahead], ()
                gain = self._gain(best, base, accepted)[0]
            accepted.append(
                Accepted(best.cause, gain, best.score, tuple(c.name for c in ranked[1:3]))
            )
            prior = freed(prior, best.cause, best.fit.coordinates, self.evidence)
            base, noise = best.fit, best.noise
        return Judgement(
            tuple(accepted), base, plain_base, first, between, noise, prior, tuple(reasons)
        )

    def base(self, prior: Prior) -> tuple[Fit, Noise]:
        """The fit within a prior that frees no cause, and the noise that it leaves."""
        _, soc = self.evidence.simulate(self.coordinates, prior.mean)
        self._amplitude = self.evidence.amplitude(self.coordinates.model, soc)
        noise = Noise(NoiseLevel(1e-3, 1e-3, 20.0, min(1e-2, self.most_slow_V), 600.0))
        found = self._fit(noise, self.coordinates, prior, prior.mean, 5)
        for _ in range(2):
            noise = self._noise(found, prior)
            found = self._fit(noise, self.coordinates, prior, found.z, 4)
        return complete(self._objective(noise), found, prior), noise

    def alone(self, found: Fit, keep: set[str], starts_free: bool) -> Fit:
        """The causes' coordinates as found, tolerances at neutral.

        Starts that were given stay as given; those that were found are found again.
        """
        named = dict(zip(self.evidence.starts(), self.evidence.logs, strict=True))
        free = [n for n, g in named.items() if starts_free or g.start.how != "given"]
        fixed = self.point(found, keep)
        fixed |= {n: 0.0 for n in named if n not in free}
        if starts_free:
            fixed |= {n: found.z[n] for n in free}
            free = []
        std = {n: self.prior.std[n] for n in free}
        low = {n: self.prior.low[n] for n in free}
        high = {n: self.prior.high[n] for n in free}
        objective = Objective(
            self.evidence, NoiseLevel(2e-3, 1e-3, 20.0, 3e-3, 600.0), self._amplitude
        )
        start = {n: found.z[n] for n in free}
        prior = Prior(std, {}, low, high)
        one = fit(objective, found.coordinates, prior, start, 4, fixed)
        return complete(objective, one, prior)

    def point(self, found: Fit, keep: set[str]) -> dict[str, float]:
        """The causes' coordinates and what good logs taught of the cell, nothing else."""
        taught = set(self.prior.linked)
        return {n: v for n, v in found.z.items() if n in keep or n in taught}

    def _fit(
        self,
        noise: Noise,
        coordinates: Coordinates,
        prior: Prior,
        start: Mapping[str, float],
        iterations: int,
        frozen: Frozen | None = None,
        moving: Sequence[str] = (),
    ) -> Fit:
        objective = self._objective(noise)
        return fit(objective, coordinates, prior, start, iterations, None, frozen, moving)

    def _noise(self, found: Fit, prior: Prior, other: Noise | None = None) -> Noise:
        """The noise that a fit leaves on all rows; ``other`` if that describes it better.

        Held-out logs may ask more of the cell than those that were fitted: what a model gets
        wrong there is no surprise to be paid for row by row. And some logs ask more than others.
        """
        found = complete(self._objective(other or Noise(self.floor)), found, prior)
        rows = self.evidence.known & (self.evidence.role != IGNORED)
        residual = np.nan_to_num(self.evidence.voltage_V - found.voltage_V)
        noise = Noise(self._level(residual, rows, Noise(self.floor)))
        white, _ = self._objective(noise).whitened(residual[:, None])
        scale = log_scales(white[:, 0], rows, [g.scored for g in self.evidence.logs])
        if max(scale) > LOGS_DIFFER * min(scale):
            noise = Noise(self._level(residual, rows, Noise(self.floor, scale)), scale)
        if other is None:
            return noise

        def explained(noise: Noise) -> float:
            return float(np.sum(self._objective(noise).terms(residual)[rows]))

        return max((noise, other), key=explained)

    def _level(self, residual_V: FloatArray, rows: BoolArray, noise: Noise) -> NoiseLevel:
        """Most likely level on the rows, each log at its scale."""
        scaled = residual_V / self._objective(noise).amplitude
        level = estimate_noise(scaled, self.evidence.dt_s, rows)
        level = level._replace(slow_V=min(level.slow_V, self.most_slow_V))
        return at_least(level, self.floor)

    def _objective(self, noise: Noise) -> Objective:
        if not noise.scale:
            return Objective(self.evidence, noise.level, self._amplitude)
        times = np.repeat(noise.scale, [g.scored for g in self.evidence.logs])
        return Objective(self.evidence, noise.level, self._amplitude * times)

    def _rank(
        self, causes: Sequence[Cause], prior: Prior, base: Fit, noise: Noise, turn: int
    ) -> tuple[Candidate, ...]:
        """Every cause fitted, each under the noise that it leaves itself; the best one first."""
        level = noise.level._replace(slow_V=min(noise.level.slow_V, FIRM_SLOW_V))
        firm = Noise(at_least(level, self.floor), noise.scale)
        frozen = freeze(self._objective(noise), base.coordinates, prior.names, base.z)
        none = self._explained(base, noise, prior)

        def work(cause: Cause) -> Candidate:
            return self._candidate(cause, prior, base, noise, firm, frozen, none)

        ranked: list[Candidate] = []
        with ThreadPoolExecutor(self.workers) as threads:
            for k, candidate in enumerate(threads.map(work, causes)):
                ranked.append(candidate)
                self._say(turn, (k + 1) / len(causes), candidate.name)
            ranked.sort(key=lambda c: -c.score)
            # Those that matter once more, under the noise that they now leave.
            ranked[:FINALISTS] = threads.map(
                lambda c: self._again(c, prior, base, noise, frozen, none), ranked[:FINALISTS]
            )
        return likelier_first(sorted(ranked, key=lambda c: -c.score), self.foreign)

    def _again(
        self,
        c: Candidate,
        prior: Prior,
        base: Fit,
        usual: Noise,
        frozen: Frozen,
        none: Prediction,
    ) -> Candidate:
        wide = freed(prior, c.cause, c.fit.coordinates, self.evidence)
        noise = self._noise(c.fit, wide, usual)
        moving = [*kept_coordinates((c.cause,)), *self.evidence.starts()]
        found = self._fit(noise, c.fit.coordinates, wide, c.fit.z, 5, frozen, moving)
        return self._scored(c.cause, found, noise, wide, none)

    def _candidate(
        self,
        cause: Cause,
        prior: Prior,
        base: Fit,
        usual: Noise,
        firm: Noise,
        frozen: Frozen,
        none: Prediction,
    ) -> Candidate:
        """One cause fitted on top of the base; over several shapes where it has one."""
        best: Fit | None = None
        moving = [*cause.coordinates, *self.evidence.starts()]
        shapes = shapes_to_try(cause, base.coordinates, self.evidence)
        beginnings = [(c, b) for c in shapes for b in cause.beginnings or ({},)]
        for shaped, beginning in beginnings:
            wide = freed(prior, cause, shaped, self.evidence)
            start = {**base.z, **beginning}
            if cause.name == "self_heating":
                start["rth_K_per_W"] = 1.0
                moving.append("activation_K")
                if needs_activation(shaped):
                    start["activation_K"] = USUAL_ACTIVATION_K
            found = self._fit(
                firm, shaped, wide, start, 3 if len(beginnings) > 1 else 5, frozen, moving
            )
            if best is None or found.log_evidence > best.log_evidence:
                best = found
        if best is None:
            raise ValueError(f"no shape to try for {cause.name}")
        wide = freed(prior, cause, best.coordinates, self.evidence)
        noise = self._noise(best, wide, usual)
        best = self._fit(noise, best.coordinates, wide, best.z, 5, frozen, moving)
        if best.log_evidence < base.log_evidence:
            # The firm noise led it astray: begin where the base stands.
            again = self._fit(usual, best.coordinates, wide, base.z, 5, frozen, moving)
            if again.log_evidence > best.log_evidence:
                best, noise = again, usual
        return self._scored(cause, best, noise, wide, none)

    def _scored(
        self, cause: Cause, best: Fit, noise: Noise, prior: Prior, none: Prediction
    ) -> Candidate:
        best = complete(self._objective(noise), best, prior)
        one = self._explained(best, noise, prior, (cause,))
        low = held_interval_low(
            self.evidence, one.terms - none.terms, np.random.default_rng(self.seed)
        )
        return Candidate(
            cause, best, noise, one.total - none.total, one.held - none.held, one.terms, low
        )

    def _explained(
        self, found: Fit, noise: Noise, prior: Prior, causes: Sequence[Cause] = ()
    ) -> Prediction:
        """How likely all rows are under a fit, and what the current reads at rest."""
        free = kept_coordinates((*causes, *(a.cause for a in self._accepted)))
        found_so = predict(self._objective(noise), found, prior, free)
        return found_so._replace(total=found_so.total + self.rest.ln_likelihood(found.z))

    def _gain(
        self, candidate: Candidate, base: Fit, accepted: Sequence[Accepted]
    ) -> tuple[Gain, Gain]:
        """Gain on held-out rows of the causes alone, and with what tolerances take up."""
        keep = kept_coordinates(a.cause for a in accepted)
        starts_free = any(a.cause.kind == "start" for a in accepted)
        one = self.alone(base, keep, starts_free)
        keep |= kept_coordinates((candidate.cause,))
        two = self.alone(candidate.fit, keep, starts_free or candidate.cause.kind == "start")
        alone = gain_of(self.evidence, one.voltage_V, two.voltage_V, self._amplitude, self.rng)
        together = gain_of(
            self.evidence, base.voltage_V, candidate.fit.voltage_V, self._amplitude, self.rng
        )
        return alone, together

    def _ahead(self, close: Sequence[Candidate], accepted: Sequence[Accepted]) -> int | None:
        """Which of those that explain as much foretells held-out rows best, if one clearly does."""
        known = [a.cause for a in accepted]
        started = any(c.kind == "start" for c in known)
        alone = [
            self.alone(
                c.fit, kept_coordinates((*known, c.cause)), started or c.cause.kind == "start"
            )
            for c in close
        ]
        return clearly_ahead(
            self.evidence, [f.voltage_V for f in alone], self._amplitude, self.seed
        )

    def _material(
        self,
        ranked: tuple[Candidate, ...],
        prior: Prior,
        base: Fit,
        accepted: Sequence[Accepted],
    ) -> tuple[tuple[Candidate, ...], Gain | None, list[str]]:
        """Candidates from the first one on that gains something on held-out data, and its gain."""
        refused = []
        claim = self.evidence.claim_V(self.coordinates.model, base.soc)
        for k, candidate in enumerate(ranked):
            if candidate.score < LEAST_SCORE:
                refused.append(f"{candidate.name} explains no more than tolerances do")
                break
            alone, together = self._gain(candidate, base, accepted)
            wide = freed(prior, candidate.cause, candidate.fit.coordinates, self.evidence)
            refusal = unphysical(candidate, wide) or immaterial(candidate, alone, together, claim)
            if not refusal:
                return ranked[k:], alone, refused
            refused.append(refusal)
        return ranked, None, refused

    def _is_age(self, ranked: Sequence[Candidate], prior: Prior, base: Fit, noise: Noise) -> bool:
        """Whether what looks like a sensor's gain is as well a cell that has aged."""
        best = ranked[0]
        tried = {c.name: c.cause for c in ranked}
        age = [tried[n] for n in ("capacity", "resistance_scale") if n in tried]
        ln_gain = best.fit.z.get("ln_gain", 0.0)
        if best.name != "current_gain" or len(age) < 2 or ln_gain > math.log(AGED_GAIN):
            return False
        wide = prior
        for cause in age:
            wide = freed(wide, cause, base.coordinates, self.evidence)
        start = {**best.fit.z, "ln_gain": 0.0, "ln_capacity": ln_gain, "ln_scale": -ln_gain}
        found = self._fit(best.noise, base.coordinates, wide, start, 5)
        found = complete(self._objective(best.noise), found, wide)
        both = self._explained(found, best.noise, wide, age).total
        none = self._explained(base, noise, prior).total
        return both - none > best.score - SIMPLER

    def _both_needed(self, best: Candidate, rivals: Sequence[Candidate], prior: Prior) -> bool:
        """Whether some rival explains more on top of the best one: they are two effects."""
        wide = freed(prior, best.cause, best.fit.coordinates, self.evidence)
        objective = self._objective(best.noise)
        frozen = freeze(objective, best.fit.coordinates, wide.names, best.fit.z)
        none = self._explained(best.fit, best.noise, wide)
        for other in rivals[:2]:
            both = self._candidate(
                other.cause, wide, best.fit, best.noise, best.noise, frozen, none
            )
            if both.score > LEAST_SCORE:
                return True
        return False

    def _say(self, turn: int, part: float, name: str) -> None:
        if self.progress is None:
            return
        share = 1.0 - 0.5 ** (turn + part)
        self._said = max(self._said, share)
        self.progress(self._said, name.replace("_", " "))
