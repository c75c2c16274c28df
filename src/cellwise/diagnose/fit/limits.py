"""What these logs could show at all: from sensitivities and noise, before any cause is fitted.

To second order a cause of size d changes ln p of the rows, against the tolerances alone, by

    d^2 / 2 (1 / (s^2 + t^2) - 1 / (s^2 + w^2)) - ln((s^2 + w^2) / (s^2 + t^2)) / 2

with s what the rows leave uncertain of it once everything else may move within its tolerance, t its
tolerance and w the width of a fault.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cellwise.diagnose.causes.catalogue import Cause
from cellwise.diagnose.extension import value_of
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.least_squares import Fit, normal_of, shear
from cellwise.diagnose.fit.noise import Noise
from cellwise.diagnose.fit.priors import GOOD, start_readings
from cellwise.diagnose.fit.rows import IGNORED
from cellwise.typing import FloatArray

# A coordinate that the tolerances do not have is known to be neutral [its unit]; less than this
# share of an information is what rounding leaves of none.
NEUTRAL_STD, ROUNDING = 1e-6, 1e-12
# Effects of this many times their limit must be separated ...
TIMES = 2.0
# ... by as many nats as 0.9 against 0.1 is.
APART = math.log(9.0)


@dataclass(frozen=True)
class Limits:
    """``sizes``: cause to parameter to the smallest change that these logs could show.

    ``inseparable``: groups of causes that they do not separate at twice their limits.
    """

    sizes: dict[str, dict[str, float]]
    inseparable: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, eq=False)
class _Seen:
    """What the rows say of coordinates: their information (P, P), beside tolerances (P,).

    ``wide``: cause to places of its coordinates to the widths of a fault in them.
    """

    names: list[str]
    normal: FloatArray
    tolerance: FloatArray
    wide: dict[str, dict[int, float]]

    def left(self, place: int) -> float:
        """Information of one coordinate once all others may move within their tolerances."""
        own = float(self.normal[place, place])
        others = np.arange(self.tolerance.size) != place
        pull = self.normal[others, place]
        inner = self.normal[np.ix_(others, others)] + np.diag(self.tolerance[others] ** -2.0)
        left = own - float(pull @ np.linalg.solve(inner, pull))
        return left if left > ROUNDING * own else 0.0


def limits(
    fits: CauseFits, causes: Sequence[Cause], base: Fit, noise: Noise, least: float
) -> Limits:
    """Limits of every cause; ``least`` is the evidence that is asked for [nats]."""
    names = list(fits.prior.names)
    for cause in causes:
        wanted = _coordinates(fits, cause)
        names += [n for n in wanted if n not in names]
    normal = _information(fits, base, noise, names)
    # A start that was read from a rest is read elsewhere where the OCV or the sensor is off.
    turned = shear(names, start_readings(names, fits.coordinates, fits.evidence))
    tolerance = np.array([fits.prior.std.get(n, NEUTRAL_STD) for n in names])
    wide = {c.name: _wide(fits, c, names) for c in causes}
    seen = _Seen(names, turned.T @ normal @ turned, tolerance, wide)
    sizes: dict[str, dict[str, float]] = {}
    at_limit: dict[str, FloatArray] = {}
    for cause in causes:
        found, change = _sizes(fits, cause, seen, least)
        if found:
            sizes[cause.name] = found
        if np.any(change):
            at_limit[cause.name] = change
    pairs = [
        (one, two)
        for one, two in combinations(at_limit, 2)
        if _alike(one, two, seen, at_limit) and _alike(two, one, seen, at_limit)
    ]
    return Limits(sizes, _groups(pairs))


def _information(fits: CauseFits, base: Fit, noise: Noise, names: list[str]) -> FloatArray:
    """Fisher information of all used rows at the base fit."""
    evidence, objective = fits.evidence, fits.objective(noise)
    residual = np.nan_to_num(evidence.voltage_V - base.voltage_V)
    jacobian = evidence.jacobian(base.coordinates, base.z, names)
    white = objective.scaled(np.column_stack((residual, jacobian)))
    used = evidence.known & (evidence.role != IGNORED)
    return normal_of(white, used, objective.clip)[0]


def _coordinates(fits: CauseFits, cause: Cause) -> list[str]:
    """Coordinates of a cause that mean something where it is neutral."""
    switches = cause.parameters[:1] if cause.shape is not None else cause.parameters
    if cause.kind == "start":
        return fits.evidence.starts()
    return [p.coordinate for p in switches]


def _wide(fits: CauseFits, cause: Cause, names: list[str]) -> dict[int, float]:
    """Places of a cause's coordinates and the widths of a fault in them."""
    prior = fits.widened_for((cause,), fits.coordinates)
    wanted = _coordinates(fits, cause)
    return {k: prior.std[n] for k, n in enumerate(names) if n in wanted and n in prior.std}


def _sizes(
    fits: CauseFits, cause: Cause, seen: _Seen, least: float
) -> tuple[dict[str, float], FloatArray]:
    """The limit of each parameter as people see it, and all of them as a point."""
    wide = seen.wide[cause.name]
    found: dict[str, float] = {}
    change = np.zeros(len(seen.names))
    start = fits.evidence.logs[0].start.soc
    for p in cause.parameters:
        key = "soc0:0" if p.coordinate == "soc0" else p.coordinate
        place = seen.names.index(key) if key in seen.names else -1
        if place not in wide:
            continue
        known = seen.left(place)
        if known <= 0.0:
            continue  # these logs say nothing of it
        s2 = 1.0 / known
        t2, w2 = s2 + seen.tolerance[place] ** 2, s2 + wide[place] ** 2
        if w2 <= t2:
            continue
        size = math.sqrt(2.0 * (least + 0.5 * math.log(w2 / t2)) / (1.0 / t2 - 1.0 / w2))
        change[place] = size
        if size > GOOD.ends * wide[place]:
            continue  # no fault is as large: the logs show none of it
        ends = [value_of(p.coordinate, x, fits.coordinates, start) for x in (0.0, size, -size)]
        # A change that no cell can have is none that they show.
        sizes = [abs(e - ends[0]) for e in ends[1:] if p.bounds[0] <= e <= p.bounds[1]]
        if sizes:
            found[p.name] = sizes[0]
    return found, change


def _alike(one: str, two: str, seen: _Seen, at_limit: dict[str, FloatArray]) -> bool:
    """Whether the second can explain the first at twice its limit as well as the first itself."""
    own, wide = seen.wide[one], seen.wide[two]
    information = np.diag(seen.normal)
    change = TIMES * at_limit[one]
    if len(own) > 1:
        # Of several parameters the one that shows best stands for the cause.
        place = int(np.argmax(np.abs(change) * np.sqrt(information)))
        change = np.where(np.arange(change.size) == place, change, 0.0)
    # What the rows say, not how likely such a fault is: the other's coordinates are free.
    precision = seen.tolerance**-2.0
    precision[list(wide)] = 0.0
    # What the other's coordinates and all tolerances leave of it.
    other = [k for k, i in enumerate(information) if i > 0.0 and (k not in own or k in wide)]
    pull = seen.normal @ change
    inner = seen.normal[np.ix_(other, other)] + np.diag(precision[other])
    left = float(change @ pull) - float(pull[other] @ np.linalg.solve(inner, pull[other]))
    return 0.5 * left < APART


def _groups(pairs: Sequence[tuple[str, str]]) -> tuple[tuple[str, ...], ...]:
    """Pairs that share a cause are one group."""
    groups: list[list[str]] = []
    for one, two in pairs:
        joined = [g for g in groups if one in g or two in g]
        merged = list(dict.fromkeys([*(n for g in joined for n in g), one, two]))
        groups = [g for g in groups if g not in joined] + [merged]
    return tuple(tuple(g) for g in groups)
