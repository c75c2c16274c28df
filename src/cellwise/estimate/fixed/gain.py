"""Gain of the fixed step and what it does to state and covariance; see ``arithmetic``."""

from __future__ import annotations

from typing import Any, NamedTuple

from cellwise.estimate.fixed.arithmetic import (
    LARGE,
    ONE,
    SMALL_MOVE,
    TWO,
    VARIANCE_FLOOR,
    ZERO,
    add,
    at_least,
    clip,
    helper,
    kernel,
    magnitude,
)
from cellwise.estimate.fixed.lookup import (
    look_up_many_or_one,
    slopes_of,
)
from cellwise.estimate.fixed.state import (
    add_variance,
    is_small,
)


class Column(NamedTuple):
    """P H', with H = [slope, -1, -1, -1, m, r0], and the innovation variance it explains."""

    s: float
    v1: float
    v2: float
    v3: float
    h: float
    o: float
    variance: float


@kernel
def column_of(x: Any, p: Any, slope: float, SLOW: int, HYSTERESIS: int, OFFSET: int) -> Column:
    """The column, and the innovation variance that the state explains."""
    ds = (slope * x.ss) - (x.s1 + x.s2)
    d1 = (slope * x.s1) - (x.p11 + x.p12)
    d2 = (slope * x.s2) - (x.p12 + x.p22)
    d3 = ZERO
    dh = ZERO
    do = ZERO
    if SLOW:
        ds = ds - x.s3
        d1 = d1 - x.p13
        d2 = d2 - x.p23
        d3 = (slope * x.s3) - ((x.p13 + x.p23) + x.p33)
    if HYSTERESIS:
        ds = ds + (p.m_V * x.sh)
        d1 = d1 + (p.m_V * x.p1h)
        d2 = d2 + (p.m_V * x.p2h)
        dh = (slope * x.sh) - (x.p1h + x.p2h)
        dh = dh + (p.m_V * x.phh)
        if SLOW:
            d3 = d3 + (p.m_V * x.p3h)
            dh = dh - x.p3h
    if OFFSET:
        ds = ds + (p.r0_ohm * x.so)
        d1 = d1 + (p.r0_ohm * x.p1o)
        d2 = d2 + (p.r0_ohm * x.p2o)
        do = (slope * x.so) - (x.p1o + x.p2o)
        do = do + (p.r0_ohm * x.poo)
        if SLOW:
            d3 = d3 + (p.r0_ohm * x.p3o)
            do = do - x.p3o
        if HYSTERESIS:
            dh = dh + (p.r0_ohm * x.pho)
            do = do + (p.m_V * x.pho)
    variance = (slope * ds) - (d1 + d2)
    if SLOW:
        variance = variance - d3
    if HYSTERESIS:
        variance = variance + (p.m_V * dh)
    if OFFSET:
        variance = variance + (p.r0_ohm * do)
    if not (variance > ZERO):
        variance = ZERO
    return Column(ds, d1, d2, d3, dh, do, variance)


@kernel
def move(
    c: Any,
    x: Any,
    d: Any,
    inverse: float,
    innovation: float,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
) -> None:
    """State + K innovation."""
    x.soc, x.soc_carry = add(x.soc, x.soc_carry, (d.s * inverse) * innovation)
    x.v1_V = x.v1_V + ((d.v1 * inverse) * innovation)
    x.v2_V = x.v2_V + ((d.v2 * inverse) * innovation)
    if SLOW:
        x.v3_V, x.v3_carry_V = add(x.v3_V, x.v3_carry_V, (d.v3 * inverse) * innovation)
    if HYSTERESIS:
        x.h = clip(x.h + ((d.h * inverse) * innovation), -ONE, ONE)
    if OFFSET:
        moved = x.offset_A + ((d.o * inverse) * innovation)
        x.offset_A = clip(moved, -c.current_limit_A, c.current_limit_A)


@kernel
def narrow(
    x: Any, d: Any, inverse: float, SLOW: int, HYSTERESIS: int, OFFSET: int, WIDE: int
) -> None:
    """P - K d', row by row."""
    k = d.s * inverse
    add_variance(x, -(k * d.s), WIDE)
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
        if HYSTERESIS:
            x.p3h = x.p3h - (k * d.h)
        if OFFSET:
            x.p3o = x.p3o - (k * d.o)
    if HYSTERESIS:
        k = d.h * inverse
        x.phh = at_least(x.phh - (k * d.h), ZERO)
        if OFFSET:
            x.pho = x.pho - (k * d.o)
    if OFFSET:
        k = d.o * inverse
        x.poo = at_least(x.poo - (k * d.o), ZERO)


@helper
def rejudged(ki: float, kj: float, ci: float, cj: float, e: float) -> Any:
    """What is added to an entry of P when a gain of one slope is judged by another (Joseph)."""
    return ((ki * kj) * e) - ((ki * cj) + (kj * ci))


@kernel
def rejudge(
    t: Any,
    place: Any,
    x: Any,
    p: Any,
    w: Any,
    d: Any,
    inverse: float,
    innovation: float,
    seen: float,
    load: Any,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
    SCALED: int,
) -> Any:
    """Judge the gain by the slope where it leads, if that is flatter; whether anything was learnt.

    The gain itself was that of the slope here: on a plateau nothing is learnt, and the covariance
    stays as it is.
    """
    ks = d.s * inverse
    k1 = d.v1 * inverse
    k2 = d.v2 * inverse
    move = ks * innovation
    flat = p.slope_V if p.slope_V < w.slope_V else w.slope_V
    if magnitude(move) > (SMALL_MOVE * w.spread):
        end = x.soc + move
        landed = look_up_many_or_one(t, place, end, seen, load, SLOW, HYSTERESIS, SCALED)
        there = slopes_of(t, place, end, w.spread, seen, landed, load, SLOW, HYSTERESIS, SCALED)
        flat = there.slope_V if there.slope_V < landed.slope_V else landed.slope_V
        flat = flat if flat < w.slope_V else w.slope_V
    less = flat - w.slope_V
    e = less * ((TWO * d.s) + (less * x.ss))
    cs = less * x.ss
    wider = rejudged(ks, ks, cs, cs, e)
    learnt = is_small(wider) & (wider < (ks * d.s))
    if learnt:
        x.ss = x.ss + wider
        c1 = less * x.s1
        c2 = less * x.s2
        x.s1 = x.s1 + rejudged(ks, k1, cs, c1, e)
        x.s2 = x.s2 + rejudged(ks, k2, cs, c2, e)
        x.p11 = x.p11 + rejudged(k1, k1, c1, c1, e)
        x.p12 = x.p12 + rejudged(k1, k2, c1, c2, e)
        x.p22 = x.p22 + rejudged(k2, k2, c2, c2, e)
        if SLOW:
            k3 = d.v3 * inverse
            c3 = less * x.s3
            x.s3 = x.s3 + rejudged(ks, k3, cs, c3, e)
            x.p13 = x.p13 + rejudged(k1, k3, c1, c3, e)
            x.p23 = x.p23 + rejudged(k2, k3, c2, c3, e)
            x.p33 = x.p33 + rejudged(k3, k3, c3, c3, e)
            if HYSTERESIS:
                x.p3h = x.p3h + rejudged(k3, d.h * inverse, c3, less * x.sh, e)
            if OFFSET:
                x.p3o = x.p3o + rejudged(k3, d.o * inverse, c3, less * x.so, e)
        if HYSTERESIS:
            kh = d.h * inverse
            ch = less * x.sh
            x.sh = x.sh + rejudged(ks, kh, cs, ch, e)
            x.p1h = x.p1h + rejudged(k1, kh, c1, ch, e)
            x.p2h = x.p2h + rejudged(k2, kh, c2, ch, e)
            x.phh = x.phh + rejudged(kh, kh, ch, ch, e)
            if OFFSET:
                x.pho = x.pho + rejudged(kh, d.o * inverse, ch, less * x.so, e)
        if OFFSET:
            ko = d.o * inverse
            co = less * x.so
            x.so = x.so + rejudged(ks, ko, cs, co, e)
            x.p1o = x.p1o + rejudged(k1, ko, c1, co, e)
            x.p2o = x.p2o + rejudged(k2, ko, c2, co, e)
            x.poo = x.poo + rejudged(ko, ko, co, co, e)
    return learnt
