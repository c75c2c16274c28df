r"""What is free in the adaptive filter alone: a capacity or the sensor's gain, resistances.

A capacity is estimated as an offset is (:mod:`cellwise.estimate.filters.drift_kernels`): how far
one standard deviation of it would have moved the SOC is carried, and what the voltages then say
of it. The filter's own estimate stays that of the model's capacity. With an offset beside it there
are four hypotheses, and in units of the deviations beforehand, with the information L and the
score h that the voltages have brought,

.. math:: p(y | F) / p(y | \emptyset) = |L_F|^{-1/2} \exp\left(\tfrac12 h_F^T L_F^{-1} h_F\right)

for the numbers F that are free (Savage-Dickey ratio: Dickey 1971, doi:10.1214/aoms/1177693507).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.point_kernels import CellScalars
from cellwise.estimate.adaptive.resistance_kernels import (
    ResistanceRules,
    Resistances,
    no_resistances,
    wandered,
    watch_resistances,
)
from cellwise.estimate.evidence_kernels import Verdict
from cellwise.estimate.filters.drift_kernels import PER_FREEDOM, Drift
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import Sample
from cellwise.estimate.status import CURRENT_INVALID

LARGEST_SQUARE = 1e6  # beyond it nothing is uncertain, and a sixteenth power no number


class Capacity(NamedTuple):
    """What is known of a capacity that is another one, per standard deviation that it has before.

    ``reach`` is the SOC by which one of them puts the filter's own estimate too low; ``score`` and
    ``information`` what the voltages say of it alone, ``cross`` the information that it shares
    with the offset. Over all hypotheses ``believed`` is its mean, ``unsure`` its variance,
    ``shared`` its covariance with the offset, ``chance`` and ``offset_chance`` the probabilities
    that either is not the model's.
    """

    reach: float
    score: float
    information: float
    cross: float
    believed: float
    unsure: float
    shared: float
    chance: float
    offset_chance: float


class FreeRules(NamedTuple):
    """What is free in the adaptive filter, what is known of it before any data, how it may move.

    ``capacity`` is the deviation of the model's capacity over the cell's, ``capacity_odds`` and
    ``offset_odds`` those of either not being the model's, 0 where it is not estimated. The wanders
    are variances per second, in units of the variances beforehand. ``settled_variance`` of the SOC
    is that beyond which nothing is said of anything but an offset.
    """

    capacity: float
    capacity_odds: float
    offset_odds: float
    capacity_wander: float
    offset_wander: float
    settled_variance: float
    resistances: ResistanceRules


class Free(NamedTuple):
    """What the adaptive filter carries beside the state of the others."""

    capacity: Capacity
    resistances: Resistances


@inline
def no_capacity() -> Capacity:
    """Nothing counted yet, nothing known."""
    return Capacity(0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@inline
def afresh(rules: FreeRules | None, free: Free | None) -> Free | None:
    """Nothing known; None where nothing is free."""
    if rules is None or free is None:
        return None
    return Free(no_capacity(), no_resistances(rules.resistances.variance))


@inline
def soc_found(free: Free | None) -> Free | None:
    """After a SOC that was searched for: what was counted is over, what is known stays."""
    if free is None:
        return None
    c = free.capacity
    # fmt: off
    c = Capacity(
        0.0, c.score, c.information, 0.0, c.believed, c.unsure, 0.0, c.chance, c.offset_chance
    )
    # fmt: on
    return Free(c, free.resistances)


@inline
def forgotten(c: Capacity, d: Drift, rules: FreeRules, dt_s: float) -> tuple[Capacity, Drift]:
    """Both numbers wander: of what the voltages have said, so much is forgotten.

    The same of both, by the one that is forgotten faster: else the remainder of one and the same
    evidence would speak for the other.
    """
    faster = max(c.information * rules.capacity_wander, d.information * rules.offset_wander)
    keep = max(1.0 - faster * dt_s, 0.0)
    less = 1.0 + keep * (c.information - 1.0)
    # fmt: off
    c = Capacity(
        c.reach, keep * c.score, less, keep * c.cross, c.believed, c.unsure, c.shared, c.chance,
        c.offset_chance,
    )
    # fmt: on
    less = 1.0 + keep * (d.information - 1.0)
    offset = keep * d.offset * (d.information / less)
    # fmt: off
    return c, Drift(
        d.reach, offset, less, d.believed, d.unsure, d.d1_V, d.d2_V, d.d3_V, d.rest_s, d.rest_A
    )
    # fmt: on


@inline
def likelihood(square: float, best: float, determinant: float) -> float:
    """Of a hypothesis against none, where the ``best`` of all has that square.

    That anything is free at all is as sure as an offset is (Student's t of 31 degrees of freedom);
    which of them it is, the normal density says.
    """
    base = 1.0 + min(best, LARGEST_SQUARE) * PER_FREEDOM
    base *= base
    base *= base
    base *= base
    base *= base
    return base * math.exp(0.5 * (square - best)) / math.sqrt(determinant)


@inline
def weighed(c: Capacity, d: Drift, rules: FreeRules) -> tuple[Capacity, Drift]:
    """Mean and covariance of offset and capacity over the four hypotheses."""
    h, l1, l2, x = d.offset * d.information, d.information, c.information, c.cross
    det = l1 * l2 - x * x
    one, two = d.offset, c.score / l2
    b, q = (l2 * h - x * c.score) / det, (l1 * c.score - x * h) / det
    best = h * b + c.score * q
    w1 = rules.offset_odds * likelihood(h * one, best, l1)
    w2 = rules.capacity_odds * likelihood(c.score * two, best, l2)
    both = rules.offset_odds * rules.capacity_odds * likelihood(best, best, det)
    per = 1.0 / ((1.0 + w1) + (w2 + both))
    w1, w2, both = w1 * per, w2 * per, both * per
    mean1, mean2 = w1 * one + both * b, w2 * two + both * q
    unsure1 = (w1 * (1.0 / l1 + one * one) + both * (l2 / det + b * b)) - mean1 * mean1
    unsure2 = (w2 * (1.0 / l2 + two * two) + both * (l1 / det + q * q)) - mean2 * mean2
    shared = both * (b * q - x / det) - mean1 * mean2
    # fmt: off
    return Capacity(
        c.reach, c.score, l2, x, mean2, unsure2, shared, w2 + both, w1 + both
    ), Drift(
        d.reach, one, l1, mean1, unsure1, d.d1_V, d.d2_V, d.d3_V, d.rest_s, d.rest_A
    )
    # fmt: on


@inline
def counted_capacity(
    cell: CellScalars,
    rules: FreeRules | None,
    free: Free | None,
    drift: Drift,
    gs: float,
    counted_A: float,
    dt_s: float,
) -> tuple[Free | None, Drift]:
    """After an interval that has counted ``counted_A``; ``gs`` is what one ampere adds to SOC.

    Beyond the model's data no voltage can separate a capacity from the model's error: there
    nothing is counted.
    """
    if rules is None or free is None:
        return None, drift
    c, d = forgotten(free.capacity, drift, rules, dt_s)
    per_A = gs * (1.0 if counted_A > 0.0 else cell.charge_efficiency)
    # fmt: off
    c = Capacity(
        c.reach + rules.capacity * per_A * counted_A, c.score, c.information, c.cross, c.believed,
        c.unsure, c.shared, c.chance, c.offset_chance,
    )
    # fmt: on
    return Free(c, wandered(free.resistances, rules.resistances, dt_s)), d


@inline
def informed_capacity(
    rules: FreeRules | None,
    free: Free | None,
    drift: Drift,
    of_offset_V: float,
    slope_V: float,
    own_V: float,
    gain: float,
    informs: float,
    soc_variance: float,
) -> tuple[Free | None, Drift]:
    """After a voltage: capacity, and offset by all four hypotheses.

    As for the offset: ``of_offset_V`` is what one deviation of that moves the voltage by,
    ``own_V`` the innovation of the filter's own estimate, ``informs`` one over its variance. While
    the SOC is not settled nothing is said of the capacity.
    """
    if rules is None or free is None:
        return None, drift
    c = free.capacity
    seen = slope_V * c.reach
    read = informs * seen if soc_variance <= rules.settled_variance else 0.0
    # fmt: off
    c = Capacity(
        c.reach - gain * seen, c.score + read * own_V, c.information + read * seen,
        c.cross + read * of_offset_V, c.believed, c.unsure, c.shared, c.chance, c.offset_chance,
    )
    # fmt: on
    c, drift = weighed(c, drift, rules)
    return Free(c, free.resistances), drift


@inline
def capacity_soc(free: Free | None) -> float:
    """By how much what is believed of the capacity moves the SOC."""
    if free is None:
        return 0.0
    return free.capacity.believed * free.capacity.reach


@inline
def capacity_variance(free: Free | None, offset_reach: float) -> float:
    """What it adds to the SOC's variance, beside what an offset adds."""
    if free is None:
        return 0.0
    c = free.capacity
    return c.reach * (c.reach * c.unsure + 2.0 * offset_reach * c.shared)


@inline
def capacity_variance_V2(free: Free | None, slope_V: float, of_offset_V: float) -> float:
    """What it adds to the variance of a voltage, beside what an offset adds [V^2]."""
    if free is None:
        return 0.0
    c = free.capacity
    seen = slope_V * c.reach
    return seen * (seen * c.unsure + 2.0 * of_offset_V * c.shared)


@inline
def watched_resistances(
    rules: FreeRules | None,
    free: Free | None,
    noise: NoiseScalars,
    s: Sample,
    drop_V: float,
    tail_V: float,
    v: Verdict,
    soc_variance: float,
) -> Free | None:
    """What moves with the load says what the resistances are: R0 I + v1, and v2, as the model's.

    They are reported, and the state of power takes them; voltage and SOC keep the model's own.
    """
    if rules is None or free is None:
        return None
    r = free.resistances
    if v.used and not s.gap:
        white = noise.voltage_V * noise.voltage_V
        hold = s.status & CURRENT_INVALID != 0 or soc_variance > rules.settled_variance
        # fmt: off
        r = watch_resistances(
            r, rules.resistances, drop_V, tail_V, v.innovation_V, white, s.dt_s, hold
        )
        # fmt: on
    return Free(free.capacity, r)
