"""State of power of the fixed step: the largest constant current over one horizon."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.estimate.fixed.arithmetic import (
    FOUR,
    HALF,
    LEAST_SPAN_V,
    ONE,
    POWER_TRIALS,
    SUSTAINED,
    ZERO,
    Capability,
    F,
    Float,
    State,
    U,
    at_least,
    clip,
    known_fraction,
    magnitude,
    noinline,
    positive_above,
    risen,
    root,
)
from cellwise.estimate.fixed.innovation import extrapolated
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import (
    Place,
    aged,
    index_of,
    look_up,
    place_of,
    read,
    under_surface,
    within_one,
)
from cellwise.estimate.fixed.options import (
    EFFICIENCY,
    HEALTH,
    HEATING,
    HYSTERESIS,
    SLOW,
    SURFACE,
    VALIDITY,
    WARM,
)
from cellwise.estimate.fixed.state import is_sound

# Columns of the table: as the options have them once a step is compiled, by name in C.
POWER_LAG1 = POWER_LAG2 = POWER_LAG3 = 0


class Ending(NamedTuple):
    """The voltage at the end of a current, and its variance without what the SOC brings."""

    voltage_V: Float
    variance_V2: Float


class Way(NamedTuple):
    """Power one way: the value, what is sustained with 95 %, the current of the value."""

    power_W: Float
    low_W: Float
    current_A: Float


@noinline
def ending(m: Model, place: Place, x: State, soc: Float, current: Float) -> Ending:
    """A constant current over the horizon, from ``soc``, in one interval.

    What the states share is left out of the variance: it mostly takes away from it.
    """
    c = m.constant
    used = current
    if EFFICIENCY and used < ZERO:
        used = used * c.charge_efficiency
    moved = c.power_soc_per_A * used
    if HEALTH:
        moved = moved * x.per_capacity
    end = soc - moved
    p = look_up(m, place, end, current)
    points = U(m.row.shape[1])
    grid = within_one(end) * F(points - 1)
    if SURFACE:
        grid = within_one(end - place.lag) * F(points - 1)
    k = index_of(grid, points)
    f = known_fraction(grid - F(k))
    gain1 = ONE / read(m, place, k, POWER_LAG1, f)
    gain2 = ONE / read(m, place, k, POWER_LAG2, f)
    keep1 = ONE - gain1
    keep2 = ONE - gain2
    drop = p.r0_ohm * current
    v1 = (keep1 * x.v1_V) + (gain1 * (p.r1_ohm * current))
    v2 = (keep2 * x.v2_V) + (gain2 * (p.r2_ohm * current))
    held_V = (magnitude(drop) + magnitude(v1)) + magnitude(v2)
    voltage_V = p.ocv_V - (drop + (v1 + v2))
    states_V2 = ((keep1 * keep1) * x.p11) + ((keep2 * keep2) * x.p22)
    if SLOW:
        gain3 = ONE / read(m, place, k, POWER_LAG3, f)
        keep3 = ONE - gain3
        v3 = (keep3 * x.v3_V) + (gain3 * (p.r3_ohm * current))
        held_V = held_V + magnitude(v3)
        voltage_V = voltage_V - v3
        states_V2 = states_V2 + ((keep3 * keep3) * x.p33)
    if HYSTERESIS:
        rise = risen(c.power_hysteresis_per_A * magnitude(current))
        keep = ONE - rise
        h = clip((keep * x.h) + (rise if current < ZERO else -rise), -ONE, ONE)
        voltage_V = voltage_V + (p.m_V * h)
        spread_V = p.m_V * keep
        states_V2 = states_V2 + ((spread_V * spread_V) * x.phh)
    share = c.share_variance if current >= ZERO else c.charge_variance
    one_V2 = p.noise_V2 + (
        (share * (held_V * held_V)) + (c.current_variance_A2 * (p.r0_ohm * p.r0_ohm))
    )
    if VALIDITY:
        beyond_V = extrapolated(c, x, current, held_V)
        one_V2 = one_V2 + (beyond_V * beyond_V)
    if positive_above(x.mismatch, ONE):
        one_V2 = one_V2 * x.mismatch
    variance_V2 = at_least(states_V2, ZERO) + one_V2
    return Ending(voltage_V, variance_V2)


@noinline
def able(
    m: Model, place: Place, x: State, soc: Float, side: Float, limit_V: Float, most_A: Float
) -> Float:
    """Largest size of a current, discharged (``side`` 1) or charged (-1), up to ``most_A``.

    By false position (Illinois) between none and ``most_A``; 0 where no current keeps the limit.
    """
    found = ZERO
    none = ending(m, place, x, soc, ZERO)
    room = side * (none.voltage_V - limit_V)
    if room > ZERO and most_A > ZERO:
        near = ZERO
        far = most_A
        full = ending(m, place, x, soc, side * most_A)
        lack = side * (limit_V - full.voltage_V)
        near_again = False
        far_again = False
        if lack > ZERO:
            for _ in range(POWER_TRIALS):
                share = clip(room / at_least(room + lack, LEAST_SPAN_V), ZERO, ONE)
                middle = near + ((far - near) * share)
                there = ending(m, place, x, soc, side * middle)
                left = side * (there.voltage_V - limit_V)
                if left >= ZERO:
                    near = middle
                    room = left
                    if near_again:
                        lack = HALF * lack
                    near_again = True
                    far_again = False
                else:
                    far = middle
                    lack = -left
                    if far_again:
                        room = HALF * room
                    far_again = True
                    near_again = False
        else:
            near = most_A
        found = near
    return found


@noinline
def one_way(
    m: Model,
    place: Place,
    x: State,
    soc: Float,
    ss: Float,
    side: Float,
    limit_V: Float,
    most_A: Float,
    room_soc: Float,
) -> Way:
    """Value and lower bound of one way: the bound keeps 1.645 deviations from the limits.

    ``soc``, of variance ``ss``, is the cell's own. The slope over SOC is the chord to the SOC that
    is as many deviations worse.
    """
    c = m.constant
    per_soc_A = c.power_A_per_soc
    if HEALTH:
        per_soc_A = per_soc_A / x.per_capacity
    by_soc_A = at_least(room_soc * per_soc_A, ZERO)
    current_A = able(m, place, x, soc, side, limit_V, most_A if most_A < by_soc_A else by_soc_A)
    end = ending(m, place, x, soc, side * current_A)
    shift = SUSTAINED * root(ss)
    worse = ending(m, place, x, soc - (side * shift), side * current_A)
    by_soc_V = end.voltage_V - worse.voltage_V
    square = (by_soc_V * by_soc_V) + ((SUSTAINED * SUSTAINED) * end.variance_V2)
    off_V = root(square if square < FOUR else FOUR)
    low_soc_A = at_least((room_soc - shift) * per_soc_A, ZERO)
    low_V = limit_V + (side * off_V)
    sure = able(m, place, x, soc, side, low_V, most_A if most_A < low_soc_A else low_soc_A)
    last = ending(m, place, x, soc, side * sure)
    power_W = at_least(current_A * end.voltage_V, ZERO)
    low_W = at_least(sure * (last.voltage_V - off_V), ZERO)
    if low_W > power_W:
        low_W = power_W
    return Way(power_W, low_W, current_A)


def warmth_of(x: State) -> Float:
    """Temperature of the cell: what was measured last, and its own warming."""
    warm_C = x.temperature_C
    if HEATING:
        warm_C = warm_C + x.heat_K
    return warm_C


def place_now(m: Model, x: State) -> Place:
    """Where the cell's temperature lies between the tables."""
    warm_C = warmth_of(x) if WARM else ZERO
    here = place_of(m, warm_C) if WARM else place_of(m, ZERO)
    if SURFACE:
        here = under_surface(m.constant, x, here, warm_C)
    if HEALTH:
        here = aged(x, here)
    return Place(here.low, here.weight, here.scale, here.lag)


def power(m: Model, x: State, out: Capability) -> None:
    """What the cell can give and take for the horizon that the tables hold; nothing is changed.

    The largest constant currents that keep voltage, current and SOC within their limits to the end
    of the horizon, times the voltage then. Zero throughout for a state that is not sound.
    """
    c = m.constant
    out.discharge_W = ZERO
    out.discharge_low_W = ZERO
    out.charge_W = ZERO
    out.charge_low_W = ZERO
    if is_sound(c, x):
        place = place_now(m, x)
        most_A = c.power_discharge_A
        room_soc = x.soc - c.power_soc_low
        down = one_way(m, place, x, x.soc, x.ss, ONE, c.power_low_V, most_A, room_soc)
        most_A = c.power_charge_A
        room_soc = c.power_soc_high - x.soc
        up = one_way(m, place, x, x.soc, x.ss, -ONE, c.power_high_V, most_A, room_soc)
        out.discharge_W = down.power_W
        out.discharge_low_W = down.low_W
        out.charge_W = up.power_W
        out.charge_low_W = up.low_W
