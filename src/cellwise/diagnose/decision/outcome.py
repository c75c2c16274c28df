"""The outcome: named causes, the fit of them alone, what stayed undecided."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.diagnose.causes.catalogue import Cause
from cellwise.diagnose.decision.explanations import Explanation, Explanations
from cellwise.diagnose.decision.odds import NAMING, Hypothesis, Weighed, probability_of, weigh
from cellwise.diagnose.fit.least_squares import Fit
from cellwise.diagnose.fit.noise import Noise

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
    none: Explanation
    first: tuple[Explanation, ...]
    alternatives: tuple[Explanation, ...]
    noise: Noise
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
    fits, none = sets.fits, sets.tried[frozenset()]
    weighed = weigh(
        [
            Hypothesis(e.names, e.found.total, e.found.terms, sets.rarity.nats(e.names))
            for e in sets.tried.values()
        ],
        fits.evidence,
        np.random.default_rng(fits.seed),
    )
    best = sets.best(1)[0]
    known = {c.name for e in sets.tried.values() for c in e.causes}
    likely = [name for name in sorted(known) if probability_of(name, weighed) > NAMING.least]
    hidden = [name for name in likely if sets.rarity.hides(name)]
    named = _as_explained(sets, frozenset(likely) - frozenset(hidden))
    accepted = sorted((_accepted(sets, c) for c in named), key=lambda a: -a.score)
    nothing = sum(w.probability for w in weighed if not w.causes)
    alternatives: tuple[Explanation, ...] = ()
    fit, noise = none.fit, none.noise
    if accepted:
        fit, noise = _of_named(sets, [a.cause for a in accepted])
    if nothing < NAMING.likely:
        compete = [sets.tried[frozenset(w.causes)] for w in weighed if w.causes]
        alternatives = tuple(compete[: max(2, _needed(weighed))])
    first = tuple(sets.best(len(known), 1))
    reasons = () if accepted or best.causes else _reasons(sets, first)
    reasons = (*(NOT_MEASURED_THERE.format(name) for name in hidden), *reasons)
    return Outcome(tuple(accepted), fit, none, first, alternatives, noise, reasons, weighed)


def _as_explained(sets: Explanations, names: frozenset[str]) -> tuple[Cause, ...]:
    """Causes in the forms that explain most: of the set that is they, else of the nearest to it.

    Named by different sets, they need stand in none together.
    """
    ranked = sets.best(len(sets.tried))
    own = sets.tried.get(names)
    nearest = [own] if own else [e for e in ranked if names <= e.key]
    found = {c.name: c for e in [*nearest[:1], *ranked][::-1] for c in e.causes}
    return tuple(found[n] for n in sorted(names))


def _accepted(sets: Explanations, cause: Cause) -> Accepted:
    ranked = sets.best(len(sets.tried))
    with_it = next(e for e in ranked if cause.name in e.names)
    without = next(e for e in ranked if cause.name not in e.names)
    return Accepted(cause, sets.odds(with_it) - sets.odds(without), without.names)


def _of_named(sets: Explanations, causes: Sequence[Cause]) -> tuple[Fit, Noise]:
    """The named causes alone: what the others of their likeliest set explain is left."""
    names = frozenset(c.name for c in causes)
    own = sets.tried.get(names)
    if own is not None:
        return own.fit, own.noise
    near = next(e for e in sets.best(len(sets.tried)) if names <= e.key)
    return sets.fits.fit_causes(causes, near.fit, near.noise), near.noise


def _needed(weighed: Sequence[Weighed]) -> int:
    """How many sets make up :attr:`NAMING.least` of the probability."""
    total = np.cumsum([w.probability for w in weighed])
    return int(np.searchsorted(total, NAMING.least)) + 1


def _reasons(sets: Explanations, first: Sequence[Explanation]) -> tuple[str, ...]:
    """Why the likeliest causes are not the explanation, where nothing is."""
    none, rests = sets.tried[frozenset()], sets.fits.rests
    before = rests.ln_likelihood(none.fit.coordinates, none.fit.z)
    found = []
    for one in first:
        here = one.fit.coordinates, one.fit.z
        if rests.ln_likelihood(*here) < before - NAMING.refuted:
            found.append(f"{one.names[0]} is refuted: {rests.contradiction(*here)}")
    if first:
        found.append(f"{first[0].names[0]}, the likeliest, explains no more than chance would")
    return (*found[: NAMING.reasons], *list(sets.refused.values())[: NAMING.reasons])
