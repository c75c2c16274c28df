"""Covariance of the fixed step: what a step does to P and to the state through it.

Written by hand, entry by entry: the order of operations is part of the C's bits, and every entry
stands under the option of its states. A test counts that each function meets every entry of the
triangle once. The float64 filters have the same algebra printed: ``estimate/filters``.
"""

from __future__ import annotations

from typing import NamedTuple

from cellwise.estimate.fixed.arithmetic import (
    GROW,
    LARGE,
    ONE,
    TWO,
    VARIANCE_FLOOR,
    ZERO,
    Constants,
    Flag,
    Float,
    HysteresisFloat,
    OffsetFloat,
    SlowFloat,
    State,
    add,
    at_least,
    clip,
    not_negative,
    size_within,
)
from cellwise.estimate.fixed.lookup import Point, Slopes
from cellwise.estimate.fixed.options import HYSTERESIS, OFFSET, SLOW, WIDE


class Column(NamedTuple):
    """P H', with H = [slope, -1, -1, -1, m, r0], and the innovation variance it explains."""

    s: Float
    v1: Float
    v2: Float
    v3: SlowFloat
    h: HysteresisFloat
    o: OffsetFloat
    variance: Float


def add_variance(x: State, value: Float) -> None:
    """A variance of SOC that is large changes by less than rounding keeps of it."""
    if WIDE:
        x.ss, x.ss_carry = add(x.ss, x.ss_carry, value)
    else:
        x.ss = x.ss + value


def covariance_is_sound(x: State) -> Flag:
    """Every entry in its range."""
    if not not_negative(x.ss, LARGE):
        return False
    if not size_within(x.s1, LARGE):
        return False
    if not size_within(x.s2, LARGE):
        return False
    if not not_negative(x.p11, LARGE):
        return False
    if not size_within(x.p12, LARGE):
        return False
    if not not_negative(x.p22, LARGE):
        return False
    if SLOW and not size_within(x.s3, LARGE):
        return False
    if SLOW and not size_within(x.p13, LARGE):
        return False
    if SLOW and not size_within(x.p23, LARGE):
        return False
    if SLOW and not not_negative(x.p33, LARGE):
        return False
    if HYSTERESIS and not size_within(x.sh, LARGE):
        return False
    if HYSTERESIS and not size_within(x.p1h, LARGE):
        return False
    if HYSTERESIS and not size_within(x.p2h, LARGE):
        return False
    if HYSTERESIS and not not_negative(x.phh, LARGE):
        return False
    if SLOW and HYSTERESIS and not size_within(x.p3h, LARGE):
        return False
    if OFFSET and not size_within(x.so, LARGE):
        return False
    if OFFSET and not size_within(x.p1o, LARGE):
        return False
    if OFFSET and not size_within(x.p2o, LARGE):
        return False
    if OFFSET and not not_negative(x.poo, LARGE):
        return False
    if SLOW and OFFSET and not size_within(x.p3o, LARGE):
        return False
    if HYSTERESIS and OFFSET and not size_within(x.pho, LARGE):  # noqa: SIM103
        return False
    return True


def forget_correlations(x: State) -> None:
    """Only the diagonal stays."""
    x.s1 = ZERO
    x.s2 = ZERO
    x.p12 = ZERO
    if SLOW:
        x.s3 = ZERO
        x.p13 = ZERO
        x.p23 = ZERO
    if HYSTERESIS:
        x.sh = ZERO
        x.p1h = ZERO
        x.p2h = ZERO
    if SLOW and HYSTERESIS:
        x.p3h = ZERO
    if OFFSET:
        x.so = ZERO
        x.p1o = ZERO
        x.p2o = ZERO
    if SLOW and OFFSET:
        x.p3o = ZERO
    if HYSTERESIS and OFFSET:
        x.pho = ZERO


def start_covariance(c: Constants, x: State, soc_variance: Float) -> None:
    """SOC known with a variance, branches at rest, nothing known of hysteresis."""
    forget_correlations(x)
    x.ss = soc_variance
    x.p11 = ZERO
    x.p22 = ZERO
    if SLOW:
        x.p33 = ZERO
    if HYSTERESIS:
        x.phh = ONE
    if OFFSET:
        x.poo = c.offset_variance_A2


def relax(
    x: State,
    r1_ohm: Float,
    gain1: Float,
    r2_ohm: Float,
    gain2: Float,
    r3_ohm: SlowFloat,
    gain3: SlowFloat,
    flow: Float,
    square_A2: Float,
) -> None:
    """The branches over one interval of constant current, exactly, and their covariance.

    A current that is not known to ``square_A2`` drives them too; 1 - a^2 keeps the stationary
    spread independent of the time step. What decays slowly is stated by how much it loses: 1 - 1e-5
    as a float is off by 0.3 % of that.
    """
    a1 = ONE - gain1
    a2 = ONE - gain2
    x.v1_V = x.v1_V + (gain1 * ((r1_ohm * flow) - x.v1_V))
    x.v2_V = x.v2_V + (gain2 * ((r2_ohm * flow) - x.v2_V))
    x.s1 = x.s1 - (gain1 * x.s1)
    x.s2 = x.s2 - (gain2 * x.s2)
    x.p11 = x.p11 + ((gain1 * (ONE + a1)) * ((square_A2 * (r1_ohm * r1_ohm)) - x.p11))
    x.p12 = (a1 * a2) * x.p12
    x.p22 = x.p22 + ((gain2 * (ONE + a2)) * ((square_A2 * (r2_ohm * r2_ohm)) - x.p22))
    if SLOW:
        a3 = ONE - gain3
        x.v3_V, x.v3_carry_V = add(x.v3_V, x.v3_carry_V, gain3 * ((r3_ohm * flow) - x.v3_V))
        x.s3 = x.s3 - (gain3 * x.s3)
        x.p13 = (a1 * a3) * x.p13
        x.p23 = x.p23 - ((gain2 + (gain3 * a2)) * x.p23)
        x.p33 = x.p33 + ((gain3 * (ONE + a3)) * ((square_A2 * (r3_ohm * r3_ohm)) - x.p33))
    if HYSTERESIS:
        x.p1h = x.p1h - (gain1 * x.p1h)
        x.p2h = x.p2h - (gain2 * x.p2h)
    if SLOW and HYSTERESIS:
        x.p3h = x.p3h - (gain3 * x.p3h)
    if OFFSET:
        x.p1o = x.p1o - (gain1 * x.p1o)
        x.p2o = x.p2o - (gain2 * x.p2o)
    if SLOW and OFFSET:
        x.p3o = x.p3o - (gain3 * x.p3o)


def fade_hysteresis(x: State, keep: Float) -> None:
    """The row of h where a share of h is kept."""
    if HYSTERESIS:
        x.sh = keep * x.sh
        x.p1h = keep * x.p1h
        x.p2h = keep * x.p2h
        x.phh = (keep * keep) * x.phh
    if SLOW and HYSTERESIS:
        x.p3h = keep * x.p3h
    if HYSTERESIS and OFFSET:
        x.pho = keep * x.pho


def forget_hysteresis(x: State) -> None:
    """Nothing is known of h."""
    if HYSTERESIS:
        x.sh = ZERO
        x.p1h = ZERO
        x.p2h = ZERO
        x.phh = ONE
    if SLOW and HYSTERESIS:
        x.p3h = ZERO
    if HYSTERESIS and OFFSET:
        x.pho = ZERO


def tilt(x: State, p: Point, w: Slopes, flow: Float) -> None:
    """A SOC that is off drives the branches by the resistances' slopes."""
    f1 = (w.rise1 * p.gain1) * flow
    f2 = (w.rise2 * p.gain2) * flow
    x.p11 = x.p11 + (f1 * ((TWO * x.s1) + (f1 * x.ss)))
    x.p12 = x.p12 + (((f1 * x.s2) + (f2 * x.s1)) + ((f1 * f2) * x.ss))
    x.p22 = x.p22 + (f2 * ((TWO * x.s2) + (f2 * x.ss)))
    if SLOW:
        f3 = (w.rise3 * p.gain3) * flow
        x.p13 = x.p13 + (((f1 * x.s3) + (f3 * x.s1)) + ((f1 * f3) * x.ss))
        x.p23 = x.p23 + (((f2 * x.s3) + (f3 * x.s2)) + ((f2 * f3) * x.ss))
        x.p33 = x.p33 + (f3 * ((TWO * x.s3) + (f3 * x.ss)))
    if HYSTERESIS:
        x.p1h = x.p1h + (f1 * x.sh)
        x.p2h = x.p2h + (f2 * x.sh)
    if SLOW and HYSTERESIS:
        x.p3h = x.p3h + (f3 * x.sh)
    if OFFSET:
        x.p1o = x.p1o + (f1 * x.so)
        x.p2o = x.p2o + (f2 * x.so)
    if SLOW and OFFSET:
        x.p3o = x.p3o + (f3 * x.so)
    x.s1 = x.s1 + (f1 * x.ss)
    x.s2 = x.s2 + (f2 * x.ss)
    if SLOW:
        x.s3 = x.s3 + (f3 * x.ss)


def spread_offset(c: Constants, x: State, p: Point) -> None:
    """The sensor's offset drives every state that the current drives.

    The offset's column of P has decayed already; e is what one ampere of offset does to a state in
    one step.
    """
    es = c.soc_per_A
    cs = x.so + (es * x.poo)
    e1 = -(p.gain1 * p.r1_ohm)
    c1 = x.p1o + (e1 * x.poo)
    e2 = -(p.gain2 * p.r2_ohm)
    c2 = x.p2o + (e2 * x.poo)
    x.ss = x.ss + (es * (x.so + cs))
    x.s1 = x.s1 + ((e1 * x.so) + (es * c1))
    x.s2 = x.s2 + ((e2 * x.so) + (es * c2))
    x.p11 = x.p11 + (e1 * (x.p1o + c1))
    x.p12 = x.p12 + ((e2 * x.p1o) + (e1 * c2))
    x.p22 = x.p22 + (e2 * (x.p2o + c2))
    if SLOW:
        e3 = -(p.gain3 * p.r3_ohm)
        c3 = x.p3o + (e3 * x.poo)
        x.s3 = x.s3 + ((e3 * x.so) + (es * c3))
        x.p13 = x.p13 + ((e3 * x.p1o) + (e1 * c3))
        x.p23 = x.p23 + ((e3 * x.p2o) + (e2 * c3))
        x.p33 = x.p33 + (e3 * (x.p3o + c3))
    if HYSTERESIS:
        x.sh = x.sh + (es * x.pho)
        x.p1h = x.p1h + (e1 * x.pho)
        x.p2h = x.p2h + (e2 * x.pho)
    if SLOW and HYSTERESIS:
        x.p3h = x.p3h + (e3 * x.pho)
    x.so = cs
    x.p1o = c1
    x.p2o = c2
    if SLOW:
        x.p3o = c3
    x.poo = x.poo * GROW
    if x.poo < c.offset_variance_A2:
        x.poo = x.poo + c.offset_walk_A2


def column_of(x: State, p: Point, slope: Float) -> Column:
    """The column, and the innovation variance that the state explains."""
    s = (slope * x.ss) - (x.s1 + x.s2)
    v1 = (slope * x.s1) - (x.p11 + x.p12)
    v2 = (slope * x.s2) - (x.p12 + x.p22)
    v3 = ((slope * x.s3) - ((x.p13 + x.p23) + x.p33)) if SLOW else ZERO
    h = ((slope * x.sh) - (x.p1h + x.p2h)) if HYSTERESIS else ZERO
    o = ((slope * x.so) - (x.p1o + x.p2o)) if OFFSET else ZERO
    if SLOW:
        s = s - x.s3
        v1 = v1 - x.p13
        v2 = v2 - x.p23
    if HYSTERESIS:
        s = s + (p.m_V * x.sh)
        v1 = v1 + (p.m_V * x.p1h)
        v2 = v2 + (p.m_V * x.p2h)
        h = h + (p.m_V * x.phh)
    if SLOW and HYSTERESIS:
        v3 = v3 + (p.m_V * x.p3h)
        h = h - x.p3h
    if OFFSET:
        s = s + (p.r0_ohm * x.so)
        v1 = v1 + (p.r0_ohm * x.p1o)
        v2 = v2 + (p.r0_ohm * x.p2o)
        o = o + (p.r0_ohm * x.poo)
    if SLOW and OFFSET:
        v3 = v3 + (p.r0_ohm * x.p3o)
        o = o - x.p3o
    if HYSTERESIS and OFFSET:
        h = h + (p.r0_ohm * x.pho)
        o = o + (p.m_V * x.pho)
    variance = (slope * s) - (v1 + v2)
    if SLOW:
        variance = variance - v3
    if HYSTERESIS:
        variance = variance + (p.m_V * h)
    if OFFSET:
        variance = variance + (p.r0_ohm * o)
    variance = variance if variance > ZERO else ZERO
    return Column(s, v1, v2, v3, h, o, variance)


def move(c: Constants, x: State, d: Column, inverse: Float, innovation: Float) -> None:
    """State + K innovation."""
    x.soc, x.soc_carry = add(x.soc, x.soc_carry, (d.s * inverse) * innovation)
    x.v1_V = x.v1_V + ((d.v1 * inverse) * innovation)
    x.v2_V = x.v2_V + ((d.v2 * inverse) * innovation)
    if SLOW:
        x.v3_V, x.v3_carry_V = add(x.v3_V, x.v3_carry_V, (d.v3 * inverse) * innovation)
    if HYSTERESIS:
        x.h = clip(x.h + ((d.h * inverse) * innovation), -ONE, ONE)
    if OFFSET:
        offset_A = x.offset_A + ((d.o * inverse) * innovation)
        x.offset_A = clip(offset_A, -c.current_limit_A, c.current_limit_A)


def narrow(x: State, d: Column, inverse: Float) -> None:
    """P - K d', row by row."""
    k = d.s * inverse
    add_variance(x, -(k * d.s))
    x.ss = clip(x.ss, VARIANCE_FLOOR, LARGE) if WIDE else at_least(x.ss, VARIANCE_FLOOR)
    x.s1 = x.s1 - (k * d.v1)
    x.s2 = x.s2 - (k * d.v2)
    if SLOW:
        x.s3 = x.s3 - (k * d.v3)
    if HYSTERESIS:
        x.sh = x.sh - (k * d.h)
    if OFFSET:
        x.so = x.so - (k * d.o)
    k = d.v1 * inverse
    x.p11 = at_least(x.p11 - (k * d.v1), ZERO)
    x.p12 = x.p12 - (k * d.v2)
    if SLOW:
        x.p13 = x.p13 - (k * d.v3)
    if HYSTERESIS:
        x.p1h = x.p1h - (k * d.h)
    if OFFSET:
        x.p1o = x.p1o - (k * d.o)
    k = d.v2 * inverse
    x.p22 = at_least(x.p22 - (k * d.v2), ZERO)
    if SLOW:
        x.p23 = x.p23 - (k * d.v3)
    if HYSTERESIS:
        x.p2h = x.p2h - (k * d.h)
    if OFFSET:
        x.p2o = x.p2o - (k * d.o)
    if SLOW:
        k = d.v3 * inverse
        x.p33 = at_least(x.p33 - (k * d.v3), ZERO)
    if SLOW and HYSTERESIS:
        x.p3h = x.p3h - (k * d.h)
    if SLOW and OFFSET:
        x.p3o = x.p3o - (k * d.o)
    if HYSTERESIS:
        k = d.h * inverse
        x.phh = at_least(x.phh - (k * d.h), ZERO)
    if HYSTERESIS and OFFSET:
        x.pho = x.pho - (k * d.o)
    if OFFSET:
        k = d.o * inverse
        x.poo = at_least(x.poo - (k * d.o), ZERO)


def joseph_term(ki: Float, kj: Float, ci: Float, cj: Float, e: Float) -> Float:
    """What is added to an entry of P when a gain of one slope is judged by another (Joseph)."""
    return ((ki * kj) * e) - ((ki * cj) + (kj * ci))


def joseph_update(x: State, d: Column, inverse: Float, less: Float, e: Float, wider: Float) -> None:
    """The gain was that of another slope: by ``less`` than what it is judged by."""
    ks = d.s * inverse
    cs = less * x.ss
    k1 = d.v1 * inverse
    c1 = less * x.s1
    k2 = d.v2 * inverse
    c2 = less * x.s2
    x.ss = x.ss + wider
    x.s1 = x.s1 + joseph_term(ks, k1, cs, c1, e)
    x.s2 = x.s2 + joseph_term(ks, k2, cs, c2, e)
    x.p11 = x.p11 + joseph_term(k1, k1, c1, c1, e)
    x.p12 = x.p12 + joseph_term(k1, k2, c1, c2, e)
    x.p22 = x.p22 + joseph_term(k2, k2, c2, c2, e)
    if SLOW:
        k3 = d.v3 * inverse
        c3 = less * x.s3
        x.s3 = x.s3 + joseph_term(ks, k3, cs, c3, e)
        x.p13 = x.p13 + joseph_term(k1, k3, c1, c3, e)
        x.p23 = x.p23 + joseph_term(k2, k3, c2, c3, e)
        x.p33 = x.p33 + joseph_term(k3, k3, c3, c3, e)
    if HYSTERESIS:
        kh = d.h * inverse
        ch = less * x.sh
        x.sh = x.sh + joseph_term(ks, kh, cs, ch, e)
        x.p1h = x.p1h + joseph_term(k1, kh, c1, ch, e)
        x.p2h = x.p2h + joseph_term(k2, kh, c2, ch, e)
        x.phh = x.phh + joseph_term(kh, kh, ch, ch, e)
    if SLOW and HYSTERESIS:
        x.p3h = x.p3h + joseph_term(k3, kh, c3, ch, e)
    if OFFSET:
        ko = d.o * inverse
        co = less * x.so
        x.so = x.so + joseph_term(ks, ko, cs, co, e)
        x.p1o = x.p1o + joseph_term(k1, ko, c1, co, e)
        x.p2o = x.p2o + joseph_term(k2, ko, c2, co, e)
        x.poo = x.poo + joseph_term(ko, ko, co, co, e)
    if SLOW and OFFSET:
        x.p3o = x.p3o + joseph_term(k3, ko, c3, co, e)
    if HYSTERESIS and OFFSET:
        x.pho = x.pho + joseph_term(kh, ko, ch, co, e)
