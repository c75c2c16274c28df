"""Correction of the fixed step by a measured voltage; see fixed_step_kernels."""

from __future__ import annotations

from typing import Any, NamedTuple

from cellwise.estimate.fixed_step_kernels import (
    FIRST_VOLTAGE,
    FORGIVEN,
    FOUR,
    ONE,
    RECOVERY_RATE,
    RECOVERY_VARIANCE,
    REJECTION,
    REST_RATE,
    SHARED_GROWTH,
    SLOPE_FLOOR_V,
    SMALL_MOVE,
    THREE,
    TWO,
    UNDER_LOAD,
    VARIANCE_FLOOR,
    ZERO,
    F,
    U,
    add,
    clip,
    helper,
    kernel,
    look_up_many_or_one,
    magnitude,
    out_of_range,
    slopes_of,
    within,
)
from cellwise.estimate.status import GATE_RECOVERY, INNOVATION_REJECTED, VOLTAGE_INVALID


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
def update(
    c: Any,
    x: Any,
    d: Any,
    inverse: float,
    innovation: float,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
) -> None:
    """State + K innovation, P - K d', row by row."""
    k = d.s * inverse
    x.soc, x.soc_carry = add(x.soc, x.soc_carry, k * innovation)
    x.ss = x.ss - (k * d.s)
    x.s1 = x.s1 - (k * d.v1)
    x.s2 = x.s2 - (k * d.v2)
    if SLOW:
        x.s3 = x.s3 - (k * d.v3)
    if HYSTERESIS:
        x.sh = x.sh - (k * d.h)
    if OFFSET:
        x.so = x.so - (k * d.o)
    if x.ss < VARIANCE_FLOOR:
        x.ss = VARIANCE_FLOOR
    k = d.v1 * inverse
    x.v1_V = x.v1_V + (k * innovation)
    x.p11 = x.p11 - (k * d.v1)
    x.p12 = x.p12 - (k * d.v2)
    if SLOW:
        x.p13 = x.p13 - (k * d.v3)
    if HYSTERESIS:
        x.p1h = x.p1h - (k * d.h)
    if OFFSET:
        x.p1o = x.p1o - (k * d.o)
    if x.p11 < ZERO:
        x.p11 = ZERO
    k = d.v2 * inverse
    x.v2_V = x.v2_V + (k * innovation)
    x.p22 = x.p22 - (k * d.v2)
    if SLOW:
        x.p23 = x.p23 - (k * d.v3)
    if HYSTERESIS:
        x.p2h = x.p2h - (k * d.h)
    if OFFSET:
        x.p2o = x.p2o - (k * d.o)
    if x.p22 < ZERO:
        x.p22 = ZERO
    if SLOW:
        k = d.v3 * inverse
        x.v3_V, x.v3_carry_V = add(x.v3_V, x.v3_carry_V, k * innovation)
        x.p33 = x.p33 - (k * d.v3)
        if HYSTERESIS:
            x.p3h = x.p3h - (k * d.h)
        if OFFSET:
            x.p3o = x.p3o - (k * d.o)
        if x.p33 < ZERO:
            x.p33 = ZERO
    if HYSTERESIS:
        k = d.h * inverse
        x.h = clip(x.h + (k * innovation), -ONE, ONE)
        x.phh = x.phh - (k * d.h)
        if OFFSET:
            x.pho = x.pho - (k * d.o)
        if x.phh < ZERO:
            x.phh = ZERO
    if OFFSET:
        k = d.o * inverse
        x.offset_A = clip(x.offset_A + (k * innovation), -c.current_limit_A, c.current_limit_A)
        x.poo = x.poo - (k * d.o)
        if x.poo < ZERO:
            x.poo = ZERO


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
) -> None:
    """Judge the gain by the slope where it leads, if that is flatter.

    The gain itself was that of the slope here: on a plateau nothing is learnt.
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
    c1 = less * x.s1
    c2 = less * x.s2
    x.ss = x.ss + rejudged(ks, ks, cs, cs, e)
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


@kernel
def reject(
    c: Any,
    x: Any,
    p: Any,
    polarisation: float,
    excess: float,
    innovation: float,
    slope: float,
    SLOW: int,
) -> Any:
    """A voltage that the gate keeps out.

    Under load the resistances may be what is wrong: what three times the polarisation can explain
    speaks against the SOC more slowly. Rejections in a row mean that the gate may have locked the
    truth out: a SOC error as large as what is seen is admitted, and branches that hold anything, so
    that the next voltage passes.
    """
    status = U(INNOVATION_REJECTED)
    more = REJECTION if excess > (FOUR * (polarisation * polarisation)) else UNDER_LOAD
    x.rejections = U(x.rejections + more)
    if x.rejections >= c.recovery_after:
        missed = innovation / (slope if slope > SLOPE_FLOOR_V else SLOPE_FLOOR_V)
        square = missed * missed
        held = RECOVERY_RATE * c.capacity_A
        held_A2 = held * held
        x.rejections = U(0)
        x.mismatch = ONE
        x.evidence = FIRST_VOLTAGE
        widened = x.ss + square
        most = widened if widened < RECOVERY_VARIANCE else RECOVERY_VARIANCE
        x.ss = most if most > x.ss else x.ss
        x.p11 = x.p11 + ((x.v1_V * x.v1_V) + (held_A2 * (p.r1_ohm * p.r1_ohm)))
        x.p22 = x.p22 + ((x.v2_V * x.v2_V) + (held_A2 * (p.r2_ohm * p.r2_ohm)))
        if SLOW:
            x.p33 = x.p33 + ((x.v3_V * x.v3_V) + (held_A2 * (p.r3_ohm * p.r3_ohm)))
        status = U(status | U(GATE_RECOVERY))
    return status


@kernel
def shared_by(c: Any, x: Any, seen: float) -> Any:
    """How many samples share one model error.

    What the model gets wrong it gets wrong on every time scale, so the memory grows with the time
    since the first voltage until it is the model's own. The first voltage at rest is evidence by
    itself.
    """
    shared = ONE
    if x.evidence >= FIRST_VOLTAGE:
        since = F(U(x.evidence - FIRST_VOLTAGE))
        shared = clip(c.shared_start + (SHARED_GROWTH * since), ONE, c.shared)
    elif magnitude(seen) >= (REST_RATE * c.capacity_A):
        shared = clip(c.shared_start, ONE, c.shared)
    return shared


@kernel
def correct(
    c: Any,
    t: Any,
    place: Any,
    x: Any,
    p: Any,
    w: Any,
    seen: float,
    voltage: float,
    news: int,
    out: Any,
    load: Any,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
    SCALED: int,
    WIDE: int,
) -> Any:
    """Predicted voltage, innovation, and what follows from it.

    ``news`` is 0 where the sample was seen before, 1 where it ends no interval, 2 where time has
    passed since the last one.
    """
    status = U(0)
    drop = p.r0_ohm * seen
    polarisation = (magnitude(drop) + magnitude(x.v1_V)) + magnitude(x.v2_V)
    predicted = p.ocv_V - (drop + (x.v1_V + x.v2_V))
    if SLOW:
        polarisation = polarisation + magnitude(x.v3_V)
        predicted = predicted - x.v3_V
    if HYSTERESIS:
        predicted = predicted + (p.m_V * x.h)
    one = p.noise_V2 + (
        (c.share_variance * (polarisation * polarisation))
        + (c.current_variance_A2 * (p.r0_ohm * p.r0_ohm))
    )
    # An OCV that bends by c at one standard deviation is off its tangent by c z^2.
    d = column_of(x, p, w.slope_V, SLOW, HYSTERESIS, OFFSET)
    explained = d.variance + (THREE * (w.bend_V * w.bend_V))
    variance = explained + one
    out.voltage_V = predicted
    out.innovation_variance_V2 = variance
    out.innovation_V = ZERO
    if not within(voltage, c.voltage_low_V, c.voltage_high_V):
        status = U(U(VOLTAGE_INVALID) | out_of_range(voltage))
    else:
        innovation = voltage - predicted
        square = innovation * innovation
        most = c.gate_square * variance
        out.innovation_V = innovation
        if news == 2:
            ratio = square / variance
            ratio = ratio if ratio < c.mismatch_cap else c.mismatch_cap
            x.mismatch = x.mismatch + (c.lately * (ratio - x.mismatch))
        if news == 0:
            pass  # a repeated sample is no evidence
        elif square > most:
            status = reject(c, x, p, polarisation, square - most, innovation, w.slope_V, SLOW)
        else:
            # What the innovations have lately shown beyond their variance makes evidence weigh
            # less. A first sample under load tells of the load more than of the SOC.
            shared = shared_by(c, x, seen)
            weight = one * shared
            if x.mismatch > ONE:
                weight = weight * x.mismatch
            if news == 2 or shared <= ONE:
                inverse = ONE / (explained + weight)
                if WIDE and w.spread > ZERO:
                    # fmt: off
                    rejudge(t, place, x, p, w, d, inverse, innovation, seen, load, SLOW,
                            HYSTERESIS, OFFSET, SCALED)
                    # fmt: on
                update(c, x, d, inverse, innovation, SLOW, HYSTERESIS, OFFSET)
            x.rejections = U(x.rejections - FORGIVEN) if x.rejections > FORGIVEN else U(0)
            if x.evidence < FIRST_VOLTAGE:
                x.evidence = FIRST_VOLTAGE
    return status
