"""The fixed step after a lock-out, and at a first voltage that cannot be weighed: SOC searched."""

from __future__ import annotations

from cellwise.estimate.fixed.arithmetic import (
    FIRST_VOLTAGE,
    HALF,
    LARGE,
    LOAD_LIMIT_V,
    ONE,
    RECOVERY_VARIANCE,
    REST_LIMIT_V,
    RESTART_POINTS,
    RESTART_ROUNDING,
    RESTART_STEP,
    ZERO,
    Constants,
    F,
    Float,
    State,
    at_least,
    clip,
    noinline,
    root,
    vanishing,
    within,
)
from cellwise.estimate.fixed.covariance import forget_correlations
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import Place, Point, look_up
from cellwise.estimate.fixed.options import HYSTERESIS, SLOW
from cellwise.estimate.fixed.state import admitted, guess_branches


def voltage_of(x: State, p: Point, drop: Float) -> Float:
    """The voltage that the state gives at a point of the tables."""
    voltage = p.ocv_V - (drop + (x.v1_V + x.v2_V))
    if SLOW:
        voltage = voltage - x.v3_V
    if HYSTERESIS:
        voltage = voltage + (p.m_V * x.h)
    return voltage


@noinline
def search(
    m: Model,
    place: Place,
    x: State,
    seen: Float,
    voltage: Float,
    variance: Float,
    held_A: Float,
    limit_V: Float,
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
    p = look_up(m, place, ZERO, seen)
    low = voltage_of(x, p, p.r0_ohm * seen)
    p = look_up(m, place, ONE, seen)
    high = voltage_of(x, p, p.r0_ohm * seen)
    target = clip(voltage, low, high) if low < high else clip(voltage, high, low)
    for k in range(RESTART_POINTS):
        away = (F(k) * RESTART_STEP) - x.soc
        p = look_up(m, place, F(k) * RESTART_STEP, seen)
        held = (p.r1_ohm * p.r1_ohm) + (p.r2_ohm * p.r2_ohm)
        if SLOW:
            held = held + (p.r3_ohm * p.r3_ohm)
        held = (held_A * held_A) * held
        about = (variance + p.noise_V2) + (held if held < most_V2 else most_V2)
        if HYSTERESIS:
            about = about + ((p.m_V * p.m_V) * x.phh)
        off = target - voltage_of(x, p, p.r0_ohm * seen)
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


@noinline
def recover(
    m: Model,
    place: Place,
    x: State,
    seen: Float,
    voltage: Float,
    one_V2: Float,
    polarisation_V: Float,
) -> None:
    """The gate may have locked the truth out, or a first voltage at rest says more than is weighed.

    Branches that have been followed may hold anything; under load the resistances may be what is
    wrong, by as much as they are.
    """
    c = m.constant
    held_A = c.start_rest_A
    limit_V = REST_LIMIT_V
    variance = one_V2 + c.branch_variance_V2
    kept1 = ZERO
    kept2 = ZERO
    if SLOW:
        kept3 = ZERO
    if x.evidence >= FIRST_VOLTAGE:
        held_A = c.recovery_A
        limit_V = LOAD_LIMIT_V
        kept1 = x.v1_V * x.v1_V
        kept2 = x.v2_V * x.v2_V
        variance = one_V2 + (polarisation_V * polarisation_V)
        variance = variance + ((kept1 + x.p11) + (kept2 + x.p22))
        if SLOW:
            kept3 = x.v3_V * x.v3_V
            variance = variance + (kept3 + x.p33)
    search(m, place, x, seen, voltage, variance, held_A, limit_V)
    p = look_up(m, place, x.soc, seen)
    forget_correlations(x)
    x.p11 = admitted(c.branch_variance_V2, held_A * p.r1_ohm, limit_V) + kept1
    x.p22 = admitted(c.branch_variance_V2, held_A * p.r2_ohm, limit_V) + kept2
    if SLOW:
        x.p33 = admitted(c.branch_variance_V2, held_A * p.r3_ohm, limit_V) + kept3
    x.evidence = FIRST_VOLTAGE


def widen(c: Constants, x: State, p: Point, seen: Float) -> None:
    """Without CELLWISE_WIDE anything is admitted instead, so that the next voltage passes."""
    x.ss = RECOVERY_VARIANCE
    x.evidence = FIRST_VOLTAGE
    guess_branches(c, x, p.r1_ohm, p.r2_ohm, p.r3_ohm, seen)
