"""What a target watches for capacity and resistance: charge, rests, the first load after a rest.

That load, once it stands still, drops the voltage from the rest by what the tables' resistances
drop times their scale: no filter's state is in it, and the sensor's offset is in both voltages.
"""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.description import BRANCHES
from cellwise.cell.unrolled import THERE, unrolled_by_option
from cellwise.estimate.capacity.fixed_capacity import (
    begin_at_rest,
    end_rest,
    soh_is_sound,
    start_soh,
)
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import (
    LAG,
    OCV_V,
    Place,
    place_now,
    read,
    resistances_at,
    rise,
    soc_place,
)
from cellwise.estimate.fixed.state import taken


class DropSinceRest(NamedTuple):
    """What a load from a rest on drops by the tables' resistances, and by the OCV's slope [V]."""

    tables_V: float
    ocv_V: float


def moved_by(c: Constants, x: State, current_A: float) -> float:
    """SOC of the tables' capacity that a current takes in one step."""
    used = taken(c, x, current_A)
    if HEALTH:
        used = used / x.per_capacity
    return F(used)


def risen_after(gain: float, steps: int) -> float:
    """How far a branch has come after so many steps."""
    left = 1.0
    for _ in range(steps):
        left = left * (1.0 - gain)
    return 1.0 - left


@unrolled_by_option
def drop_since_rest(
    m: Model, place: Place, x: State, current_A: float, steps: int
) -> DropSinceRest:
    """What the tables' resistances drop after so many steps of a current from rest on."""
    c = m.constant
    points = U(m.row.shape[1])
    z = soc_place(place, points, x.soc)
    under = resistances_at(m, place, z, current_A)
    ohm = under.r0_ohm
    for i in BRANCHES:
        gain = 1.0 / read(m, place, z.at, LAG[i], z.share) if THERE else 0.0
        ohm = ohm + (under.r[i] * risen_after(gain, steps))
    if HEALTH:
        ohm = ohm / x.resistance_scale
    slope_V = rise(m, place, z.k, OCV_V) * F(points - 1)
    moved_V = slope_V * (moved_by(c, x, current_A) * F(steps))
    return DropSinceRest(ohm * current_A, moved_V)


def use_load(c: Constants, a: Soh, current_A: float, drop: DropSinceRest, voltage_V: float) -> None:
    """A voltage under the first load after a rest: the drop since, over that of the tables.

    A reading that is far off moves the estimate no further than one at the gate, so that a contact
    that came loose is found by and by. As of the capacity, what is stated is no surer than the
    model's own resistances.
    """
    per_V = 1.0 / drop.tables_V
    shown = ((a.voltage_V - voltage_V) - drop.ocv_V) * per_V
    volts_V2 = (c.fixed_V2 + c.fixed_V2) + (a.held_V * a.held_V)
    amperes = c.current_variance_A2 / (current_A * current_A)
    single = (volts_V2 * (per_V * per_V)) + ((a.resistance * a.resistance) * amperes)
    share = c.charge_variance if current_A < 0.0 else c.share_variance
    model = (a.resistance * a.resistance) * share
    total = a.rr + (single + model)
    most = root(at_most(c.gate_square * total, 4.0 * MOST_SCALE))
    gain = a.rr / total
    missed = clip(shown - a.resistance, -most, most)
    a.resistance = clip(a.resistance + (gain * missed), LEAST_SCALE, MOST_SCALE)
    a.rr = clip(a.rr - (gain * a.rr), VARIANCE_FLOOR, 1.0)
    a.resistance_variance = at_most(a.rr + model, SOH_RESISTANCE)
    a.loads = U(a.loads + 1)


@noinline
def after_rest(m: Model, x: State, a: Soh, sample: Sample) -> None:
    """Under load after a long rest: its SOC at once, and the resistance once the current stands.

    Of the first interval nobody knows how much of it was under load.
    """
    c = m.constant
    if not soh_is_sound(a):
        last = a.sequence
        start_soh(m, a)
        a.sequence = last
        a.begun = U(1)
    if a.watched == RESTED:
        end_rest(m, x, a)
        a.watched = FIRST_LOAD
        a.rest_end = a.sequence
    steps = U(sample.sequence - a.rest_end)
    small = 0.1 * magnitude(x.current_A)
    stands = size_below(x.current_A - a.current_A, small) and steps >= U(2)
    stands = stands and a.watched == FIRST_LOAD
    shown = positive_within(sample.voltage_V, c.voltage_low_V, c.voltage_high_V)
    over = steps > c.soh_load_steps
    if stands and shown and not (over or size_below(x.current_A, c.soh_load_A)):
        place = place_now(m, x)
        drop = drop_since_rest(m, place, x, x.current_A, steps)
        if magnitude(drop.tables_V) >= LEAST_SPAN_V:
            use_load(c, a, x.current_A, drop, sample.voltage_V)
        over = True
    if over:
        a.watched = U(0)


def bridged(c: Constants, x: State, a: Soh, missing: int) -> float:
    """SOC that samples which are missing have taken, as the step counts it.

    Numbers that may have begun again go on from where the count and the rest were.
    """
    used = 0.0
    if missing <= c.gap_steps:
        used = moved_by(c, x, 0.5 * (x.current_A + a.current_A)) * F(missing)
    else:
        # A load that many gaps hide takes the same way in all of them.
        off = root(a.unsure) + root(c.gap_variance)
        a.unsure = at_most(off * off, 1.0)
    if missing > LONGEST_GAP:
        more = U(missing - LONGEST_GAP)
        a.counted_from = U(a.counted_from + more)
        a.loaded = U(a.loaded + more)
    return used


@noinline
@unrolled_by_option
def keep_rested(c: Constants, x: State, a: Soh, voltage_V: float) -> None:
    """After so long a rest a voltage is the OCV, but for what the branches hold."""
    if positive_within(voltage_V, c.voltage_low_V, c.voltage_high_V):
        held_V = 0.0
        for i in BRANCHES:
            held_V = held_V + x.state[i]
        a.voltage_V = voltage_V
        a.held_V = magnitude(held_V)
        a.watched = RESTED


def silence(c: Constants, x: State, a: Soh, current_A: float) -> int:
    """For how many steps nobody knows what flows."""
    if not WIDE:
        a.silent = U(0) if size_within(current_A, c.current_limit_A) else U(a.silent + 1)
    return U(x.no_current) if WIDE else U(a.silent)


def step_soh(m: Model, x: State, a: Soh, sample: Sample) -> None:
    """After each step, with its sample: count, watch for rests, and use a pair of them.

    A current that is missing for longer than what is bridged makes the count worthless: it begins
    again at the next rest. A load after a rest shows the resistance.
    """
    c = m.constant
    elapsed = U(sample.sequence - a.sequence)
    if a.begun == U(0):
        if not soh_is_sound(a):
            start_soh(m, a)
        a.begun = U(1)
        a.loaded = sample.sequence
        a.watched = U(0)
    elif elapsed != U(0):
        if not size_below(x.current_A, c.soh_rest_A):
            if a.watched != U(0):
                after_rest(m, x, a, sample)
            a.loaded = sample.sequence
        elif U(sample.sequence - a.loaded) >= c.soh_steps:
            keep_rested(c, x, a, sample.voltage_V)
        used = moved_by(c, x, x.current_A)
        if elapsed > U(1):
            used = used + bridged(c, x, a, U(elapsed - 1))
        a.counted, a.counted_carry = add(a.counted, a.counted_carry, used)
        a.moved = a.moved + magnitude(used)
        if silence(c, x, a, sample.current_A) > c.gap_steps:
            begin_at_rest(a, 0.0, 0.0)
            a.loaded = sample.sequence
            a.watched = U(0)
    a.sequence = sample.sequence
    a.current_A = x.current_A


def soh_of(m: Model, a: Soh, out: SohOutput) -> None:
    """What is known of the cell now; a record whose memory lost its content begins again."""
    if not soh_is_sound(a):
        start_soh(m, a)
    out.share = a.share
    out.share_variance = a.share_variance
    out.resistance = a.resistance
    out.resistance_variance = a.resistance_variance
