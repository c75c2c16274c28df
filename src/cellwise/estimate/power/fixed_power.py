"""What a constant current makes of the cell; state of power: the largest one over a horizon."""

from __future__ import annotations

from typing import Any, NamedTuple

from cellwise.cell.description import BRANCHES
from cellwise.cell.unrolled import THERE, unrolled_by_option
from cellwise.estimate.equations.evidence import single_variance
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.innovation import extrapolated
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import (
    Place,
    depth_at,
    effective_temperature,
    look_up,
    place_now,
)
from cellwise.estimate.fixed.state import is_sound, taken


class Along(NamedTuple):
    """A cell after a constant current: branches, voltage, variances of it.

    ``variance_V2`` is the model's, ``kept_V2`` what remains of the branches' and of hysteresis.
    """

    voltage_V: float
    variance_V2: float
    kept_V2: float
    h: HysteresisFloat
    slow_A: SurfaceFloat
    v1: float
    v2: float
    v3: SlowFloat

    @property
    def v(self) -> dict[Any, float]:
        """Voltages by the branch."""
        return dict(zip(BRANCHES, self[5:], strict=True))


class Way(NamedTuple):
    """Power one way: the value, what is sustained with 95 %, the current of the value."""

    power_W: float
    low_W: float
    current_A: float


@unrolled_by_option
def as_it_is(x: State) -> Along:
    """The cell's state, under no load yet."""
    v: dict[Any, float] = {}
    for i in BRANCHES:
        v[i] = x.state[i] if THERE else 0.0
    h = x.h if HYSTERESIS else 0.0
    slow_A = x.slow_A if SURFACE else 0.0
    return Along(0.0, 0.0, 0.0, h, slow_A, *(v[i] for i in BRANCHES))


def behind(at: Place, lag: float) -> Place:
    """The same place with another lag of the particles' surface."""
    return Place(at.low, at.weight, at.scale, lag)


def toward(old: float, end: float, left: float) -> float:
    """A state of first order of which that share of its way to its end is left."""
    return clip(end + (left * (old - end)), -LARGE, LARGE)


@noinline
@unrolled_by_option
def go_on(
    m: Model, place: Place, x: State, was: Along, soc: float, current: float, steps: float
) -> Along:
    """So many time steps of a constant current later, at a SOC, in one interval.

    The exponent of a branch comes from its gain g over one time step, as g / (1 - g / 2). What the
    states share is left out of the variance: it mostly takes away from it.
    """
    c = m.constant
    slow_A = was.slow_A if SURFACE else 0.0
    lag = 0.0
    if SURFACE:
        slow_A = toward(slow_A, current, 1.0 - risen(steps * c.surface_rate))
        depth = depth_at(c, effective_temperature(x)) if DEPTH else c.surface_per_A
        lag = clip(depth * slow_A, -1.0, 1.0)
    here = behind(place, lag)
    p = look_up(m, here, soc, current)
    drop = p.r0_ohm * current
    held_V = magnitude(drop)
    voltage_V = p.ocv_V - drop
    kept_V2 = 0.0
    v: dict[Any, float] = {}
    left: dict[Any, float] = {}
    for i in BRANCHES:
        left[i] = vanishing(steps * (p.gain[i] / (1.0 - (0.5 * p.gain[i]))))
        v[i] = toward(was.v[i], p.r[i] * current, left[i]) if THERE else 0.0
        held_V = held_V + magnitude(v[i])
        voltage_V = voltage_V - v[i]
        kept_V2 = kept_V2 + ((left[i] * left[i]) * x.p[i, i])
    h = was.h if HYSTERESIS else 0.0
    if HYSTERESIS:
        keep = vanishing((c.hysteresis_per_A * magnitude(current)) * steps)
        h = toward(h, 1.0 if current < 0.0 else -1.0, keep)
        voltage_V = voltage_V + (p.m_V * h)
        spread_V = p.m_V * keep
        kept_V2 = kept_V2 + ((spread_V * spread_V) * x.phh)
    variance_V2 = single_variance(c, p.noise_V2, current, held_V, 0.0, p.r0_ohm)
    if VALIDITY:
        beyond_V = extrapolated(c, x, current, held_V)
        variance_V2 = variance_V2 + (beyond_V * beyond_V)
    if positive_above(x.mismatch, 1.0):
        variance_V2 = variance_V2 * x.mismatch
    voltage_V = clip(voltage_V, -LARGE, LARGE)
    return Along(voltage_V, variance_V2, kept_V2, h, slow_A, *(v[i] for i in BRANCHES))


@noinline
def ending(m: Model, place: Place, x: State, soc: float, current: float) -> Along:
    """A constant current over the horizon of the power, from ``soc``."""
    c = m.constant
    now = as_it_is(x)
    end = soc - (c.power_steps * taken(c, x, current))
    return go_on(m, place, x, now, end, current, c.power_steps)


@noinline
def able(
    m: Model, place: Place, x: State, soc: float, side: float, limit_V: float, most_A: float
) -> float:
    """Largest size of a current, discharged (``side`` 1) or charged (-1), up to ``most_A``.

    By false position (Illinois) between none and ``most_A``; 0 where no current keeps the limit.
    """
    found = 0.0
    none = ending(m, place, x, soc, 0.0)
    room = side * (none.voltage_V - limit_V)
    if room > 0.0 and most_A > 0.0:
        near = 0.0
        far = most_A
        full = ending(m, place, x, soc, side * most_A)
        lack = side * (limit_V - full.voltage_V)
        near_again = False
        far_again = False
        if lack > 0.0:
            for _ in range(POWER_TRIALS):
                share = clip(room / at_least(room + lack, LEAST_SPAN_V), 0.0, 1.0)
                middle = near + ((far - near) * share)
                there = ending(m, place, x, soc, side * middle)
                left = side * (there.voltage_V - limit_V)
                if left >= 0.0:
                    near = middle
                    room = left
                    if near_again:
                        lack = 0.5 * lack
                    near_again = True
                    far_again = False
                else:
                    far = middle
                    lack = -left
                    if far_again:
                        room = 0.5 * room
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
    soc: float,
    ss: float,
    side: float,
    limit_V: float,
    most_A: float,
    room_soc: float,
) -> Way:
    """Value and lower bound of one way: the bound keeps 1.645 deviations from the limits.

    ``soc``, of variance ``ss``, is the cell's own. The slope over SOC is the chord to the SOC that
    is as many deviations worse.
    """
    c = m.constant
    per_soc_A = 1.0 / (c.soc_per_A * c.power_steps)
    if HEALTH:
        per_soc_A = per_soc_A / x.per_capacity
    by_soc_A = at_least(room_soc * per_soc_A, 0.0)
    current_A = able(m, place, x, soc, side, limit_V, most_A if most_A < by_soc_A else by_soc_A)
    end = ending(m, place, x, soc, side * current_A)
    shift = SUSTAINED * root(ss)
    worse = ending(m, place, x, soc - (side * shift), side * current_A)
    by_soc_V = end.voltage_V - worse.voltage_V
    variance_V2 = end.variance_V2 + end.kept_V2
    square = (by_soc_V * by_soc_V) + ((SUSTAINED * SUSTAINED) * variance_V2)
    off_V = root(at_most(square, SQUARE_MOST))
    low_soc_A = at_least((room_soc - shift) * per_soc_A, 0.0)
    low_V = limit_V + (side * off_V)
    sure = able(m, place, x, soc, side, low_V, most_A if most_A < low_soc_A else low_soc_A)
    last = ending(m, place, x, soc, side * sure)
    power_W = at_least(current_A * end.voltage_V, 0.0)
    low_W = at_least(sure * (last.voltage_V - off_V), 0.0)
    if low_W > power_W:
        low_W = power_W
    return Way(power_W, low_W, current_A)


def power(m: Model, x: State, out: Capability) -> None:
    """What the cell can give and take for the horizon that the tables hold; nothing is changed.

    The largest constant currents that keep voltage, current and SOC within their limits to the end
    of the horizon, times the voltage then. Zero throughout for a state that is not sound.
    """
    c = m.constant
    out.discharge_W = 0.0
    out.discharge_low_W = 0.0
    out.charge_W = 0.0
    out.charge_low_W = 0.0
    if is_sound(c, x):
        place = place_now(m, x)
        most_A = c.power_discharge_A
        room_soc = x.soc - c.power_soc_low
        down = one_way(m, place, x, x.soc, x.ss, 1.0, c.power_low_V, most_A, room_soc)
        most_A = c.power_charge_A
        room_soc = c.power_soc_high - x.soc
        up = one_way(m, place, x, x.soc, x.ss, -1.0, c.power_high_V, most_A, room_soc)
        out.discharge_W = down.power_W
        out.discharge_low_W = down.low_W
        out.charge_W = up.power_W
        out.charge_low_W = up.low_W
