"""Sets of causes fitted together, the odds of each, and what of them is named.

Singles first, then what could still explain something beside the likeliest of them, fitted jointly.
A set is judged by the evidence of all rows under a noise that is never less than what the model
states of its own error, by what rests and zero readings say, and by how rare its causes are.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from cellwise.diagnose.causes.catalogue import Cause, forms_of, kept_coordinates
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.cause_fits import CauseFits, Prediction
from cellwise.diagnose.fit.coordinate_fit import Fit, Frozen, Tolerances, fit
from cellwise.diagnose.fit.priors import needs_activation, starts_to_try, widened_for
from cellwise.diagnose.odds import NAMING, Rarity, Weighed, probability_of, weigh
from cellwise.fit.population import SPREAD

Progress = Callable[[float, str], None]


class CauseSearch(NamedTuple):
    """How far sets of causes are searched.

    ``beam`` sets of one size get further causes, ``added`` to each, up to ``most_causes``. One
    step is no bound on what a fit gains: beside a set that is better than nothing, a cause is tried
    where ``tried_share`` of its rarity is in sight.
    """

    beam: int = 4
    added: int = 5
    most_causes: int = 4
    tried_share: float = 0.5


SEARCH = CauseSearch()


NOT_MEASURED_THERE = (
    "{} explains the logs best, but the model was not measured at their temperature, where a cell "
    "that has aged and a healthy one look alike: a test of the cell there distinguishes them"
)


@dataclass(frozen=True, eq=False)
class Explanation:
    """A set of causes fitted to all logs, and how likely the rows are with it."""

    causes: tuple[Cause, ...]
    fit: Fit
    scale: float
    prior: Tolerances
    found: Prediction

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the causes."""
        return tuple(c.name for c in self.causes)

    @property
    def key(self) -> frozenset[str]:
        """What makes it another explanation than others."""
        return frozenset(self.names)


@dataclass(eq=False)
class Explanations:
    """All sets that were tried in one diagnosis."""

    fits: CauseFits
    rarity: Rarity
    progress: Progress | None = None
    tried: dict[frozenset[str], Explanation] = field(default_factory=dict)

    @property
    def none(self) -> Explanation:
        """No cause."""
        return self.tried[frozenset()]

    def odds(self, one: Explanation) -> float:
        """Ln of the odds of a set against no cause, up to the weight of blocks [nats]."""
        return one.found.total - self.none.found.total - self.rarity.nats(one.names)

    def best(self, many: int | None = None, size: int | None = None) -> list[Explanation]:
        """The likeliest sets, of one size or of any."""
        sets = [e for e in self.tried.values() if size is None or len(e.causes) == size]
        return sorted(sets, key=self.odds, reverse=True)[:many]

    def search(self, causes: Sequence[Cause], base: Fit, scale: float) -> None:
        """Try sets of causes on top of the base until one more gains less than its rarity.

        Two causes may explain together what neither does alone: one size more is tried.
        """
        prior = self.fits.prior
        self._keep(self._explained((), base, scale, prior, self.fits.frozen(base, prior)))
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            for size in range(1, SEARCH.most_causes + 1):
                self._with_one_more(causes, size, threads)
                if len(self.best(1)[0].causes) < size - 1:
                    break

    def _with_one_more(
        self, causes: Sequence[Cause], size: int, threads: ThreadPoolExecutor
    ) -> None:
        """Try sets of a size, every one from the likeliest that it can be made of."""

        def prepared(start: Explanation) -> tuple[Explanation, Frozen, list[Cause]]:
            frozen = self.fits.frozen(start.fit, start.prior)
            return start, frozen, self._promising(start, causes, frozen)

        todo: dict[frozenset[str], tuple[Explanation, Cause, Frozen]] = {}
        for start, frozen, more in threads.map(prepared, self.best(SEARCH.beam, size - 1)):
            for cause in more:
                todo.setdefault(start.key | {cause.name}, (start, cause, frozen))
        tasks = [task for key, task in todo.items() if key not in self.tried]
        for k, one in enumerate(threads.map(lambda task: self._added(*task), tasks), 1):
            if self.progress is not None:
                name = tasks[k - 1][1].name.replace("_", " ")
                self.progress(1.0 - 0.5 ** (size - 1 + k / len(tasks)), name)
            if one is not None:
                self._keep(one)

    def _promising(
        self, start: Explanation, causes: Sequence[Cause], frozen: Frozen
    ) -> list[Cause]:
        """Causes that could gain their rarity beside a set, those that could most."""
        left = [c for c in causes if c.name not in start.names]
        if not start.causes:
            return left
        most = could_explain(self.fits, left, start.fit, start.prior, frozen)
        own = self.rarity.nats(start.names)
        price = {c.name: self.rarity.nats((*start.names, c.name)) - own for c in left}
        least = SEARCH.tried_share if self.odds(start) > 0.0 else 1.0
        promising = [c for c in left if most[c.name] > least * price[c.name]]
        return sorted(promising, key=lambda c: -most[c.name])[: SEARCH.added]

    def _added(self, start: Explanation, cause: Cause, frozen: Frozen) -> Explanation | None:
        """A set with one more cause, all of it fitted; None where the cause stays away."""
        forms = forms_of(cause, start.fit.coordinates, self.fits.evidence.alone)
        ends = (self._with_form(start, form, frozen) for form in forms)
        return max(filter(physical, ends), key=lambda e: e.found.total, default=None)

    def _with_form(self, start: Explanation, cause: Cause, frozen: Frozen) -> Explanation:
        """A set with one form of one more cause, all of it fitted, from its best beginning."""
        fits, evidence = self.fits, self.fits.evidence
        causes = (*start.causes, cause)
        moving = [*kept_coordinates(causes), *evidence.starts()]

        def fitted(
            scale: float, coordinates: Coordinates, z: Mapping[str, float], steps: int, here: Frozen
        ) -> tuple[Fit, Tolerances]:
            wide = widened_for(start.prior, cause, coordinates, evidence)
            objective = fits.stated.times(scale)
            return fit(objective, coordinates, wide, z, steps, here, moving), wide

        found = []
        beginnings = starts_to_try(cause, start.fit.coordinates, evidence)
        for shaped, beginning in beginnings:
            point = {**start.fit.z, **beginning}
            if cause.name == "self_heating":
                point["rth_K_per_W"] = 1.0
                if needs_activation(shaped):
                    point["activation_K"] = SPREAD.activation_K
            steps = 1 if len(beginnings) > 1 else 5
            found.append(fitted(start.scale, shaped, point, steps, frozen))
        near, wide = max(found, key=lambda f: f[0].log_evidence)
        if len(beginnings) > 1:
            near, wide = fitted(start.scale, near.coordinates, near.z, 3, frozen)
        scale, here = fits.scale(near, wide), fits.frozen(near, wide)
        near, wide = fitted(scale, near.coordinates, near.z, 5, here)
        return self._explained(causes, near, scale, wide, here)

    def _keep(self, one: Explanation) -> None:
        known = self.tried.get(one.key)
        if known is None or one.found.total > known.found.total:
            self.tried[one.key] = one

    def _explained(
        self, causes: tuple[Cause, ...], found: Fit, scale: float, prior: Tolerances, near: Frozen
    ) -> Explanation:
        found = self.fits.complete(found, scale, prior)
        likely = self.fits.explained(found, scale, prior, causes, near)
        return Explanation(causes, found, scale, prior, likely)


def physical(one: Explanation) -> bool:
    """Whether what switches each effect on has moved, and no value stands at its bound."""
    z, low, high = one.fit.z, one.prior.low, one.prior.high
    return not any(
        (c.shape is not None and z.get(c.parameters[0].coordinate, 0.0) == 0.0)
        or any(z[n] in (low.get(n), high.get(n)) for n in c.coordinates if n in z)
        for c in one.causes
    )


def could_explain(
    fits: CauseFits, causes: Sequence[Cause], base: Fit, prior: Tolerances, frozen: Frozen
) -> dict[str, float]:
    """Nats that every cause would gain at most by one Gauss-Newton step from a fit.

    Rao's score test: gradient and information at the null hypothesis, where nothing of the cause
    is fitted yet; what it takes off the squares counts by the scale that both leave. Causes with a
    memory are tried at each of those from which their search starts.
    """
    evidence = fits.evidence
    shapes: dict[int, Coordinates] = {}
    tried: list[tuple[Cause, int, Tolerances]] = []
    for cause in (f for c in causes for f in forms_of(c, base.coordinates, evidence.alone)):
        of_cause = {id(s): s for s, _ in starts_to_try(cause, base.coordinates, evidence)}
        shapes |= of_cause
        tried += [
            (cause, key, widened_for(prior, cause, s, evidence)) for key, s in of_cause.items()
        ]
    # Derivatives of the stage, and one pass for the further ones of all causes of one shape.
    parts, place = [frozen.jacobian], {(0, n): k for k, n in enumerate(frozen.names)}
    for key, shaped in shapes.items():
        new = {n: None for _, k, wide in tried if k == key for n in wide.names}
        names = [n for n in new if n not in frozen.names]
        place |= {(key, n): len(place) + j for j, n in enumerate(names)}
        parts.append(evidence.jacobian(shaped, base.z, names))
    gradient, normal = fits.stated.normal(base.voltage_V, np.column_stack(parts))

    def gain(key: int, wide: Tolerances) -> float:
        at = [place.get((key, n), place.get((0, n), -1)) for n in wide.names]
        known = wide.prior()
        # What the prior costs at the start is not gained by a cause that widens it.
        data = 0.0, gradient[at], normal[np.ix_(at, at)]
        return -known.with_data(wide.point(base.z), *data).lowest(known.free)[0]

    none = gain(0, prior)
    left, errors = fits.squares(base)
    found: dict[str, float] = {}
    for cause, key, wide in tried:
        nats = fits.known.gained(left, 2.0 * max(gain(key, wide) - none, 0.0), errors)
        found[cause.name] = max(found.get(cause.name, 0.0), nats)
    return found


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
class SearchOutcome:
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


def decide(sets: Explanations) -> SearchOutcome:
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
    return SearchOutcome(
        tuple(accepted), fit, scale, none, first, tuple(alternatives), reasons, weighed
    )


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
    return tuple(found[: NAMING.reasons])
