"""Capacity that a target estimates beside the fixed step, between two rests far apart.

After a long rest the voltage is the OCV, and the OCV gives the SOC whatever the capacity is. What
was counted between two such rests is the SOC between them times the share of the model's capacity
that is left, less what a current sensor that is off has taken over the time:

    counted = share (soc_b - soc_a) - off (t_b - t_a)

Both unknowns are followed by a filter of two states. Where the table of the OCV is off it is off at
the next rest there, too: no number of rests averages that out. What such an error has moved is
carried beside the covariance (consider covariance; Schmidt 1966, p. 293).
"""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.description import H
from cellwise.cell.unrolled import unrolled_by_option
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.innovation import extrapolated
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import (
    ERROR_V,
    M_V,
    OCV_V,
    Place,
    place_now,
    read,
    soc_place,
)


class RestedSoc(NamedTuple):
    """SOC of a cell at rest by its OCV, and the variance of that."""

    soc: float
    variance: float


class Weight(NamedTuple):
    """Of a pair of rests for the share and the offset; ``total`` is the variance of its count."""

    total: float
    share: float
    off: float


def forget_share(a: Soh) -> None:
    """Nothing is known of the capacity, nor of an offset, but what is usual."""
    a.share_variance = SOH_VARIANCE
    a.off = 0.0
    a.qq = SOH_VARIANCE
    a.qo = 0.0
    a.oo = CHANCE
    a.own_qq = SOH_VARIANCE
    a.own_qo = 0.0
    a.own_oo = CHANCE
    a.share_error = 0.0
    a.off_error = 0.0
    a.refused = U(0)


def forget_resistance(a: Soh) -> None:
    """Nothing is known of the resistances but what is usual."""
    a.resistance = 1.0
    a.rr = SOH_RESISTANCE
    a.resistance_variance = SOH_RESISTANCE


def begin_at_rest(a: Soh, soc: float, variance: float) -> None:
    """Count from a rest; a variance of 0: from none."""
    a.soc = soc
    a.variance = variance
    a.counted = 0.0
    a.counted_carry = 0.0
    a.unsure = 0.0
    a.counted_from = a.sequence


def state_variance(c: Constants, a: Soh) -> None:
    """What is stated of the share: beside the pairs' error, that of the OCV and of the model.

    The model's capacity is that of another sample: by as much a share of it may be none of what
    this cell had when it was new, however many pairs there are.
    """
    model = a.share * c.soh_capacity
    error = a.own_qq + ((a.share_error * a.share_error) + (model * model))
    a.share_variance = at_most(error, SOH_VARIANCE)


def age(c: Constants, a: Soh) -> None:
    """What has flowed may have aged the cell."""
    more = SOH_WALK * a.moved
    a.rr = at_most(a.rr + (SOH_RESISTANCE_WALK * a.moved), SOH_RESISTANCE)
    a.qq = at_most(a.qq + more, SOH_VARIANCE)
    a.own_qq = at_most(a.own_qq + more, SOH_VARIANCE)
    state_variance(c, a)
    a.moved = 0.0


def start_soh(m: Model, a: Soh) -> None:
    """Before the first sample: the capacity of the tables, known as that of any used cell."""
    a.share = 1.0
    forget_share(a)
    forget_resistance(a)
    a.moved = 0.0
    a.sequence = U(0)
    begin_at_rest(a, 0.0, 0.0)
    a.current_A = 0.0
    a.voltage_V = 0.0
    a.held_V = 0.0
    a.loaded = U(0)
    a.silent = U(0)
    a.pairs = U(0)
    a.loads = U(0)
    a.watched = U(0)
    a.rest_end = U(0)
    a.begun = U(0)


def soh_is_sound(a: Soh) -> bool:
    """Every number in its range: memory that lost its content, or was never set, is noticed."""
    if not positive_within(a.share, LEAST_SHARE, MOST_SHARE):
        return False
    if not (not_negative(a.share_variance, LARGE) and size_within(a.off, REACH_MOST)):
        return False
    if not (positive_within(a.qq, VARIANCE_FLOOR, 1.0) and size_within(a.qo, 1.0)):
        return False
    if not (positive_within(a.oo, VARIANCE_FLOOR, 1.0) and size_within(a.share_error, REACH_MOST)):
        return False
    if not (positive_within(a.own_qq, VARIANCE_FLOOR, 1.0) and size_within(a.own_qo, 1.0)):
        return False
    if not positive_within(a.own_oo, VARIANCE_FLOOR, 1.0):
        return False
    if not (size_within(a.off_error, REACH_MOST) and not_negative(a.soc, 1.0)):
        return False
    if not (not_negative(a.variance, 1.0) and size_within(a.counted, REACH_MOST)):
        return False
    if not (size_within(a.counted_carry, CARRY_MOST) and not_negative(a.moved, SINCE_MOST)):
        return False
    if not (not_negative(a.unsure, 1.0) and size_within(a.current_A, LARGE)):
        return False
    if not (positive_within(a.rr, VARIANCE_FLOOR, 1.0) and not_negative(a.held_V, LARGE)):
        return False
    if not (not_negative(a.resistance_variance, LARGE) and not_negative(a.voltage_V, LARGE)):
        return False
    return positive_within(a.resistance, LEAST_SCALE, MOST_SCALE)


def soc_of_ocv(m: Model, place: Place, ocv_V: float, side: float, more_V2: float) -> float:
    """Where the OCV has a voltage, within 0..1: halved down to a millionth.

    With a ``side`` of 1 or -1 the OCV is higher or lower by the deviation that the model states
    there, and ``more_V2``.
    """
    points = U(m.row.shape[1])
    below = 0.0
    above = 1.0
    for _ in range(20):
        middle = 0.5 * (below + above)
        z = soc_place(place, points, middle)
        error_V = read(m, place, z.k, ERROR_V, z.within)
        off_V = side * root(at_most((error_V * error_V) + more_V2, 4.0))  # as far as it takes
        if read(m, place, z.k, OCV_V, z.beyond) + off_V < ocv_V:
            below = middle
        else:
            above = middle
    return 0.5 * (below + above)


@noinline
@unrolled_by_option
def rested(m: Model, place: Place, x: State, a: Soh) -> RestedSoc:
    """The SOC that the last voltage of a rest says.

    What the branches still hold is part of its error: they were corrected by voltages that the
    capacity has moved, and say nothing independent of it. Its deviation is the way to where the
    voltage is one of the OCV's deviations off, the longer one: beside a plateau no slope says it.
    """
    c = m.constant
    points = U(m.row.shape[1])
    ocv_V = a.voltage_V
    if HYSTERESIS:
        before = soc_place(place, points, x.soc)
        for i in (H,):
            ocv_V = ocv_V - (read(m, place, before.k, M_V, before.within) * x.state[i])
    soc = soc_of_ocv(m, place, ocv_V, 0.0, 0.0)
    z = soc_place(place, points, soc)
    missed_V = ocv_V - read(m, place, z.k, OCV_V, z.beyond)
    more_V2 = c.fixed_V2 + ((a.held_V * a.held_V) + (missed_V * missed_V))
    if HYSTERESIS:
        m_V = read(m, place, z.k, M_V, z.within)
        for i in (H,):
            more_V2 = more_V2 + ((m_V * m_V) * x.p[i, i])
    if VALIDITY:
        beyond_V = extrapolated(c, x, 0.0, a.held_V)
        more_V2 = more_V2 + (beyond_V * beyond_V)
    above = soc_of_ocv(m, place, ocv_V, -1.0, more_V2) - soc
    below = soc - soc_of_ocv(m, place, ocv_V, 1.0, more_V2)
    wide = above if above > below else below
    variance = clip((wide * wide) + c.ocv_soc2, VARIANCE_FLOOR, 1.0)
    return RestedSoc(soc, variance)


def weigh_pair(a: Soh, far: float, gone: float, count_soc2: float, both_soc2: float) -> Weight:
    """What a pair of rests weighs: errors of the OCV as if each pair had its own."""
    qh = (a.qq * far) + (a.qo * gone)
    oh = (a.qo * far) + (a.oo * gone)
    total = ((far * qh) + (gone * oh)) + (count_soc2 + both_soc2)
    per = 1.0 / total
    return Weight(total, qh * per, oh * per)


def use_pair(
    c: Constants,
    a: Soh,
    far: float,
    gone: float,
    counted: float,
    count_soc2: float,
    both_soc2: float,
) -> None:
    """A pair of rests: counted = share far + off gone.

    ``count_soc2`` is the variance of the count, ``both_soc2`` that of both OCVs. Two covariances:
    one weighs, as if each pair had an error of the OCV of its own; of what is stated the other one
    is the part beside that error.
    """
    w = weigh_pair(a, far, gone, count_soc2, both_soc2)
    missed = counted - ((a.share * far) + (a.off * gone))
    if (missed * missed) > (c.gate_square * w.total):
        a.refused = U(a.refused + 1)
        if a.refused >= SOH_REFUSED:
            forget_share(a)
    else:
        a.share = clip(a.share + (w.share * missed), LEAST_SHARE, MOST_SHARE)
        a.off = clip(a.off + (w.off * missed), -REACH_MOST, REACH_MOST)
        a.qq = clip(a.qq - ((w.share * w.share) * w.total), VARIANCE_FLOOR, 1.0)
        a.qo = clip(a.qo - ((w.share * w.off) * w.total), -1.0, 1.0)
        a.oo = clip(a.oo - ((w.off * w.off) * w.total), VARIANCE_FLOOR, 1.0)
        # (I - K H) own (I - K H)' + K K' count_soc2
        qh = (a.own_qq * far) + (a.own_qo * gone)
        oh = (a.own_qo * far) + (a.own_oo * gone)
        whole = ((far * qh) + (gone * oh)) + count_soc2
        qq = (a.own_qq - ((2.0 * w.share) * qh)) + ((w.share * w.share) * whole)
        qo = (a.own_qo - ((w.share * oh) + (w.off * qh))) + ((w.share * w.off) * whole)
        oo = (a.own_oo - ((2.0 * w.off) * oh)) + ((w.off * w.off) * whole)
        a.own_qq = clip(qq, VARIANCE_FLOOR, 1.0)
        a.own_qo = clip(qo, -1.0, 1.0)
        a.own_oo = clip(oo, VARIANCE_FLOOR, 1.0)
        more = root(both_soc2) - ((far * a.share_error) + (gone * a.off_error))
        a.share_error = clip(a.share_error + (w.share * more), -1.0, 1.0)
        a.off_error = clip(a.off_error + (w.off * more), -REACH_MOST, REACH_MOST)
        state_variance(c, a)
        a.refused = U(0)
        a.pairs = U(a.pairs + 1)


@noinline
def end_rest(m: Model, x: State, a: Soh) -> None:
    """A long rest is over: its SOC, and with the rest that was counted from what that shows.

    A rest that is near is passed over, until the count from the older one is worse than both OCVs.
    A pair is taken from the lower to the higher rest, so that an error of the table is the same in
    every pair, either way.
    """
    c = m.constant
    place = place_now(m, x)
    now = rested(m, place, x, a)
    if now.variance <= SOH_SOC_VARIANCE:
        age(c, a)
        steps = F(U(a.sequence - a.counted_from))
        drift = steps * c.soh_drift
        both_soc2 = a.variance + now.variance
        count_soc2 = a.unsure + (steps * c.soc_walk)
        offset_soc2 = a.oo * (drift * drift)
        apart = now.soc - a.soc
        side = 1.0 if apart > 0.0 else -1.0
        far = side * apart
        if a.variance > 0.0 and far >= SOH_APART:
            use_pair(c, a, far, -(side * drift), -(side * a.counted), count_soc2, both_soc2)
            begin_at_rest(a, now.soc, now.variance)
        elif not (a.variance > 0.0) or count_soc2 + offset_soc2 > both_soc2:
            begin_at_rest(a, now.soc, now.variance)
