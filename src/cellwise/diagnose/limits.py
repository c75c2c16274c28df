"""What these logs could show at all: the smallest size of every cause, what looks alike.

Limits come from sensitivities and noise, before any cause is fitted. To second order a cause of
size d changes ln p of the rows, against the tolerances alone, by

    d^2 / 2 (1 / (s^2 + t^2) - 1 / (s^2 + w^2)) - ln((s^2 + w^2) / (s^2 + t^2)) / 2

with s what the rows leave uncertain of it once everything else may move within its tolerance, t its
tolerance and w the width of a fault.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from cellwise.diagnose.causes.catalogue import Cause
from cellwise.diagnose.extension import value_of
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.least_squares import Fit, shear
from cellwise.diagnose.fit.priors import GOOD, start_readings
from cellwise.typing import FloatArray


class Shown(NamedTuple):
    """When logs show an effect.

    ``neutral_std``: a coordinate that the tolerances do not have is known to be neutral [its unit];
    less than ``rounding`` of an information, or of a fault's, is what differences leave of none.
    Effects of ``times`` their limit must be separated by ``apart`` nats, as much as 0.9 against 0.1
    is.
    """

    neutral_std: float = 1e-6
    rounding: float = 1e-12
    times: float = 2.0
    apart: float = math.log(9.0)


SHOWN = Shown()


@dataclass(frozen=True)
class Limits:
    """``sizes``: cause to parameter to the smallest change that these logs could show.

    ``inseparable``: groups of causes that they do not separate at twice their limits.
    """

    sizes: dict[str, dict[str, float]]
    inseparable: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, eq=False)
class _Seen:
    """What the rows say of coordinates: their information (P, P), beside tolerances (P,)."""

    names: list[str]
    normal: FloatArray
    tolerance: FloatArray

    def left(self, change: FloatArray, free: Sequence[int]) -> float:
        """Information in a change (P,) once all it does not touch may move.

        Within their tolerances; those in ``free`` by any amount, whether it touches them or not.
        """
        precision = self.tolerance**-2.0
        precision[list(free)] = 0.0
        seen = np.diag(self.normal) > 0.0
        other = [k for k, s in enumerate(seen) if s and (change[k] == 0.0 or k in free)]
        pull = self.normal @ change
        inner = self.normal[np.ix_(other, other)] + np.diag(precision[other])
        return float(change @ pull) - float(pull[other] @ np.linalg.solve(inner, pull[other]))


def limits(
    fits: CauseFits, causes: Sequence[Cause], base: Fit, scale: float, least: float
) -> Limits:
    """Limits of every cause; ``least`` is the evidence that is asked for [nats]."""
    names = list(dict.fromkeys([*fits.prior.names, *(n for c in causes for n in _keys(fits, c))]))
    jacobian = fits.evidence.jacobian(base.coordinates, base.z, names)
    normal, _ = fits.stated.times(scale).normal(base.voltage_V, jacobian)
    # A start that was read from a rest is read elsewhere where the OCV or the sensor is off.
    turned = shear(names, start_readings(names, fits.coordinates, fits.evidence))
    tolerance = np.array([fits.prior.std.get(n, SHOWN.neutral_std) for n in names])
    seen = _Seen(names, turned.T @ normal @ turned, tolerance)
    sizes: dict[str, dict[str, float]] = {}
    at_limit: dict[str, FloatArray] = {}
    places: dict[str, list[int]] = {}
    for cause in causes:
        wide = fits.widened_for((cause,), fits.coordinates).std
        places[cause.name] = [names.index(n) for n in _keys(fits, cause) if n in wide]
        found, change = _sizes(
            fits, cause, seen, {k: wide[names[k]] for k in places[cause.name]}, least
        )
        if found:
            sizes[cause.name] = found
        if np.any(change):
            at_limit[cause.name] = change
    pairs = [
        {one, two}
        for one, two in combinations(at_limit, 2)
        if _alike(at_limit[one], places[two], seen) and _alike(at_limit[two], places[one], seen)
    ]
    return Limits(sizes, _groups(pairs, list(at_limit)))


def _keys(fits: CauseFits, cause: Cause) -> list[str]:
    """Coordinates of a cause that mean something where it is neutral."""
    if cause.kind == "start":
        return fits.evidence.starts()
    switches = cause.parameters[:1] if cause.shape is not None else cause.parameters
    return [p.coordinate for p in switches]


def _sizes(
    fits: CauseFits, cause: Cause, seen: _Seen, wide: dict[int, float], least: float
) -> tuple[dict[str, float], FloatArray]:
    """The limit of each parameter as people see it, and all of them as a point.

    ``wide``: places of its coordinates to the widths of a fault in them.
    """
    found: dict[str, float] = {}
    change = np.zeros(len(seen.names))
    start = fits.evidence.logs[0].start.soc
    for p in cause.parameters:
        place = seen.names.index(p.key) if p.key in seen.names else -1
        if place not in wide:
            continue
        unit = np.eye(len(seen.names))[place]
        known = seen.left(unit, ())
        if known <= SHOWN.rounding * max(float(seen.normal[place, place]), wide[place] ** -2):
            continue  # these logs say nothing of it
        t2, w2 = 1.0 / known + seen.tolerance[place] ** 2, 1.0 / known + wide[place] ** 2
        if w2 <= t2:
            continue
        size = math.sqrt(2.0 * (least + 0.5 * math.log(w2 / t2)) / (1.0 / t2 - 1.0 / w2))
        change[place] = size
        if size > GOOD.ends * wide[place]:
            continue  # no fault is as large: the logs show none of it
        ends = [value_of(p, x, fits.coordinates, start) for x in (0.0, size, -size)]
        # A change that no cell can have is none that they show.
        sizes = [abs(e - ends[0]) for e in ends[1:] if p.bounds[0] <= e <= p.bounds[1]]
        if sizes:
            found[p.name] = sizes[0]
    return found, change


def _alike(change: FloatArray, other: Sequence[int], seen: _Seen) -> bool:
    """Whether another cause's coordinates can explain a change at twice its limit as well.

    Of several parameters the one that shows best stands for the cause. What the rows say, not how
    likely such a fault is.
    """
    place = int(np.argmax(np.abs(change) * np.sqrt(np.diag(seen.normal))))
    shown = np.where(np.arange(change.size) == place, SHOWN.times * change, 0.0)
    return 0.5 * seen.left(shown, other) < SHOWN.apart


def _groups(pairs: Sequence[set[str]], order: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Pairs that share a cause are one group."""
    groups: list[set[str]] = []
    for pair in pairs:
        joined = [g for g in groups if g & pair]
        groups = [g for g in groups if g not in joined] + [pair.union(*joined)]
    return tuple(tuple(n for n in order if n in g) for g in groups)
