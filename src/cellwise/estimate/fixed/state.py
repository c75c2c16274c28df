"""State of the fixed step: whether it is sound, where it starts, what an interval does to it."""

from __future__ import annotations

from cellwise.estimate.fixed.arithmetic import (
    CARRY_MOST,
    HALF,
    HEAT_MOST_K,
    LARGE,
    LEAST_SCALE,
    LEAST_SHARE,
    MOST_SCALE,
    MOST_SHARE,
    NOT_BEGUN,
    ONE,
    REST_LIMIT_V,
    SOC_VARIANCE_MOST,
    START_LOAD_SHARE,
    TEMPERATURE_HIGH_C,
    TEMPERATURE_LOW_C,
    ZERO,
    Constants,
    Count,
    F,
    Flag,
    Float,
    SlowFloat,
    State,
    U,
    at_least,
    clip,
    magnitude,
    noinline,
    not_negative,
    positive_above,
    positive_within,
    risen,
    size_below,
    size_within,
    vanishing,
    within,
)
from cellwise.estimate.fixed.covariance import (
    add_variance,
    covariance_is_sound,
    fade_hysteresis,
    forget_correlations,
    forget_hysteresis,
    relax,
    spread_offset,
    start_covariance,
    tilt,
)
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import Point, Slopes
from cellwise.estimate.fixed.options import (
    CELLS,
    EFFICIENCY,
    HEALTH,
    HEATING,
    HYSTERESIS,
    LEAK,
    OFFSET,
    SLOW,
    SURFACE,
    WARM,
    WATCH,
    WIDE,
)
from cellwise.estimate.status import OUT_OF_RANGE


def is_sound(c: Constants, x: State) -> Flag:
    """Every number in its range: memory that lost its content, or was never set, is noticed."""
    if not (not_negative(x.soc, ONE) and size_within(x.soc_carry, CARRY_MOST)):
        return False
    if WIDE and not size_within(x.ss_carry, CARRY_MOST):
        return False
    if not (size_within(x.v1_V, LARGE) and size_within(x.v2_V, LARGE)):
        return False
    if SLOW and not (size_within(x.v3_V, LARGE) and size_within(x.v3_carry_V, CARRY_MOST)):
        return False
    if HYSTERESIS and not size_within(x.h, ONE):
        return False
    if OFFSET and not size_within(x.offset_A, c.current_limit_A):
        return False
    if not (size_within(x.current_A, LARGE) and not_negative(x.mismatch, LARGE)):
        return False
    if HEATING and not within(x.heat_K, -HEAT_MOST_K, HEAT_MOST_K):
        return False
    if SURFACE and not size_within(x.slow_A, LARGE):
        return False
    if WARM and not within(x.temperature_C, TEMPERATURE_LOW_C, TEMPERATURE_HIGH_C):
        return False
    if WATCH and not size_within(x.contradicted, ONE):
        return False
    if WATCH and not (size_within(x.voltage_V, LARGE) and size_within(x.frozen_A, LARGE)):
        return False
    if HEALTH and not positive_within(x.per_capacity, ONE / MOST_SHARE, ONE / LEAST_SHARE):
        return False
    if HEALTH and not positive_within(x.resistance_scale, LEAST_SCALE, MOST_SCALE):
        return False
    if CELLS and not size_within(x.mean_V, LARGE):
        return False
    return covariance_is_sound(x)


def set_health(m: Model, x: State, capacity_share: Float, resistance_scale: Float) -> Count:
    """What a history says of the cell beside the model: its capacity, and all its resistances.

    Kept in the state. Returns 0, or CELLWISE_OUT_OF_RANGE where nothing is taken: a share outside
    0.1..2, a scale outside 0.1..20, a state that is not sound.
    """
    status = U(OUT_OF_RANGE)
    share = positive_within(capacity_share, LEAST_SHARE, MOST_SHARE)
    scale = positive_within(resistance_scale, LEAST_SCALE, MOST_SCALE)
    if share and scale and is_sound(m.constant, x):
        x.per_capacity = ONE / capacity_share
        x.resistance_scale = resistance_scale
        status = U(0)
    return status


@noinline
def start(c: Constants, x: State, soc: Float, soc_variance: Float) -> None:
    """A cell at rest; its branches are guessed at the first sample."""
    x.soc = soc
    x.soc_carry = ZERO
    x.v1_V = ZERO
    x.v2_V = ZERO
    if WIDE:
        x.ss_carry = ZERO
    if SLOW:
        x.v3_V = ZERO
        x.v3_carry_V = ZERO
    if HYSTERESIS:
        x.h = ONE if soc > HALF else -ONE
    if OFFSET:
        x.offset_A = ZERO
    start_covariance(c, x, soc_variance)
    x.current_A = ZERO
    x.mismatch = ONE
    if HEATING:
        x.heat_K = ZERO
    if SURFACE:
        x.slow_A = ZERO
    if WARM:
        x.temperature_C = c.temperature_C
    if WATCH:
        x.contradicted = ZERO
        x.voltage_V = ZERO
        x.frozen_A = ZERO
        x.repeats = U(0)
        x.no_current = U(0)
        x.no_voltage = U(0)
    if HEALTH:
        x.per_capacity = ONE
        x.resistance_scale = ONE
    if CELLS:
        x.mean_V = ZERO
        x.cells_at = U(0)
        x.turn = U(0)
    x.sequence = U(0)
    x.rejections = U(0)
    x.evidence = NOT_BEGUN


def admitted(rested_V2: Float, held_V: Float, limit_V: Float) -> Float:
    """Variance of a branch that holds anything up to what a current leaves there."""
    most = held_V
    if WIDE:
        most = held_V if held_V < limit_V else limit_V
    return rested_V2 + (most * most)


@noinline
def guess_branches(
    c: Constants, x: State, r1_ohm: Float, r2_ohm: Float, r3_ohm: SlowFloat, current: Float
) -> None:
    """What the branches hold when nobody knows what was before.

    Nearly nothing at rest, half of the load's steady voltage under load.
    """
    if WIDE:
        flow = ZERO
        spread = c.start_rest_A
        limit_V = REST_LIMIT_V
        if not size_below(current, c.rest_A):
            flow = START_LOAD_SHARE * current
            spread = at_least(magnitude(flow), c.start_load_A)
            limit_V = LARGE
    else:
        flow = START_LOAD_SHARE * current
        spread = magnitude(flow) + c.start_rest_A
        limit_V = LARGE
    forget_correlations(x)
    x.v1_V = r1_ohm * flow
    x.v2_V = r2_ohm * flow
    x.p11 = admitted(c.branch_variance_V2, spread * r1_ohm, limit_V)
    x.p22 = admitted(c.branch_variance_V2, spread * r2_ohm, limit_V)
    if SLOW:
        x.v3_V = r3_ohm * flow
        x.v3_carry_V = ZERO
        x.p33 = admitted(c.branch_variance_V2, spread * r3_ohm, limit_V)


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
