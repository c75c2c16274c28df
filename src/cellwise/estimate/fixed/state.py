"""State of the fixed step: whether it is sound, where it starts, what an interval does to it."""

from __future__ import annotations

from cellwise.cell.description import BRANCHES, CARRIED, H
from cellwise.cell.unrolled import unrolled_by_option
from cellwise.estimate.equations.covariance import (
    Point,
    Slopes,
    add_variance,
    fade_hysteresis,
    forget_correlations,
    relax,
    tilt,
)
from cellwise.estimate.equations.evidence import share_of, unknown_square
from cellwise.estimate.equations.start import guess_branches, held_variance
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.covariance import (
    covariance_is_sound,
    start_covariance,
)
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import within_one
from cellwise.estimate.status import OUT_OF_RANGE


@unrolled_by_option
def is_sound(c: Constants, x: State) -> bool:
    """Every number in its range: memory that lost its content, or was never set, is noticed."""
    if not not_negative(x.soc, 1.0):
        return False
    if WIDE and not size_within(x.ss_carry, CARRY_MOST):
        return False
    for i in CARRIED:
        if not size_within(x.carry[i], CARRY_MOST):
            return False
    for i in BRANCHES:
        if not size_within(x.state[i], LARGE):
            return False
    for i in (H,):
        if not size_within(x.state[i], 1.0):
            return False
    if not (size_within(x.current_A, LARGE) and not_negative(x.mismatch, LARGE)):
        return False
    if HEATING and not within(x.heat_K, -HEAT_MOST_K, HEAT_MOST_K):
        return False
    if SURFACE and not size_within(x.slow_A, LARGE):
        return False
    if WARM and not within(x.temperature_C, COLDEST_C, HOTTEST_C):
        return False
    if WIDE and not (size_within(x.contradicted, 1.0) and size_within(x.persistent, LARGE)):
        return False
    if WIDE and not (size_within(x.voltage_V, LARGE) and size_within(x.frozen_A, LARGE)):
        return False
    if WIDE and not (size_within(x.swings, SWINGS_MOST) and not_negative(x.repeats, FOUND_FROZEN)):
        return False
    if OFFSET and not (size_within(x.reach, REACH_MOST) and size_within(x.score, SCORE_MOST)):
        return False
    if OFFSET and not positive_within(x.information, 1.0, INFORMATION_MOST):
        return False
    if OFFSET and not (size_within(x.believed, REACH_MOST) and not_negative(x.unsure, LARGE)):
        return False
    if OFFSET and not (within(x.rest, REST_USED, SCORE_MOST) and size_within(x.rest_A, LARGE)):
        return False
    if OFFSET:
        for i in BRANCHES:
            if not size_within(x.d[i], REACH_MOST):
                return False
    if HEALTH and not positive_within(x.per_capacity, 1.0 / MOST_SHARE, 1.0 / LEAST_SHARE):
        return False
    if HEALTH and not positive_within(x.resistance_scale, LEAST_SCALE, MOST_SCALE):
        return False
    if CELLS and not size_within(x.mean_V, LARGE):
        return False
    if BANK and not (not_negative(x.error_V2, LARGE) and x.in_bank <= UNCOUNTED):
        return False
    return covariance_is_sound(x)


def set_health(m: Model, x: State, capacity_share: float, resistance_scale: float) -> int:
    """What a history says of the cell beside the model: its capacity, and all its resistances.

    Kept in the state. Returns 0, or CELLWISE_OUT_OF_RANGE where nothing is taken: a share outside
    0.1..2, a scale outside 0.1..20, a state that is not sound.
    """
    status = U(OUT_OF_RANGE)
    share = positive_within(capacity_share, LEAST_SHARE, MOST_SHARE)
    scale = positive_within(resistance_scale, LEAST_SCALE, MOST_SCALE)
    if share and scale and is_sound(m.constant, x):
        x.per_capacity = 1.0 / capacity_share
        x.resistance_scale = resistance_scale
        status = U(0)
    return status


@unrolled_by_option
def forget_offset(x: State) -> None:
    """Nothing counted yet, nothing known of an offset."""
    x.reach = 0.0
    x.score = 0.0
    x.information = 1.0
    x.believed = 0.0
    x.unsure = CHANCE
    for i in BRANCHES:
        x.d[i] = 0.0
    x.rest = 0.0
    x.rest_A = 0.0


@noinline
@unrolled_by_option
def start(c: Constants, x: State, soc: float, soc_variance: float) -> None:
    """A cell at rest; its branches are guessed at the first sample."""
    x.soc = soc
    for i in BRANCHES:
        x.state[i] = 0.0
    for i in CARRIED:
        x.carry[i] = 0.0
    for i in (H,):
        x.state[i] = 1.0 if soc > 0.5 else -1.0
    start_covariance(x, soc_variance)
    x.current_A = 0.0
    x.mismatch = 1.0
    if HEATING:
        x.heat_K = 0.0
    if SURFACE:
        x.slow_A = 0.0
    if WARM:
        x.temperature_C = c.temperature_C
    if WIDE:
        x.ss_carry = 0.0
        x.contradicted = 0.0
        x.persistent = 0.0
        x.voltage_V = 0.0
        x.frozen_A = 0.0
        x.repeats = 0.0
        x.swings = 0.0
        x.no_current = U(0)
        x.no_voltage = U(0)
    if OFFSET:
        forget_offset(x)
    if HEALTH:
        x.per_capacity = 1.0
        x.resistance_scale = 1.0
    if BANK:
        x.cost = 0.0
        x.weight = 1.0
        x.error_V2 = 0.0
        x.in_bank = ALONE
    if CELLS:
        x.mean_V = 0.0
        x.cells_at = U(0)
        x.turn = U(0)
    x.sequence = U(0)
    x.rejections = U(0)
    x.evidence = NOT_BEGUN


def is_new(x: State) -> bool:
    """Whether it has seen no sample yet."""
    return x.evidence == NOT_BEGUN  # type: ignore[no-any-return]


def has_voltage(x: State) -> bool:
    """Whether it has used a voltage."""
    return x.evidence >= FIRST_VOLTAGE  # type: ignore[no-any-return]


def uses_voltage(x: State, out: Output) -> bool:
    """Whether the last sample had a voltage that can be used."""
    return has_voltage(x) and x.no_voltage == U(0)


@unrolled_by_option
def forget_rounding(x: State) -> None:
    """What rounding has kept from the sums is dropped: they are set."""
    for i in CARRIED:
        x.carry[i] = 0.0
    if WIDE:
        x.ss_carry = 0.0


def stand_in_bank(x: State) -> None:
    """A component of a bank, whose numbers are set."""
    forget_rounding(x)
    x.in_bank = COMPONENT


def stand_alone(x: State) -> None:
    """The estimate of one, whose numbers are."""
    forget_rounding(x)
    x.in_bank = ALONE


def hold_within(x: State) -> None:
    """SOC held within 0..1."""
    if not not_negative(x.soc, 1.0):
        x.soc = within_one(x.soc)
        x.soc_carry = 0.0


@unrolled_by_option
def open_up(c: Constants, x: State, p: Point, delayed_current_A: float) -> None:
    """After voltages that contradicted it for long the SOC is open, branches may hold anything.

    Without CELLWISE_WIDE they are what they would be at a start.
    """
    if WIDE:
        x.ss = at_least(x.ss, RECOVERY_VARIANCE)
        forget_correlations(x)
        for i in BRANCHES:
            kept = x.state[i] * x.state[i]
            held = held_variance(c.branch_variance_V2, p.r[i], c.recovery_A, LOAD_LIMIT_V)
            x.p[i, i] = held + kept
    else:
        x.ss = RECOVERY_VARIANCE
        guess_branches(c, x, p, delayed_current_A)


def taken(c: Constants, x: State, current: float) -> float:
    """Charge that leaves the cell in one step, in SOC."""
    used = current
    if EFFICIENCY and used < 0.0:
        used = used * c.charge_efficiency
    used = c.soc_per_A * used
    if LEAK:
        used = used + c.leak_soc
    if HEALTH:
        used = used * x.per_capacity
    return F(used)


@unrolled_by_option
def predict(
    c: Constants, x: State, p: Point, slopes: Slopes, counted_current_A: float, unmeasured_A2: float
) -> None:
    """One interval of constant current."""
    square_A2 = unknown_square(share_of(c, counted_current_A), counted_current_A, unmeasured_A2)
    relax(x, p, *(p.gain[i] for i in BRANCHES), *(counted_current_A for i in BRANCHES), square_A2)  # type: ignore[call-arg]
    if HYSTERESIS:
        rise = risen(c.hysteresis_per_A * magnitude(counted_current_A))
        keep = 1.0 - rise
        x.h = clip((keep * x.h) + (rise if counted_current_A < 0.0 else -rise), -1.0, 1.0)
        fade_hysteresis(x, keep)
    if WIDE and slopes.spread > 0.0:
        tilt(x, slopes, *(p.gain[i] * counted_current_A for i in BRANCHES))
    if positive_above(SOC_VARIANCE_MOST, x.ss):
        add_variance(x, c.soc_walk + (c.capacity_walk * magnitude(counted_current_A)))


@unrolled_by_option
def heat(
    c: Constants, x: State, r0_ohm: float, delayed_current_A: float, counted_current_A: float
) -> None:
    """The cell's own warming over one interval."""
    fall = r0_ohm * delayed_current_A
    for i in BRANCHES:
        fall = fall + x.state[i]
    change_K = c.heat_gain * ((c.heat_K_per_W * (counted_current_A * fall)) - x.heat_K)
    x.heat_K = clip(x.heat_K + change_K, -HEAT_MOST_K, HEAT_MOST_K)
