"""The fixed step after a lock-out, and at a first voltage that cannot be weighed: SOC anew."""

from __future__ import annotations

from typing import Any

from cellwise.estimate.fixed.arithmetic import (
    FIRST_VOLTAGE,
    FURTHEST,
    HALF,
    LARGE,
    LOAD_LIMIT_V,
    ONE,
    RECOVERY_VARIANCE,
    REST_LIMIT_V,
    RESTART_POINTS,
    RESTART_ROUNDING,
    RESTART_STEP,
    SIXTY_FOURTH,
    ZERO,
    F,
    at_least,
    clip,
    helper,
    kernel,
    risen,
    root,
    within,
)
from cellwise.estimate.fixed.lookup import (
    look_up_many_or_one,
)
from cellwise.estimate.fixed.state import (
    admitted,
    forget_correlations,
    guess_branches,
)


@kernel
def voltage_of(x: Any, p: Any, drop: float, SLOW: int, HYSTERESIS: int) -> Any:
    """The voltage that the state gives at a point of the tables."""
    voltage = p.ocv_V - (drop + (x.v1_V + x.v2_V))
    if SLOW:
        voltage = voltage - x.v3_V
    if HYSTERESIS:
        voltage = voltage + (p.m_V * x.h)
    return voltage


@helper
def vanishing(z: float) -> Any:
    """exp(-z) for z >= 0, to 1e-4 of itself."""
    left = ONE - risen((z if z < FURTHEST else FURTHEST) * SIXTY_FOURTH)
    for _ in range(6):
        left = left * left
    return left


@kernel
def search(
    t: Any,
    place: Any,
    x: Any,
    seen: float,
    voltage: float,
    variance: float,
    held_A: float,
    limit_V: float,
    load: Any,
    SLOW: int,
    HYSTERESIS: int,
    SCALED: int,
) -> None:
    """SOC and its variance over the whole of 0..1, when a voltage contradicts the estimate.

    Every SOC weighs as the estimate, widened, and the voltage, known to ``variance``, say together.
    Branches may hold what ``held_A`` would leave there. Beyond either end of the OCV that end is
    meant.
    """
    before = ONE / at_least(x.ss, RECOVERY_VARIANCE)
    most_V2 = limit_V * limit_V
    least = LARGE
    total = ZERO
    first = ZERO
    second = ZERO
    p = look_up_many_or_one(t, place, ZERO, seen, load, SLOW, HYSTERESIS, SCALED)
    low = voltage_of(x, p, p.r0_ohm * seen, SLOW, HYSTERESIS)
    p = look_up_many_or_one(t, place, ONE, seen, load, SLOW, HYSTERESIS, SCALED)
    high = voltage_of(x, p, p.r0_ohm * seen, SLOW, HYSTERESIS)
    target = clip(voltage, low, high) if low < high else clip(voltage, high, low)
    for k in range(RESTART_POINTS):
        away = (F(k) * RESTART_STEP) - x.soc
        p = look_up_many_or_one(t, place, F(k) * RESTART_STEP, seen, load, SLOW, HYSTERESIS, SCALED)
        held = (p.r1_ohm * p.r1_ohm) + (p.r2_ohm * p.r2_ohm)
        if SLOW:
            held = held + (p.r3_ohm * p.r3_ohm)
        held = (held_A * held_A) * held
        about = (variance + p.noise_V2) + (held if held < most_V2 else most_V2)
        if HYSTERESIS:
            about = about + ((p.m_V * p.m_V) * x.phh)
        off = target - voltage_of(x, p, p.r0_ohm * seen, SLOW, HYSTERESIS)
        cost = HALF * (((away * away) * before) + ((off * off) / about))
        weight = ONE / root(about)
        if cost < least:
            faded = vanishing(least - cost)
            total = faded * total
            first = faded * first
            second = faded * second
            least = cost
        else:
            weight = vanishing(cost - least) * weight
        total = total + weight
        first = first + (weight * away)
        second = second + (weight * (away * away))
    x.ss = at_least(x.ss, RECOVERY_VARIANCE)
    if total > ZERO:
        mean = first / total
        square = (second / total) - (mean * mean)
        if within(mean, -ONE, ONE) and within(square, -ONE, ONE):
            x.soc = clip(x.soc + mean, ZERO, ONE)
            x.soc_carry = ZERO
            x.ss = at_least(square, ZERO) + RESTART_ROUNDING


@kernel
def look_anew(
    c: Any,
    t: Any,
    place: Any,
    x: Any,
    seen: float,
    voltage: float,
    one: float,
    polarisation: float,
    load: Any,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
    SCALED: int,
) -> None:
    """The gate may have locked the truth out, or a first voltage at rest says more than is weighed.

    Branches that have been followed may hold anything; under load the resistances may be what is
    wrong, by as much as they are.
    """
    held_A = c.start_rest_A
    limit_V = REST_LIMIT_V
    variance = one + c.branch_variance_V2
    kept1 = ZERO
    kept2 = ZERO
    kept3 = ZERO
    if x.evidence >= FIRST_VOLTAGE:
        held_A = c.recovery_A
        limit_V = LOAD_LIMIT_V
        kept1 = x.v1_V * x.v1_V
        kept2 = x.v2_V * x.v2_V
        variance = (one + (polarisation * polarisation)) + ((kept1 + x.p11) + (kept2 + x.p22))
        if SLOW:
            kept3 = x.v3_V * x.v3_V
            variance = variance + (kept3 + x.p33)
    # fmt: off
    search(t, place, x, seen, voltage, variance, held_A, limit_V, load, SLOW, HYSTERESIS, SCALED)
    # fmt: on
    p = look_up_many_or_one(t, place, x.soc, seen, load, SLOW, HYSTERESIS, SCALED)
    forget_correlations(x, SLOW, HYSTERESIS, OFFSET)
    x.p11 = admitted(c.branch_variance_V2, held_A * p.r1_ohm, limit_V) + kept1
    x.p22 = admitted(c.branch_variance_V2, held_A * p.r2_ohm, limit_V) + kept2
    if SLOW:
        x.p33 = admitted(c.branch_variance_V2, held_A * p.r3_ohm, limit_V) + kept3
    x.evidence = FIRST_VOLTAGE


@kernel
def widen(c: Any, x: Any, p: Any, seen: float, SLOW: int, HYSTERESIS: int, OFFSET: int) -> None:
    """Without WIDE anything is admitted instead, so that the next voltage passes."""
    x.ss = RECOVERY_VARIANCE
    x.evidence = FIRST_VOLTAGE
    guess_branches(c, x, p, seen, SLOW, HYSTERESIS, OFFSET, 0)
