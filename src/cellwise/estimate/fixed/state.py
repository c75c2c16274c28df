"""State of the fixed step: whether it is sound, where it starts; see ``arithmetic``."""

from __future__ import annotations

from typing import Any

from cellwise.estimate.fixed.arithmetic import (
    CARRY_MOST,
    HALF,
    HEAT_MOST_K,
    LARGE,
    LARGEST_FLOAT,
    NOT_BEGUN,
    ONE,
    REST_LIMIT_V,
    START_LOAD_SHARE,
    TEMPERATURE_HIGH_C,
    TEMPERATURE_LOW_C,
    ZERO,
    U,
    add,
    at_least,
    helper,
    kernel,
    magnitude,
    not_negative,
    within,
)


@helper
def variance_is_sound(variance: float) -> Any:
    """A variance in its range."""
    return not_negative(variance, LARGE)


@helper
def is_small(x: Any) -> Any:
    """A voltage or a covariance in its range."""
    return within(x, -LARGE, LARGE)


@kernel
def is_sound(
    c: Any,
    x: Any,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
    HEATING: int,
    WARM: int,
    WIDE: int,
    WATCH: int,
) -> Any:
    """Every number in its range: memory that lost its content is noticed."""
    sound = not_negative(x.soc, ONE) & within(x.soc_carry, -CARRY_MOST, CARRY_MOST)
    if WIDE:
        sound &= within(x.ss_carry, -CARRY_MOST, CARRY_MOST)
    sound &= is_small(x.v1_V) & is_small(x.v2_V)
    sound &= variance_is_sound(x.ss) & is_small(x.s1) & is_small(x.s2)
    sound &= variance_is_sound(x.p11) & is_small(x.p12) & variance_is_sound(x.p22)
    sound &= is_small(x.current_A)
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
    if WATCH:
        sound &= is_small(x.voltage_V) & is_small(x.frozen_A)
    return sound


@kernel
def add_variance(x: Any, value: float, WIDE: int) -> None:
    """A variance of SOC that is large changes by less than rounding keeps of it."""
    if WIDE:
        x.ss, x.ss_carry = add(x.ss, x.ss_carry, value)
    else:
        x.ss = x.ss + value


@kernel
def forget_correlations(x: Any, SLOW: int, HYSTERESIS: int, OFFSET: int) -> None:
    """Only the diagonal of the covariance stays."""
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
    if HYSTERESIS and SLOW:
        x.p3h = ZERO
    if OFFSET:
        x.so = ZERO
        x.p1o = ZERO
        x.p2o = ZERO
    if OFFSET and SLOW:
        x.p3o = ZERO
    if OFFSET and HYSTERESIS:
        x.pho = ZERO


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
    WIDE: int,
    WATCH: int,
) -> None:
    """A cell at rest; its branches are guessed at the first sample."""
    x.soc = soc + ZERO  # never -0
    x.soc_carry = ZERO
    x.v1_V = ZERO
    x.v2_V = ZERO
    x.ss = soc_variance
    if WIDE:
        x.ss_carry = ZERO
    x.p11 = ZERO
    x.p22 = ZERO
    forget_correlations(x, SLOW, HYSTERESIS, OFFSET)
    if SLOW:
        x.v3_V = ZERO
        x.v3_carry_V = ZERO
        x.p33 = ZERO
    if HYSTERESIS:
        x.h = ONE if soc > HALF else -ONE
        x.phh = ONE
    if OFFSET:
        x.offset_A = ZERO
        x.poo = c.offset_variance_A2
    x.current_A = ZERO
    x.mismatch = ONE
    if HEATING:
        x.heat_K = ZERO
    if WARM:
        x.temperature_C = c.temperature_C
    if WATCH:
        x.voltage_V = ZERO
        x.frozen_A = ZERO
        x.repeats = U(0)
        x.no_current = U(0)
        x.no_voltage = U(0)
    x.sequence = U(0)
    x.rejections = U(0)
    x.evidence = NOT_BEGUN


@helper
def admitted(rested_V2: float, held_V: float, limit_V: float) -> Any:
    """Variance of a branch that holds anything up to what a current leaves there."""
    most = held_V if held_V < limit_V else limit_V
    return rested_V2 + (most * most)


@kernel
def guess_branches(
    c: Any, x: Any, p: Any, current: float, SLOW: int, HYSTERESIS: int, OFFSET: int, WIDE: int
) -> None:
    """What the branches hold when nobody knows what was before.

    Nearly nothing at rest, half of the load's steady voltage under load.
    """
    if WIDE:
        flow = ZERO
        spread = c.start_rest_A
        limit_V = REST_LIMIT_V
        if magnitude(current) >= c.rest_A:
            flow = START_LOAD_SHARE * current
            spread = at_least(magnitude(flow), c.start_load_A)
            limit_V = LARGE
    else:
        flow = START_LOAD_SHARE * current
        spread = magnitude(flow) + c.start_rest_A
        limit_V = LARGEST_FLOAT
    forget_correlations(x, SLOW, HYSTERESIS, OFFSET)
    x.v1_V = p.r1_ohm * flow
    x.v2_V = p.r2_ohm * flow
    x.p11 = admitted(c.branch_variance_V2, spread * p.r1_ohm, limit_V)
    x.p22 = admitted(c.branch_variance_V2, spread * p.r2_ohm, limit_V)
    if SLOW:
        x.v3_V = p.r3_ohm * flow
        x.v3_carry_V = ZERO
        x.p33 = admitted(c.branch_variance_V2, spread * p.r3_ohm, limit_V)
