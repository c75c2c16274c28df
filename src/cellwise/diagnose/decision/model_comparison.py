"""Model comparison: which causes are accepted, in which order, and when it stays undecided."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from cellwise.diagnose.causes.catalogue import Cause, kept_coordinates
from cellwise.diagnose.decision.acceptance import (
    LEAST_SCORE,
    alternatives_to,
    close_candidates,
    immaterial,
    likelier_first,
    predicts_worse,
    significance_of,
    unphysical,
)
from cellwise.diagnose.decision.candidates import Candidate, clearly_ahead, held_interval_low
from cellwise.diagnose.decision.outcome import Accepted, Outcome, Stage
from cellwise.diagnose.decision.posterior import Hypothesis, Weighed, weigh
from cellwise.diagnose.decision.revision import aged, refitted, unnecessary
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.gain import Gain
from cellwise.diagnose.fit.least_squares import Fit, Frozen, complete, freeze
from cellwise.diagnose.fit.likelihood import Prediction
from cellwise.diagnose.fit.noise import Noise, at_least
from cellwise.diagnose.fit.priors import (
    USUAL_ACTIVATION_K,
    needs_activation,
    starts_to_try,
    widened_for,
)
from cellwise.typing import FloatArray

Progress = Callable[[float, str], None]

MOST_CAUSES = 5
# Alternatives of each accepted cause that are fitted in its place.
OTHERS = 2
# A rest that lies three standard deviations off refutes a claim on charge (nats).
REFUTED = 0.5 * 3.0**2
FINALISTS = 5
# The search begins with a noise that is forgiving at once and firm in the long run, so that what
# drifts is not taken for noise before any cause was tried.
FIRM_SLOW_V = 1e-3


@dataclass(eq=False)
class ModelComparison:
    """One diagnosis at work; :meth:`run` gives the :class:`Outcome`.

    ``extrapolated`` says whether the logs' temperature lies outside the model's.
    """

    fits: CauseFits
    extrapolated: bool = False
    progress: Progress | None = None
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    _said: float = field(default=0.0)
    _base: tuple[Fit, Noise] = field(init=False)

    def run(self, causes: Sequence[Cause], base: Fit, noise: Noise) -> Outcome:
        """Accept causes one by one on top of the base until nothing is left to explain."""
        stage = Stage((), self.fits.prior, base, noise)
        self._base = base, noise
        first: tuple[Candidate, ...] = ()
        between: tuple[Candidate, ...] = ()
        reasons: list[str] = []
        cleared: set[str] = set()
        for turn in range(MOST_CAUSES):
            left = [c for c in causes if c not in stage.causes and c.name not in cleared]
            if not left:
                break
            ranked = self._compared_alone(self._rank(left, stage, turn), stage)
            first = first or ranked
            ranked, gains, refused = self._material(ranked, stage)
            if gains is None:
                reasons += refused
                break
            age = aged(self.fits, ranked, stage)
            if age is not None:
                cleared.add("current_gain")
                stage = refitted(self.fits, age.accepted, base, age.fit)
            else:
                chosen, between = self._chosen(ranked, stage)
                if chosen is None:
                    break
                if chosen is not ranked[0]:
                    gains = self._gains(chosen, stage)
                others = tuple(c.name for c in ranked if c is not chosen)[:2]
                stage = self._with(stage, chosen, gains, others)
            while (name := unnecessary(self.fits, stage)) is not None:
                cleared.add(name)
                kept = [a for a in stage.accepted if a.cause.name != name]
                stage = refitted(self.fits, kept, base, stage.fit)
        weighed = self._weighed(stage, first, between)
        return Outcome(
            stage.accepted,
            stage.fit,
            base,
            first,
            between,
            stage.noise,
            stage.prior,
            tuple(reasons),
            weighed,
        )

    def _weighed(
        self, stage: Stage, first: tuple[Candidate, ...], between: tuple[Candidate, ...]
    ) -> tuple[Weighed, ...]:
        """The accepted set among its alternatives: one cause less, or another one in its place.

        Candidates of the first round stand beside a single cause; where several
        causes are accepted, each is taken out, and what it is confused with is fitted in its place.
        """
        fits, rng = self.fits, np.random.default_rng(self.fits.seed)
        causes = stage.causes
        none = Stage((), fits.prior, self._base[0], self._base[1])
        empty = self._explained(none)
        sets = [Hypothesis.of((), empty)]
        if not causes:
            sets += [c.hypothesis((), empty) for c in between or first]
            return weigh(sets, fits.evidence, rng)
        names = [c.name for c in causes]
        sets.append(Hypothesis.of(names, self._explained(stage)))
        if len(causes) == 1:
            sets += [c.hypothesis((), empty) for c in first if not self._refuted(c, none)]
            return weigh(sets, fits.evidence, rng)
        possible = [c for c in first if c.name not in names and c.score > LEAST_SCORE]
        for k, out in enumerate(stage.accepted):
            kept = (*stage.accepted[:k], *stage.accepted[k + 1 :])
            others = [a.cause for a in kept]
            found = fits.fit_causes(others, stage.fit, stage.noise)
            less = Stage(kept, fits.widened_for(others, found.coordinates), found, stage.noise)
            before = self._explained(less)
            sets.append(Hypothesis.of([c.name for c in others], before))
            near = [c for c in possible if c.name in out.cause.confused_with][:OTHERS]
            if not near:
                continue
            frozen = freeze(
                fits.objective(less.noise), found.coordinates, less.prior.names, found.z
            )
            for other in near:
                tried = self._candidate(other.cause, less, less.noise, frozen, before)
                if not self._refuted(tried, less):
                    sets.append(tried.hypothesis([c.name for c in others], before))
        return weigh(sets, fits.evidence, rng)

    def _with(
        self,
        stage: Stage,
        chosen: Candidate,
        gains: tuple[Gain, Gain],
        others: tuple[str, ...] = (),
    ) -> Stage:
        """The stage with one more cause."""
        prior = widened_for(stage.prior, chosen.cause, chosen.fit.coordinates, self.fits.evidence)
        one = Accepted(
            chosen.cause, gains[0], chosen.score, others, significance_of(chosen, *gains)
        )
        return Stage((*stage.accepted, one), prior, chosen.fit, chosen.noise)

    def _rank(self, causes: Sequence[Cause], stage: Stage, turn: int) -> tuple[Candidate, ...]:
        """Every cause fitted, each under the noise that it leaves itself; the best one first."""
        fits, noise = self.fits, stage.noise
        level = noise.level._replace(slow_V=min(noise.level.slow_V, FIRM_SLOW_V))
        firm = Noise(at_least(level, fits.floor), noise.scale)
        frozen = freeze(
            fits.objective(noise), stage.fit.coordinates, stage.prior.names, stage.fit.z
        )
        none = self._explained(stage)

        def work(cause: Cause) -> Candidate:
            return self._candidate(cause, stage, firm, frozen, none)

        ranked: list[Candidate] = []
        with ThreadPoolExecutor(self.workers) as threads:
            for k, candidate in enumerate(threads.map(work, causes)):
                ranked.append(candidate)
                self._say(turn, (k + 1) / len(causes), candidate.name)
            ranked.sort(key=lambda c: -c.score)
            # Those that matter once more, under the noise that they now leave.
            ranked[:FINALISTS] = threads.map(
                lambda c: self._again(c, stage, frozen, none), ranked[:FINALISTS]
            )
        return likelier_first(sorted(ranked, key=lambda c: -c.score), self.extrapolated)

    def _explained(self, stage: Stage) -> Prediction:
        return self.fits.explained(stage.fit, stage.noise, stage.prior, stage.causes)

    def _again(self, c: Candidate, stage: Stage, frozen: Frozen, none: Prediction) -> Candidate:
        fits = self.fits
        wide = widened_for(stage.prior, c.cause, c.fit.coordinates, fits.evidence)
        noise = fits.noise(c.fit, wide, stage.noise)
        moving = [*kept_coordinates((c.cause,)), *fits.evidence.starts()]
        found = fits.fit(noise, c.fit.coordinates, wide, c.fit.z, 5, frozen, moving)
        return self._scored(c.cause, found, noise, stage, none)

    def _candidate(
        self, cause: Cause, stage: Stage, firm: Noise, frozen: Frozen, none: Prediction
    ) -> Candidate:
        """One cause fitted on top of the stage; from several starts where one may mislead."""
        fits, base = self.fits, stage.fit
        evidence = fits.evidence
        best: Fit | None = None
        moving = [*cause.coordinates, *evidence.starts()]
        beginnings = starts_to_try(cause, base.coordinates, evidence)
        for shaped, beginning in beginnings:
            wide = widened_for(stage.prior, cause, shaped, evidence)
            start = {**base.z, **beginning}
            if cause.name == "self_heating":
                start["rth_K_per_W"] = 1.0
                moving.append("activation_K")
                if needs_activation(shaped):
                    start["activation_K"] = USUAL_ACTIVATION_K
            found = fits.fit(
                firm, shaped, wide, start, 3 if len(beginnings) > 1 else 5, frozen, moving
            )
            if best is None or found.log_evidence > best.log_evidence:
                best = found
        if best is None:
            raise ValueError(f"no shape to try for {cause.name}")
        wide = widened_for(stage.prior, cause, best.coordinates, evidence)
        noise = fits.noise(best, wide, stage.noise)
        best = fits.fit(noise, best.coordinates, wide, best.z, 5, frozen, moving)
        if best.log_evidence < base.log_evidence:
            # The firm noise misled it: start from the base.
            again = fits.fit(stage.noise, best.coordinates, wide, base.z, 5, frozen, moving)
            if again.log_evidence > best.log_evidence:
                best, noise = again, stage.noise
        return self._scored(cause, best, noise, stage, none)

    def _scored(
        self, cause: Cause, best: Fit, noise: Noise, stage: Stage, none: Prediction
    ) -> Candidate:
        fits = self.fits
        wide = widened_for(stage.prior, cause, best.coordinates, fits.evidence)
        best = complete(fits.objective(noise), best, wide)
        one = fits.explained(best, noise, wide, (cause, *stage.causes))
        low = held_interval_low(
            fits.evidence, one.terms - none.terms, np.random.default_rng(fits.seed)
        )
        return Candidate(
            cause, best, noise, one.total - none.total, one.held - none.held, one.terms, low
        )

    def _compared_alone(self, ranked: tuple[Candidate, ...], stage: Stage) -> tuple[Candidate, ...]:
        """The likeliest first, but after all that by themselves predict held-out rows far better.

        What explains most may owe it to small changes of everything else, which an extended
        model does not have.
        """
        close = close_candidates(ranked, self.fits.evidence)
        if len(close) < 2:
            return ranked
        alone = self._predictions(close, stage)
        plain = self.fits.alone(stage.fit, stage.causes).voltage_V
        gains = [self.fits.gain(plain, v) for v in alone]
        lead = max(range(len(close)), key=lambda k: min(gains[k].gain, gains[k].gain_in_size))
        over = [self.fits.gain(v, alone[lead]) for v in alone]
        late = [
            c
            for c, gain in zip(close, over, strict=True)
            if predicts_worse(c, close[lead], gain, self.extrapolated)
        ]
        return (*(c for c in ranked if c not in late), *late)

    def _predictions(self, close: Sequence[Candidate], stage: Stage) -> list[FloatArray]:
        """What each predicts by itself on top of the causes so far [V]."""
        return [self.fits.alone(c.fit, (*stage.causes, c.cause)).voltage_V for c in close]

    def _gains(self, candidate: Candidate, stage: Stage) -> tuple[Gain, Gain]:
        """Gain on held-out rows of the causes alone, and with the tolerances fitted."""
        one = self.fits.alone(stage.fit, stage.causes)
        two = self.fits.alone(candidate.fit, (*stage.causes, candidate.cause))
        return (
            self.fits.gain(one.voltage_V, two.voltage_V),
            self.fits.gain(stage.fit.voltage_V, candidate.fit.voltage_V),
        )

    def _chosen(
        self, ranked: Sequence[Candidate], stage: Stage
    ) -> tuple[Candidate | None, tuple[Candidate, ...]]:
        """The first one, or the best predictor of its equals; none and all of them if none is."""
        best = ranked[0]
        alternatives = alternatives_to(ranked, self.fits.evidence, self.extrapolated)
        if not alternatives or self._both_needed(best, alternatives, stage):
            return best, ()
        close = (best, *alternatives)
        alone = self._predictions(close, stage)
        ahead = clearly_ahead(self.fits.evidence, alone, self.fits.amplitude, self.fits.seed)
        return (None, close) if ahead is None else (close[ahead], ())

    def _material(
        self, ranked: tuple[Candidate, ...], stage: Stage
    ) -> tuple[tuple[Candidate, ...], tuple[Gain, Gain] | None, list[str]]:
        """Candidates from the first one on that gains something on held-out data, its gains."""
        refused = []
        evidence = self.fits.evidence
        claim = evidence.claim_V(self.fits.coordinates.model, stage.fit.soc)
        for k, candidate in enumerate(ranked):
            if candidate.score < LEAST_SCORE:
                refused.append(f"{candidate.name} explains no more than the tolerances")
                break
            alone, together = self._gains(candidate, stage)
            wide = widened_for(stage.prior, candidate.cause, candidate.fit.coordinates, evidence)
            refusal = (
                unphysical(candidate, wide)
                or self._refuted(candidate, stage)
                or immaterial(candidate, alone, together, claim)
            )
            if not refusal:
                return ranked[k:], (alone, together), refused
            refused.append(refusal)
        return ranked, None, refused

    def _refuted(self, candidate: Candidate, stage: Stage) -> str:
        """What a rest says against a claim on charge that the stage does not make; else empty."""
        rests, found = self.fits.rests, candidate.fit
        before = rests.ln_likelihood(stage.fit.coordinates, stage.fit.z)
        after = rests.ln_likelihood(found.coordinates, found.z)
        if after > before - REFUTED:
            return ""
        return f"{candidate.name} is refuted: {rests.contradiction(found.coordinates, found.z)}"

    def _both_needed(
        self, best: Candidate, alternatives: Sequence[Candidate], stage: Stage
    ) -> bool:
        """Whether some alternative explains more on top of the best one: they are two effects."""
        after = self._with(stage, best, self._gains(best, stage))
        frozen = freeze(
            self.fits.objective(after.noise),
            after.fit.coordinates,
            after.prior.names,
            after.fit.z,
        )
        none = self._explained(after)
        tried = (
            self._candidate(r.cause, after, after.noise, frozen, none) for r in alternatives[:2]
        )
        return any(c.score > LEAST_SCORE for c in tried)

    def _say(self, turn: int, part: float, name: str) -> None:
        if self.progress is None:
            return
        share = 1.0 - 0.5 ** (turn + part)
        self._said = max(self._said, share)
        self.progress(self._said, name.replace("_", " "))
