"""The outcome: named causes, the fit of them alone, what stayed undecided."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.diagnose.causes.catalogue import Cause
from cellwise.diagnose.decision.odds import NAMING, Weighed, probability_of, weigh
from cellwise.diagnose.decision.search import Explanation, Explanations
from cellwise.diagnose.fit.least_squares import Fit

NOT_MEASURED_THERE = (
    "{} explains the logs best, but the model was not measured at their temperature, where a cell "
    "that has aged and a healthy one look alike: a test of the cell there distinguishes them"
)


@dataclass(frozen=True)
class Accepted:
    """A cause that was named, by how much its sets lead those without it, and the next of these.

    ``score`` is ln of the odds of the likeliest set that holds it against the likeliest that does
    not, ``instead`` that other set (empty: no cause).
    """

    cause: Cause
    score: float
    instead: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Outcome:
    """Named causes, most needed first, and the fit of them alone; all single causes.

    ``alternatives`` are the sets that make up the probability (none, where nothing is likelier than
    anything), ``weighed`` all sets with their probability.
    """

    accepted: tuple[Accepted, ...]
    fit: Fit
    scale: float
    none: Explanation
    first: tuple[Explanation, ...]
    alternatives: tuple[Explanation, ...]
    reasons: tuple[str, ...]
    weighed: tuple[Weighed, ...] = ()

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The named causes."""
        return tuple(a.cause for a in self.accepted)

    @property
    def open_between(self) -> tuple[Explanation, ...]:
        """The sets that could not be separated, where nothing is named."""
        return () if self.accepted else self.alternatives


def decide(sets: Explanations) -> Outcome:
    """Name every cause that the sets that hold it make probable; leave open what they do not."""
    fits, none, ranked = sets.fits, sets.none, sets.best()
    weighed = weigh(
        [(e.names, sets.odds(e), e.found.terms) for e in sets.tried.values()],
        fits.evidence,
        np.random.default_rng(fits.seed),
    )
    known = sorted({c.name for e in ranked for c in e.causes})
    likely = [name for name in known if probability_of(name, weighed) > NAMING.least]
    hidden = [name for name in likely if sets.rarity.hides(name)]
    named = _as_explained(ranked, frozenset(likely) - frozenset(hidden))
    accepted = sorted((_accepted(sets, ranked, c) for c in named), key=lambda a: -a.score)
    alternatives: list[Explanation] = []
    if sum(w.probability for w in weighed if not w.causes) < NAMING.likely:
        needed = np.searchsorted(np.cumsum([w.probability for w in weighed]), NAMING.least)
        compete = [sets.tried[frozenset(w.causes)] for w in weighed if w.causes]
        alternatives = compete[: max(2, int(needed) + 1)]
    fit, scale = _of_named(sets, ranked, [a.cause for a in accepted])
    first = tuple(sets.best(len(known), 1))
    reasons = () if accepted or ranked[0].causes else _reasons(sets, first)
    reasons = (*(NOT_MEASURED_THERE.format(name) for name in hidden), *reasons)
    return Outcome(tuple(accepted), fit, scale, none, first, tuple(alternatives), reasons, weighed)


def _as_explained(ranked: Sequence[Explanation], names: frozenset[str]) -> tuple[Cause, ...]:
    """Causes in the forms that explain most: of the set that is they, else of the nearest to it.

    Named by different sets, they need stand in none together.
    """
    own = [e for e in ranked if e.key == names] or [e for e in ranked if names <= e.key]
    found = {c.name: c for e in [*own[:1], *ranked][::-1] for c in e.causes}
    return tuple(found[n] for n in sorted(names))


def _accepted(sets: Explanations, ranked: Sequence[Explanation], cause: Cause) -> Accepted:
    with_it = next(e for e in ranked if cause.name in e.names)
    without = next(e for e in ranked if cause.name not in e.names)
    return Accepted(cause, sets.odds(with_it) - sets.odds(without), without.names)


def _of_named(
    sets: Explanations, ranked: Sequence[Explanation], causes: Sequence[Cause]
) -> tuple[Fit, float]:
    """The named causes alone: what the others of their likeliest set explain is left."""
    names = frozenset(c.name for c in causes)
    own = sets.tried.get(names)
    if own is not None:
        return own.fit, own.scale
    near = next(e for e in ranked if names <= e.key)
    return sets.fits.fit_causes(causes, near.fit, near.scale), near.scale


def _reasons(sets: Explanations, first: Sequence[Explanation]) -> tuple[str, ...]:
    """Why the likeliest causes are not the explanation, where nothing is."""
    rests = sets.fits.rests

    def at_rest(one: Explanation) -> float:
        return rests.ln_likelihood(one.fit.coordinates, one.fit.z)

    found = [
        f"{one.names[0]} is refuted: {rests.contradiction(one.fit.coordinates, one.fit.z)}"
        for one in first
        if at_rest(one) < at_rest(sets.none) - NAMING.refuted
    ]
    if first:
        found.append(f"{first[0].names[0]}, the likeliest, explains no more than chance would")
    return (*found[: NAMING.reasons], *list(sets.refused.values())[: NAMING.reasons])
