"""State of the fixed step: is it sound, its start, prediction; see fixed_step_kernels."""

from __future__ import annotations

from typing import Any

from cellwise.estimate.fixed_step_kernels import (
    CARRY_MOST,
    GROW,
    HALF,
    HEAT_MOST_K,
    LARGE,
    NOT_BEGUN,
    ONE,
    QUARTER,
    REST_RATE,
    SOC_VARIANCE_MOST,
    START_LOAD_RATE,
    START_LOAD_SHARE,
    START_REST_RATE,
    TEMPERATURE_HIGH_C,
    TEMPERATURE_LOW_C,
    TWO,
    ZERO,
    F,
    U,
    add,
    clip,
    decay,
    helper,
    kernel,
    magnitude,
    within,
)


@helper
def variance_is_sound(variance: float) -> Any:
    """A variance in its range."""
    return within(variance, ZERO, LARGE)


@helper
def is_small(x: Any) -> Any:
    """A voltage or a covariance in its range."""
    return within(x, -LARGE, LARGE)


@kernel
def is_sound(
    c: Any, x: Any, SLOW: int, HYSTERESIS: int, OFFSET: int, HEATING: int, WARM: int
) -> Any:
    """Every number in its range: memory that lost its content is noticed."""
    sound = within(x.soc, ZERO, ONE) & within(x.soc_carry, -CARRY_MOST, CARRY_MOST)
    sound &= is_small(x.v1_V) & is_small(x.v2_V)
    sound &= variance_is_sound(x.ss) & is_small(x.s1) & is_small(x.s2)
    sound &= variance_is_sound(x.p11) & is_small(x.p12) & variance_is_sound(x.p22)
    sound &= within(x.current_A, -c.current_limit_A, c.current_limit_A)
    sound &= variance_is_sound(x.mismatch)
    if SLOW:
        sound &= is_small(x.v3_V) & within(x.v3_carry_V, -CARRY_MOST, CARRY_MOST)
        sound &= is_small(x.s3) & is_small(x.p13) & is_small(x.p23)
        sound &= variance_is_sound(x.p33)
    if HYSTERESIS:
        sound &= within(x.h, -ONE, ONE)
        sound &= is_small(x.sh) & is_small(x.p1h) & is_small(x.p2h)
        sound &= variance_is_sound(x.phh)
    if HYSTERESIS and SLOW:
        sound &= is_small(x.p3h)
    if OFFSET:
        sound &= within(x.offset_A, -c.current_limit_A, c.current_limit_A)
        sound &= is_small(x.so) & is_small(x.p1o) & is_small(x.p2o)
        sound &= variance_is_sound(x.poo)
    if OFFSET and SLOW:
        sound &= is_small(x.p3o)
    if OFFSET and HYSTERESIS:
        sound &= is_small(x.pho)
    if HEATING:
        sound &= within(x.heat_K, -HEAT_MOST_K, HEAT_MOST_K)
    if WARM:
        sound &= within(x.temperature_C, TEMPERATURE_LOW_C, TEMPERATURE_HIGH_C)
    return sound


@kernel
def start(
    c: Any,
    x: Any,
    soc: float,
    soc_variance: float,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
    HEATING: int,
    WARM: int,
) -> None:
    """A cell at rest."""
    x.soc = soc
    x.soc_carry = ZERO
    x.v1_V = ZERO
    x.v2_V = ZERO
    x.ss = soc_variance
    x.s1 = ZERO
    x.s2 = ZERO
    x.p11 = c.branch_variance_V2
    x.p12 = ZERO
    x.p22 = c.branch_variance_V2
    if SLOW:
        x.v3_V = ZERO
        x.v3_carry_V = ZERO
        x.s3 = ZERO
        x.p13 = ZERO
        x.p23 = ZERO
        x.p33 = c.branch_variance_V2
    if HYSTERESIS:
        x.h = ONE if soc > HALF else -ONE
        x.sh = ZERO
        x.p1h = ZERO
        x.p2h = ZERO
        x.phh = ONE
    if HYSTERESIS and SLOW:
        x.p3h = ZERO
    if OFFSET:
        x.offset_A = ZERO
        x.so = ZERO
        x.p1o = ZERO
        x.p2o = ZERO
        x.poo = c.offset_variance_A2
    if OFFSET and SLOW:
        x.p3o = ZERO
    if OFFSET and HYSTERESIS:
        x.pho = ZERO
    x.current_A = ZERO
    x.mismatch = ONE
    if HEATING:
        x.heat_K = ZERO
    if WARM:
        x.temperature_C = c.temperature_C
    x.sequence = U(0)
    x.rejections = U(0)
    x.evidence = NOT_BEGUN


@kernel
def guess_branch(c: Any, r_ohm: float, current: float) -> Any:
    """What a branch holds when nobody knows what was before, and its variance.

    Nearly nothing at rest, half of the load's steady voltage under load.
    """
    spread = START_REST_RATE * c.capacity_A
    v = ZERO
    if magnitude(current) >= (REST_RATE * c.capacity_A):
        least = START_LOAD_RATE * c.capacity_A
        spread = START_LOAD_SHARE * magnitude(current)
        spread = spread if spread > least else least
        v = (START_LOAD_SHARE * current) * r_ohm
    spread = spread * r_ohm
    return v, c.branch_variance_V2 + (spread * spread)


@kernel
def guess_branches(c: Any, x: Any, p: Any, current: float, SLOW: int) -> None:
    """All branches at the first sample."""
    x.v1_V, x.p11 = guess_branch(c, p.r1_ohm, current)
    x.v2_V, x.p22 = guess_branch(c, p.r2_ohm, current)
    if SLOW:
        x.v3_V, x.p33 = guess_branch(c, p.r3_ohm, current)


@kernel
def taken(c: Any, current: float, EFFICIENCY: int, LEAK: int) -> Any:
    """Charge that leaves the cell in one step, in SOC."""
    used = current
    if EFFICIENCY and used < ZERO:
        used = used * c.charge_efficiency
    if LEAK:
        return (c.soc_per_A * used) + c.leak_soc
    return c.soc_per_A * used


@kernel
def cross_gap(
    x: Any,
    p: Any,
    missing: float,
    flow: float,
    unknown_A2: float,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
) -> None:
    """Samples are missing: the branches relax towards the mean of the currents on both sides.

    They may hold what these currents can have left in them.
    """
    left1 = decay(missing * p.gain1)
    left2 = decay(missing * p.gain2)
    fed1 = (ONE - left1) * p.r1_ohm
    fed2 = (ONE - left2) * p.r2_ohm
    x.v1_V = (left1 * x.v1_V) + (fed1 * flow)
    x.v2_V = (left2 * x.v2_V) + (fed2 * flow)
    x.s1 = left1 * x.s1
    x.s2 = left2 * x.s2
    x.p11 = ((left1 * left1) * x.p11) + ((fed1 * fed1) * unknown_A2)
    x.p12 = (left1 * left2) * x.p12
    x.p22 = ((left2 * left2) * x.p22) + ((fed2 * fed2) * unknown_A2)
    if SLOW:
        left3 = decay(missing * p.gain3)
        fed3 = (ONE - left3) * p.r3_ohm
        x.v3_V = (left3 * x.v3_V) + (fed3 * flow)
        x.s3 = left3 * x.s3
        x.p13 = (left1 * left3) * x.p13
        x.p23 = (left2 * left3) * x.p23
        x.p33 = ((left3 * left3) * x.p33) + ((fed3 * fed3) * unknown_A2)
        if OFFSET:
            x.p3o = left3 * x.p3o
    if HYSTERESIS:
        x.sh = ZERO
        x.p1h = ZERO
        x.p2h = ZERO
        x.phh = ONE
    if HYSTERESIS and SLOW:
        x.p3h = ZERO
    if HYSTERESIS and OFFSET:
        x.pho = ZERO
    if OFFSET:
        x.p1o = left1 * x.p1o
        x.p2o = left2 * x.p2o


@kernel
def admit_doubt(
    c: Any,
    x: Any,
    p: Any,
    missing: Any,
    current: float,
    bridge: float,
    missing_A2: float,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
) -> None:
    """Currents that nobody measured: over ``missing`` samples, and in this one."""
    x.ss = x.ss + ((c.soc_per_A * c.soc_per_A) * missing_A2)
    if missing != U(0):
        unknown_A2 = (current * current) + (x.current_A * x.current_A)
        spread = c.gap_variance
        if missing <= c.gap_steps:
            steps = c.soc_per_A * F(missing)
            spread = (steps * steps) * unknown_A2
        x.ss = x.ss + spread
        cross_gap(x, p, F(missing), bridge, unknown_A2, SLOW, HYSTERESIS, OFFSET)


@kernel
def tilt(x: Any, p: Any, w: Any, flow: float, SLOW: int, HYSTERESIS: int, OFFSET: int) -> None:
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
        x.s3 = x.s3 + (f3 * x.ss)
        if HYSTERESIS:
            x.p3h = x.p3h + (f3 * x.sh)
        if OFFSET:
            x.p3o = x.p3o + (f3 * x.so)
    if HYSTERESIS:
        x.p1h = x.p1h + (f1 * x.sh)
        x.p2h = x.p2h + (f2 * x.sh)
    if OFFSET:
        x.p1o = x.p1o + (f1 * x.so)
        x.p2o = x.p2o + (f2 * x.so)
    x.s1 = x.s1 + (f1 * x.ss)
    x.s2 = x.s2 + (f2 * x.ss)


@kernel
def shrink_soc_variance(x: Any, SLOW: int, HYSTERESIS: int, OFFSET: int) -> None:
    """SOC lies in 0..1: a standard deviation beyond that is halved, its correlations kept."""
    x.ss = QUARTER * x.ss
    x.s1 = HALF * x.s1
    x.s2 = HALF * x.s2
    if SLOW:
        x.s3 = HALF * x.s3
    if HYSTERESIS:
        x.sh = HALF * x.sh
    if OFFSET:
        x.so = HALF * x.so


@kernel
def spread_offset(c: Any, x: Any, p: Any, SLOW: int, HYSTERESIS: int) -> None:
    """The sensor's offset drives every state that the current drives.

    The offset's column of P has decayed already; e is what one ampere of offset does to a state in
    one step.
    """
    es = c.soc_per_A
    e1 = -(p.gain1 * p.r1_ohm)
    e2 = -(p.gain2 * p.r2_ohm)
    cs = x.so + (es * x.poo)
    c1 = x.p1o + (e1 * x.poo)
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
            x.p3h = x.p3h + (e3 * x.pho)
        x.p3o = c3
    if HYSTERESIS:
        x.sh = x.sh + (es * x.pho)
        x.p1h = x.p1h + (e1 * x.pho)
        x.p2h = x.p2h + (e2 * x.pho)
    x.so = cs
    x.p1o = c1
    x.p2o = c2
    x.poo = x.poo * GROW
    if x.poo < c.offset_variance_A2:
        x.poo = x.poo + c.offset_walk_A2


@kernel
def predict(
    c: Any,
    x: Any,
    p: Any,
    w: Any,
    flow: float,
    missing_A2: float,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
    WIDE: int,
) -> None:
    """The branches over one interval of constant current, exactly, and the covariance.

    A resistance that is off by a share drives its branch like a current that is off by it; 1 - a^2
    keeps the stationary spread independent of the time step.
    """
    share = c.share_variance * (flow * flow)
    a1 = ONE - p.gain1
    a2 = ONE - p.gain2
    r11 = p.r1_ohm * p.r1_ohm
    r22 = p.r2_ohm * p.r2_ohm
    x.v1_V = x.v1_V + (p.gain1 * ((p.r1_ohm * flow) - x.v1_V))
    x.v2_V = x.v2_V + (p.gain2 * ((p.r2_ohm * flow) - x.v2_V))
    x.s1 = a1 * x.s1
    x.s2 = a2 * x.s2
    x.p11 = (((a1 * a1) * GROW) * x.p11) + ((share * r11) * (p.gain1 * (ONE + a1)))
    x.p12 = (a1 * a2) * x.p12
    x.p22 = (((a2 * a2) * GROW) * x.p22) + ((share * r22) * (p.gain2 * (ONE + a2)))
    if missing_A2 > ZERO:
        x.p11 = x.p11 + (missing_A2 * (r11 * (p.gain1 * p.gain1)))
        x.p22 = x.p22 + (missing_A2 * (r22 * (p.gain2 * p.gain2)))
    if SLOW:
        a3 = ONE - p.gain3
        r33 = p.r3_ohm * p.r3_ohm
        x.v3_V, x.v3_carry_V = add(x.v3_V, x.v3_carry_V, p.gain3 * ((p.r3_ohm * flow) - x.v3_V))
        x.s3 = a3 * x.s3
        x.p13 = (a1 * a3) * x.p13
        x.p23 = (a2 * a3) * x.p23
        x.p33 = (((a3 * a3) * GROW) * x.p33) + ((share * r33) * (p.gain3 * (ONE + a3)))
        if OFFSET:
            x.p3o = a3 * x.p3o
    if HYSTERESIS:
        ah = decay(c.hysteresis_per_A * magnitude(flow))
        towards = (ONE - ah) if flow < ZERO else (ah - ONE)
        x.h = clip((ah * x.h) + towards, -ONE, ONE)
        x.sh = ah * x.sh
        x.p1h = (a1 * ah) * x.p1h
        x.p2h = (a2 * ah) * x.p2h
        x.phh = (ah * ah) * x.phh
        if SLOW:
            x.p3h = ((ONE - p.gain3) * ah) * x.p3h
        if OFFSET:
            x.pho = ah * x.pho
    if OFFSET:
        x.p1o = a1 * x.p1o
        x.p2o = a2 * x.p2o
    if WIDE and w.spread > ZERO:
        tilt(x, p, w, flow, SLOW, HYSTERESIS, OFFSET)
    x.ss = (x.ss * GROW) + c.soc_walk
    if OFFSET:
        spread_offset(c, x, p, SLOW, HYSTERESIS)
    if x.ss > SOC_VARIANCE_MOST:
        shrink_soc_variance(x, SLOW, HYSTERESIS, OFFSET)
