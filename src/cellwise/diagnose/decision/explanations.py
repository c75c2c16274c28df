"""Sets of causes fitted together, and the odds of each: the decision.

Singles first, then what could still explain something beside the likeliest of them, fitted jointly.
A set is judged by the evidence of all rows under a noise that is never less than what the model
states of its own error, by what rests and zero readings say, and by how rare its causes are.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from cellwise.diagnose.causes.catalogue import Cause, forms_of, kept_coordinates
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.decision.odds import Rarity
from cellwise.diagnose.fit.cause_fits import CauseFits, Prediction
from cellwise.diagnose.fit.least_squares import Fit, Frozen, Prior, complete, freeze, normal_of
from cellwise.diagnose.fit.noise import Noise
from cellwise.diagnose.fit.priors import (
    USUAL,
    needs_activation,
    starts_to_try,
    widened_for,
)
from cellwise.diagnose.fit.rows import IGNORED
from cellwise.typing import FloatArray

Progress = Callable[[float, str], None]
Key = tuple[int, str]


class Search(NamedTuple):
    """How far sets of causes are searched.

    ``beam`` sets of one size get further causes, ``added`` to each, up to ``most_causes``. One
    step is no bound on what a fit gains: beside a set that is better than nothing, a cause is tried
    where ``tried_share`` of its rarity is in sight.
    """

    beam: int = 4
    added: int = 5
    most_causes: int = 4
    tried_share: float = 0.5


SEARCH = Search()


@dataclass(frozen=True, eq=False)
class Explanation:
    """A set of causes fitted to all logs, and how likely the rows are with it."""

    causes: tuple[Cause, ...]
    fit: Fit
    noise: Noise
    prior: Prior
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
    """All sets that were tried in one diagnosis; ``refused`` says which causes fit no bounds."""

    fits: CauseFits
    rarity: Rarity
    progress: Progress | None = None
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    tried: dict[frozenset[str], Explanation] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)

    def odds(self, one: Explanation) -> float:
        """Ln of the odds of a set against no cause, up to the weight of blocks [nats]."""
        return self._gain(one) - self.rarity.nats(one.names)

    def _gain(self, one: Explanation) -> float:
        return one.found.total - self.tried[frozenset()].found.total

    def best(self, many: int, size: int | None = None) -> list[Explanation]:
        """The likeliest sets, of one size or of any."""
        sets = [e for e in self.tried.values() if size is None or len(e.causes) == size]
        return sorted(sets, key=self.odds, reverse=True)[:many]

    def search(self, causes: Sequence[Cause], base: Fit, noise: Noise) -> None:
        """Try sets of causes on top of the base until one more gains less than its rarity."""
        here = self._freeze(base, noise, self.fits.prior)
        none = self._explained((), base, noise, self.fits.prior, here)
        self.tried[frozenset()] = none
        with ThreadPoolExecutor(self.workers) as threads:
            for size in range(1, SEARCH.most_causes + 1):
                if not self._with_one_more(causes, size, threads):
                    break

    def _with_one_more(
        self, causes: Sequence[Cause], size: int, threads: ThreadPoolExecutor
    ) -> bool:
        """Try sets of a size; whether one of them, or of the size before, is the likeliest."""
        starts = self.best(SEARCH.beam, size - 1)
        keys = [s.key for s in starts]
        frozen = dict(zip(keys, threads.map(self._frozen, starts), strict=True))
        promising = threads.map(lambda s: self._promising(s, causes, frozen[s.key]), starts)
        todo = self._once((s, c) for s, more in zip(starts, promising, strict=True) for c in more)

        def work(task: tuple[Explanation, Cause]) -> Explanation | None:
            start, cause = task
            return self._added(start, cause, frozen[start.key])

        for k, one in enumerate(threads.map(work, todo)):
            self._say(size, (k + 1) / len(todo), todo[k][1].name)
            if one is not None:
                self._keep(one)
        return self._gained(size)

    def _gained(self, size: int) -> bool:
        """Two causes may explain together what neither does alone."""
        return len(self.best(1)[0].causes) >= size - 1

    def _once(self, todo: Iterable[tuple[Explanation, Cause]]) -> list[tuple[Explanation, Cause]]:
        """Every set once, from the likeliest it can be made of."""
        found: dict[frozenset[str], tuple[Explanation, Cause]] = {}
        for start, cause in todo:
            found.setdefault(start.key | {cause.name}, (start, cause))
        return [t for key, t in found.items() if key not in self.tried]

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

    def _frozen(self, start: Explanation) -> Frozen:
        return self._freeze(start.fit, start.noise, start.prior)

    def _freeze(self, found: Fit, noise: Noise, prior: Prior) -> Frozen:
        return freeze(self.fits.objective(noise), found.coordinates, prior.names, found.z)

    def _added(self, start: Explanation, cause: Cause, frozen: Frozen) -> Explanation | None:
        """A set with one more cause, all of it fitted; None where the cause stays away."""
        forms = forms_of(cause, start.fit.coordinates)
        ends = [self._with_form(start, form, frozen) for form in forms]
        physical = [e for e in ends if not unphysical(e)]
        if not physical:
            if not start.causes:
                self.refused[cause.name] = unphysical(ends[0])
            return None
        return max(physical, key=lambda e: e.found.total)

    def _with_form(self, start: Explanation, cause: Cause, frozen: Frozen) -> Explanation:
        """A set with one form of one more cause, all of it fitted, from its best beginning."""
        fits, evidence = self.fits, self.fits.evidence
        causes = (*start.causes, cause)
        moving = [*kept_coordinates(causes), *evidence.starts()]
        found: list[Fit] = []
        beginnings = starts_to_try(cause, start.fit.coordinates, evidence)
        for shaped, beginning in beginnings:
            wide = widened_for(start.prior, cause, shaped, evidence)
            point = {**start.fit.z, **beginning}
            if cause.name == "self_heating":
                point["rth_K_per_W"] = 1.0
                if needs_activation(shaped):
                    point["activation_K"] = USUAL.activation_K
            steps = 1 if len(beginnings) > 1 else 5
            found.append(fits.fit(start.noise, shaped, wide, point, steps, frozen, moving))
        near = max(found, key=lambda f: f.log_evidence)
        shaped = near.coordinates
        wide = widened_for(start.prior, cause, shaped, evidence)
        if len(beginnings) > 1:
            near = fits.fit(start.noise, shaped, wide, near.z, 3, frozen, moving)
        noise = fits.noise(near, wide)
        here = self._freeze(near, noise, wide)
        near = fits.fit(noise, shaped, wide, near.z, 5, here, moving)
        return self._explained(causes, near, noise, wide, here)

    def _keep(self, one: Explanation) -> None:
        known = self.tried.get(one.key)
        if known is None or one.found.total > known.found.total:
            self.tried[one.key] = one

    def _explained(
        self, causes: tuple[Cause, ...], found: Fit, noise: Noise, prior: Prior, near: Frozen
    ) -> Explanation:
        found = complete(self.fits.objective(noise), found, prior)
        likely = self.fits.explained(found, noise, prior, causes, near)
        return Explanation(causes, found, noise, prior, likely)

    def _say(self, size: int, part: float, name: str) -> None:
        if self.progress is not None:
            self.progress(1.0 - 0.5 ** (size - 1 + part), name.replace("_", " "))


def unphysical(one: Explanation) -> str:
    """Whether what switches an effect on has stayed off, or a value stands at its bound."""
    z = one.fit.z
    for cause in one.causes:
        if cause.shape is not None:
            switch = cause.parameters[0]
            if z.get(switch.coordinate, 0.0) == 0.0:
                return f"{cause.name} fits best with {switch.name} at zero"
        for p in cause.parameters:
            x = z.get(p.coordinate)
            ends = (one.prior.low.get(p.coordinate), one.prior.high.get(p.coordinate))
            if x is not None and x in ends:
                return f"{cause.name} would need {p.name} outside its physical bounds"
    return ""


def could_explain(
    fits: CauseFits, causes: Sequence[Cause], base: Fit, prior: Prior, frozen: Frozen
) -> dict[str, float]:
    """Nats that every cause would gain at most by one Gauss-Newton step from a fit.

    Rao's score test: gradient and information at the null hypothesis, where nothing of the cause
    is fitted yet; what it takes off the squares counts by the scale that both leave. Causes with a
    memory are tried at each of those from which their search starts.
    """
    evidence, objective = fits.evidence, fits.objective(Noise())
    tried = [
        (form, shaped, widened_for(prior, form, shaped, evidence))
        for cause in causes
        for form in forms_of(cause, base.coordinates)
        for shaped in _shapes(fits, form, base)
    ]
    columns, place = _columns(fits, tried, base.z, frozen)
    residual = np.nan_to_num(evidence.voltage_V - base.voltage_V)
    white = objective.scaled(np.column_stack((residual, columns)))
    used = evidence.known & (evidence.role != IGNORED)
    normal, gradient = normal_of(white, used, objective.clip)
    names = list(frozen.names)
    none = _gain(normal, gradient, [place[0, n] for n in names], prior, names, base.z)
    left, errors = fits.squares(base)
    found: dict[str, float] = {}
    for k, (cause, _, wide) in enumerate(tried, 1):
        known = [place.get((k, n), place.get((0, n), -1)) for n in wide.names]
        more = _gain(normal, gradient, known, wide, wide.names, base.z)
        nats = fits.known.gained(left, 2.0 * max(more - none, 0.0), errors)
        found[cause.name] = max(found.get(cause.name, 0.0), nats)
    return found


def _shapes(fits: CauseFits, cause: Cause, base: Fit) -> list[Coordinates]:
    """Coordinates at every memory from which the search for a cause starts, each once."""
    shapes = [s for s, _ in starts_to_try(cause, base.coordinates, fits.evidence)]
    return list({id(s): s for s in shapes}.values())


def _columns(
    fits: CauseFits,
    tried: Sequence[tuple[Cause, Coordinates, Prior]],
    z: Mapping[str, float],
    frozen: Frozen,
) -> tuple[FloatArray, dict[Key, int]]:
    """Derivatives of the stage, those of every cause beside them, and where each stands."""
    parts = [frozen.jacobian]
    place = {(0, n): k for k, n in enumerate(frozen.names)}
    many = len(frozen.names)
    together: dict[int, list[tuple[int, str]]] = {}  # one pass for all causes of one shape
    shapes = {id(shaped): shaped for _, shaped, _ in tried}
    for k, (_, shaped, wide) in enumerate(tried, 1):
        new = [(k, n) for n in wide.names if n not in frozen.names]
        together.setdefault(id(shaped), []).extend(new)
    for shape, keys in together.items():
        if keys:
            parts.append(fits.evidence.jacobian(shapes[shape], z, [n for _, n in keys]))
            place |= {key: many + j for j, key in enumerate(keys)}
            many += len(keys)
    return np.column_stack(parts), place


def _gain(
    normal: FloatArray,
    gradient: FloatArray,
    place: Sequence[int],
    prior: Prior,
    names: Sequence[str],
    z: Mapping[str, float],
) -> float:
    """Nats that the best step of some coordinates gains, under their prior."""
    weight = prior.precision()
    away = np.array([z.get(n, 0.0) - prior.mean.get(n, 0.0) for n in names])
    pull = gradient[list(place)] - weight @ away
    # What the prior costs at the start is not gained by a cause that widens it.
    start = 0.5 * float(away @ weight @ away)
    return 0.5 * float(pull @ np.linalg.solve(normal[np.ix_(place, place)] + weight, pull)) - start
