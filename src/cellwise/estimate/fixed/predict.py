"""Prediction of the fixed step: charge, gaps, one interval of constant current."""

from __future__ import annotations

from cellwise.estimate.fixed.arithmetic import (
    HEAT_MOST_K,
    ONE,
    SOC_VARIANCE_MOST,
    ZERO,
    Constants,
    Count,
    F,
    Float,
    State,
    clip,
    magnitude,
    positive_above,
    risen,
    vanishing,
)
from cellwise.estimate.fixed.covariance import (
    add_variance,
    fade_hysteresis,
    forget_hysteresis,
    relax,
    spread_offset,
    tilt,
)
from cellwise.estimate.fixed.lookup import Point, Slopes
from cellwise.estimate.fixed.options import (
    EFFICIENCY,
    HEALTH,
    HEATING,
    HYSTERESIS,
    LEAK,
    OFFSET,
    SLOW,
    WIDE,
)


def taken(c: Constants, x: State, current: Float) -> Float:
    """Charge that leaves the cell in one step, in SOC."""
    used = current
    if EFFICIENCY and used < ZERO:
        used = used * c.charge_efficiency
    used = c.soc_per_A * used
    if LEAK:
        used = used + c.leak_soc
    if HEALTH:
        used = used * x.per_capacity
    return used


def cross_gap(
    c: Constants, x: State, p: Point, missing: Count, current: Float, bridge: Float
) -> None:
    """Samples are missing: the branches may hold what the currents on both sides can have left.

    With CELLWISE_WIDE they relax towards the mean of these currents, too.
    """
    unknown_A2 = (current * current) + (x.current_A * x.current_A)
    steps = F(missing)
    spread = c.gap_variance
    if missing <= c.gap_steps:
        moved = c.soc_per_A * steps
        spread = (moved * moved) * unknown_A2
    x.ss = x.ss + spread
    if WIDE:
        gain1 = risen(steps * p.gain1)
        gain2 = risen(steps * p.gain2)
        gain3 = risen(steps * p.gain3) if SLOW else ZERO
        relax(x, p.r1_ohm, gain1, p.r2_ohm, gain2, p.r3_ohm, gain3, bridge, unknown_A2)
    else:
        x.p11 = x.p11 + (unknown_A2 * (p.r1_ohm * p.r1_ohm))
        x.p22 = x.p22 + (unknown_A2 * (p.r2_ohm * p.r2_ohm))
        if SLOW:
            x.p33 = x.p33 + (unknown_A2 * (p.r3_ohm * p.r3_ohm))
    if HYSTERESIS:
        forget_hysteresis(x)
    if HEATING:
        x.heat_K = x.heat_K * vanishing(steps * c.heat_rate)


def predict(c: Constants, x: State, p: Point, w: Slopes, flow: Float, unmeasured_A2: Float) -> None:
    """One interval of constant current.

    A resistance that is off by a share drives its branch like a current that is off by it, and so
    does a current that nobody measured.
    """
    share = c.share_variance if flow >= ZERO else c.charge_variance
    square_A2 = (share * (flow * flow)) + unmeasured_A2
    # fmt: off
    relax(x, p.r1_ohm, p.gain1, p.r2_ohm, p.gain2, p.r3_ohm, p.gain3, flow, square_A2)
    # fmt: on
    if HYSTERESIS:
        rise = risen(c.hysteresis_per_A * magnitude(flow))
        keep = ONE - rise
        x.h = clip((keep * x.h) + (rise if flow < ZERO else -rise), -ONE, ONE)
        fade_hysteresis(x, keep)
    if WIDE and w.spread > ZERO:
        tilt(x, p, w, flow)
    if positive_above(SOC_VARIANCE_MOST, x.ss):
        add_variance(x, c.soc_walk)
    if OFFSET:
        spread_offset(c, x, p)


def heat(c: Constants, x: State, r0_ohm: Float, seen: Float, flow: Float) -> None:
    """The cell's own warming over one interval."""
    fall = (r0_ohm * seen) + (x.v1_V + x.v2_V)
    if SLOW:
        fall = fall + x.v3_V
    change_K = c.heat_gain * ((c.heat_K_per_W * (flow * fall)) - x.heat_K)
    x.heat_K = clip(x.heat_K + change_K, -HEAT_MOST_K, HEAT_MOST_K)
