r"""What is free in the adaptive filter alone: a capacity or the sensor's gain, resistances.

A capacity is estimated as an offset is (:mod:`cellwise.estimate.filters.offset_kernels`): how far
one standard deviation of it would have moved the SOC is carried, and what the voltages then say
of it. The filter's own estimate stays that of the model's capacity. With an offset beside it there
are four hypotheses, and in units of the deviations beforehand, with the information L and the
score h that the voltages have brought,

.. math:: p(y | F) / p(y | \emptyset) = |L_F|^{-1/2} \exp\left(\tfrac12 h_F^T L_F^{-1} h_F\right)

for the numbers F that are free (Savage-Dickey ratio: Dickey 1971, doi:10.1214/aoms/1177693507).
Resistances are a factor on the model's, by what moves with the load within seconds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.packed import changed
from cellwise.cell.point_kernels import CellScalars
from cellwise.estimate.equations.offset import student
from cellwise.estimate.evidence_kernels import GateResult
from cellwise.estimate.filters.offset_kernels import Drift
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import CheckedReading
from cellwise.estimate.status import CURRENT_INVALID

SCALE_LOW, SCALE_HIGH = 0.2, 5.0  # of a resistance
LONGER = 10.0  # mean squares are taken over this many times the means
LARGEST_SQUARE = 1e6  # beyond it nothing is uncertain, and a sixteenth power no number


class Resistances(NamedTuple):
    """A factor on R0 and R1, and the means it is estimated from.

    ``drop`` and ``miss`` are running means of R0 I + v1 and of the innovation, and mean squares of
    what moves beside them.
    """

    factor: float
    variance: float
    drop_V: float
    miss_V: float
    drop_V2: float
    miss_V2: float


class ResistanceRules(NamedTuple):
    """What is known of the factor before any data, and how the load has to move to show it.

    ``variance`` beforehand, 0 where it is not estimated, ``wander`` per second; held while the
    mean square of what moves within ``fast_s`` is below ``swing_V2``.
    """

    variance: float
    wander: float
    swing_V2: float
    fast_s: float


@inline
def no_resistances(variance: float) -> Resistances:
    """The model's own, known to a variance."""
    return Resistances(1.0, variance, 0.0, 0.0, 0.0, 0.0)


@inline
def watch_resistances(
    r: Resistances,
    rules: ResistanceRules,
    drop_V: float,
    innovation_V: float,
    white_V2: float,
    dt_s: float,
    hold: bool,
) -> Resistances:
    """The factor by recursive least squares, where the load moves enough.

    ``drop_V`` is R0 I + v1 without the factor. It is judged by what moves within ``fast_s``: no
    error of an OCV is that fast. The noise is what the innovations show in the same band, one piece
    of evidence in twice the band's time.
    """
    near = min(dt_s / rules.fast_s, 1.0)
    left_V = innovation_V + (r.factor - 1.0) * drop_V  # with the factor, which the voltage has not
    drop_mean = r.drop_V + near * (drop_V - r.drop_V)
    miss_mean = r.miss_V + near * (left_V - r.miss_V)
    drop, miss = drop_V - drop_mean, left_V - miss_mean
    share = near / LONGER
    drop2 = r.drop_V2 + share * (drop * drop - r.drop_V2)
    miss2 = r.miss_V2 + share * (miss * miss - r.miss_V2)
    factor, variance = r.factor, r.variance
    if drop2 >= rules.swing_V2 and not hold and dt_s > 0.0:
        noise = max(miss2, white_V2) * max(2.0 * rules.fast_s / dt_s, 1.0)
        k = variance * drop / (drop * drop * variance + noise)
        factor = min(max(factor - k * miss, SCALE_LOW), SCALE_HIGH)
        variance -= k * drop * variance
    return Resistances(factor, variance, drop_mean, miss_mean, drop2, miss2)


@inline
def wandered(r: Resistances, rules: ResistanceRules, dt_s: float) -> Resistances:
    """Uncertainty of the resistances comes back, up to what it was before any data."""
    if r.variance >= rules.variance:
        return r
    return changed(r, "variance", r.variance + rules.wander * dt_s)


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
def nothing_known(rules: FreeRules | None) -> Free | None:
    """Nothing counted yet, the model's own values; None where nothing is free."""
    if rules is None:
        return None
    capacity = Capacity(0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return Free(capacity, no_resistances(rules.resistances.variance))


@inline
def soc_found(free: Free | None) -> Free | None:
    """After a SOC that was searched for: what was counted is over, what is known stays."""
    if free is None:
        return None
    c = changed(changed(free.capacity, "reach", 0.0), "cross", 0.0)
    return Free(changed(c, "shared", 0.0), free.resistances)


@inline
def waiting(rules: FreeRules | None, free: Free | None, drift: Drift) -> Free | None:
    """While the SOC is not known: what is known of capacity and resistances beforehand."""
    if rules is None or free is None:
        return None
    capacity, _ = weighed(free.capacity, drift, rules)
    return soc_found(Free(capacity, free.resistances))


@inline
def forgotten(c: Capacity, d: Drift, rules: FreeRules, dt_s: float) -> tuple[Capacity, Drift]:
    """Both numbers wander: of what the voltages have said, so much is forgotten.

    The same of both, by the one that is forgotten faster: else the remainder of one and the same
    evidence would speak for the other.
    """
    faster = max(c.information * rules.capacity_wander, d.information * rules.offset_wander)
    keep = max(1.0 - faster * dt_s, 0.0)
    c = changed(changed(c, "score", keep * c.score), "cross", keep * c.cross)
    c = changed(c, "information", 1.0 + keep * (c.information - 1.0))
    d = changed(d, "score", keep * d.score)
    return c, changed(d, "information", 1.0 + keep * (d.information - 1.0))


@inline
def likelihood(square: float, best: float, determinant: float) -> float:
    """Of a hypothesis against none, where the ``best`` of all has that square.

    That anything is free at all is as sure as an offset is (Student's t of 31 degrees of freedom);
    which of them it is, the normal density says.
    """
    sure = student(min(best, LARGEST_SQUARE))
    return sure * math.exp(0.5 * (square - best)) / math.sqrt(determinant)


@inline
def weighed(c: Capacity, d: Drift, rules: FreeRules) -> tuple[Capacity, Drift]:
    """Mean and covariance of offset and capacity over the four hypotheses."""
    h, l1, l2, x = d.score, d.information, c.information, c.cross
    det = l1 * l2 - x * x
    one, two = h / l1, c.score / l2
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
    d = changed(changed(d, "believed", mean1), "unsure", unsure1)
    return Capacity(c.reach, c.score, l2, x, mean2, unsure2, shared, w2 + both, w1 + both), d


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
    c = changed(c, "reach", c.reach + rules.capacity * per_A * counted_A)
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
    of_capacity_V = slope_V * c.reach
    read = informs * of_capacity_V if soc_variance <= rules.settled_variance else 0.0
    c = changed(c, "score", c.score + read * own_V)
    c = changed(c, "information", c.information + read * of_capacity_V)
    c = changed(c, "cross", c.cross + read * of_offset_V)
    c = changed(c, "reach", c.reach - gain * of_capacity_V)
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
    of_capacity_V = slope_V * c.reach
    return of_capacity_V * (of_capacity_V * c.unsure + 2.0 * of_offset_V * c.shared)


@inline
def watched_resistances(
    rules: FreeRules | None,
    free: Free | None,
    noise: NoiseScalars,
    reading: CheckedReading,
    drop_V: float,
    gate_result: GateResult,
    soc_variance: float,
) -> Free | None:
    """What moves with the load, R0 I + v1 as the model's, says what the resistances are.

    They are reported; voltage and SOC keep the model's own.
    """
    if rules is None or free is None:
        return None
    r = free.resistances
    if gate_result.used and not reading.gap:
        white = noise.voltage_V * noise.voltage_V
        hold = reading.status & CURRENT_INVALID != 0 or soc_variance > rules.settled_variance
        r = watch_resistances(
            r, rules.resistances, drop_V, gate_result.innovation_V, white, reading.dt_s, hold
        )
    return Free(free.capacity, r)
