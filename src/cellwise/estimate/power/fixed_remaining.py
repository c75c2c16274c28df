"""A load carried on: time and energy to its cutoff or to empty, and where a plan of loads ends."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import Place, place_now
from cellwise.estimate.fixed.state import is_sound, taken
from cellwise.estimate.power.fixed_power import Along, as_it_is, go_on


class End(NamedTuple):
    """Where a plan ends; ``failed_s`` is when its voltage was at the cutoff or its charge gone."""

    soc: float
    least_V: float
    energy_J: float
    failed_s: float


def off_by(at: Along) -> float:
    """Two deviations of the voltage by what the model is off by."""
    return 2.0 * root(at_most(at.variance_V2, SQUARE_MOST))


@noinline
def lasted(so_far_s: float, least_V: float, after_V: float, low_V: float, part_s: float) -> float:
    """Time until a voltage, taken as linear within a part, is at a cutoff; it ends there for good.

    ``least_V`` is its lowest value so far.
    """
    share = 0.0
    if least_V > low_V:
        share = 1.0
        if after_V <= low_V:
            fall_V = at_least(least_V - after_V, LEAST_SPAN_V)
            share = clip((least_V - low_V) / fall_V, 0.0, 1.0)
    return clip(so_far_s + (share * part_s), 0.0, LONGEST)


@noinline
def apart_by(a: float, b: float, d: float) -> float:
    """Root of the sum of three squares, each at least 0: by the largest of them."""
    most = at_least(at_least(a, b), d)
    found = 0.0
    if most > 0.0:
        a = known_fraction(a / most)
        b = known_fraction(b / most)
        d = known_fraction(d / most)
        found = most * root(((a * a) + (b * b)) + (d * d))
    return found


def remaining(m: Model, x: State, load_A: float, holds_power: bool, out: Outlook) -> None:
    """Time and energy until a load reaches the cutoff, or the cell is empty; nothing is changed.

    ``load_A`` is held, or with ``holds_power`` what it gives now. One below C/50 counts as that.
    The SOC down to empty is gone through in equal parts; temperature stays. The band of two
    deviations holds the SOC's, the voltage's along the way, and those of the capacity. Zero
    throughout for a load that no cell carries and for a state that is not sound.
    """
    c = m.constant
    out.time_s = 0.0
    out.time_low_s = 0.0
    out.time_high_s = 0.0
    out.energy_J = 0.0
    out.energy_low_J = 0.0
    out.energy_high_J = 0.0
    if is_sound(c, x) and size_within(load_A, c.current_limit_A):
        place = place_now(m, x)
        current = at_least(load_A, c.remaining_least_A)
        low_V = c.remaining_low_V
        then = as_it_is(x)
        now = go_on(m, place, x, then, x.soc, current, 0.0)
        power_W = current * at_least(now.voltage_V, low_V)
        per_A = c.soc_per_A
        if HEALTH:
            per_A = per_A * x.per_capacity
        part = x.soc / REMAINING_PARTS
        off_V = off_by(now)
        usual_V = now.voltage_V
        worse_V = usual_V - off_V
        better_V = usual_V + off_V
        usual_s = 0.0
        usual_J = 0.0
        worse_s = 0.0
        better_s = 0.0
        ahead = REMAINING_PARTS
        while ahead > 0.0:
            ahead = ahead - 1.0
            if holds_power:
                asked_A = power_W / at_least(now.voltage_V, low_V)
                current = clip(asked_A, c.remaining_least_A, c.current_limit_A)
            steps = part / (per_A * current)
            then = go_on(m, place, x, now, part * ahead, current, steps)
            part_s = steps * c.step_s
            off_V = off_by(then)
            before_s = usual_s
            usual_s = lasted(usual_s, usual_V, then.voltage_V, low_V, part_s)
            worse_s = lasted(worse_s, worse_V, then.voltage_V - off_V, low_V, part_s)
            better_s = lasted(better_s, better_V, then.voltage_V + off_V, low_V, part_s)
            middle_V = at_least(0.5 * (now.voltage_V + then.voltage_V), low_V)
            usual_J = usual_J + ((current * middle_V) * (usual_s - before_s))
            usual_J = clip(usual_J, 0.0, LONGEST)
            usual_V = clip(then.voltage_V, -LARGE, usual_V)
            worse_V = clip(then.voltage_V - off_V, -LARGE, worse_V)
            better_V = clip(then.voltage_V + off_V, -LARGE, better_V)
            now = then
        load_W = current * at_least(now.voltage_V, low_V)
        by_soc_s = ((2.0 * root(x.ss)) / (per_A * current)) * c.step_s
        by_capacity_s = c.remaining_share * usual_s
        below_s = apart_by(by_soc_s, by_capacity_s, at_least(usual_s - worse_s, 0.0))
        above_s = apart_by(by_soc_s, by_capacity_s, at_least(better_s - usual_s, 0.0))
        out.time_s = usual_s
        out.time_low_s = at_least(usual_s - below_s, 0.0)
        out.time_high_s = usual_s + above_s
        out.energy_J = usual_J
        out.energy_low_J = at_least(usual_J - (below_s * load_W), 0.0)
        out.energy_high_J = usual_J + (above_s * load_W)


def is_plan_sound(phases: Phases, count: int) -> bool:
    """Every phase a time and a load that are numbers, of a size that cells have."""
    sound = True
    for k in range(count):
        if not (not_negative(phases[k].seconds, LARGE) and size_within(phases[k].load, LARGE)):
            sound = False
    return sound


@noinline
def flown(
    m: Model,
    place: Place,
    x: State,
    phases: Phases,
    count: int,
    holds_power: bool,
    begun: float,
    per_capacity: float,
    lower: float,
) -> End:
    """Through the plan from a SOC, with a capacity, as many times two deviations lower in voltage.

    A phase is gone through in equal parts; a power finds its current by the voltage that it leaves.
    """
    c = m.constant
    low_V = c.remaining_low_V
    soc = begun
    now = as_it_is(x)
    then = go_on(m, place, x, now, soc, 0.0, 0.0)
    voltage_V = then.voltage_V
    least_V = voltage_V
    energy_J = 0.0
    failed_s = LONGEST
    time_s = 0.0
    turns = PHASE_TURNS if holds_power else U(1)
    for phase in range(count):
        load = phases[phase].load
        current = load / at_least(voltage_V, low_V) if holds_power else load
        current = clip(current, -c.current_limit_A, c.current_limit_A)
        parts = U(1)
        if magnitude(load) > 0.0:
            per_s = magnitude(taken(c, x, current)) / c.step_s
            asked = PHASE_PARTS_PER_S + (REMAINING_PARTS * per_s)
            asked = 1.0 + (phases[phase].seconds * asked)
            parts = U(clip(asked, 1.0, PHASE_PARTS_MOST))
        part_s = phases[phase].seconds / F(parts)
        steps = part_s / c.step_s
        for _ in range(parts):
            after = soc
            for _turn in range(turns):
                if holds_power:
                    current = load / at_least(voltage_V, low_V)
                    current = clip(current, -c.current_limit_A, c.current_limit_A)
                after = soc - ((per_capacity * taken(c, x, current)) * steps)
                after = clip(after, -1.0, 2.0)
                then = go_on(m, place, x, now, after, current, steps)
                voltage_V = then.voltage_V - (lower * off_by(then))
            soc = after
            now = then
            time_s = clip(time_s + part_s, 0.0, LONGEST)
            energy_J = clip(energy_J + ((current * voltage_V) * part_s), -LONGEST, LONGEST)
            least_V = clip(voltage_V, -LARGE, least_V)
            if (voltage_V <= low_V or soc <= 0.0) and failed_s >= LONGEST:
                failed_s = time_s
    return End(soc, least_V, energy_J, failed_s)


@noinline
def normal(deviations: float) -> float:
    """Probability that a normal number is below so many deviations, to 1e-6.

    Abramowitz and Stegun (1964), 26.2.19: a polynomial to the power of -16.
    """
    z = clip(magnitude(deviations), 0.0, DEVIATIONS_MOST)
    far = NORMAL_4 + (z * (NORMAL_5 + (z * NORMAL_6)))
    grown = 1.0 + (z * (NORMAL_1 + (z * (NORMAL_2 + (z * (NORMAL_3 + (z * far)))))))
    for _ in range(4):
        grown = grown * grown
    tail = 0.5 / grown
    return tail if deviations < 0.0 else 1.0 - tail


def plan(
    m: Model,
    x: State,
    phases: Phases,
    count: int,
    holds_power: bool,
    above: float,
    out: PlanResult,
) -> None:
    """Where a plan of loads ends, and the chance to end at ``above`` or more; nothing is changed.

    The phases follow each other; a load is a current [A], or with ``holds_power`` a power [W], of
    one cell, positive on discharge. Temperature stays. The bands of two deviations hold those of
    the SOC, of the voltage along the way and of the capacity, by their effects at two deviations;
    the chance is the product of those to end at ``above`` and to stay above the cutoff: at most as
    large as the two together. Zero throughout for a phase that is none and a state that is not
    sound.
    """
    c = m.constant
    out.soc = 0.0
    out.soc_low = 0.0
    out.soc_high = 0.0
    out.least_V = 0.0
    out.least_low_V = 0.0
    out.energy_J = 0.0
    out.failed_s = 0.0
    out.chance = 0.0
    if is_sound(c, x) and is_plan_sound(phases, count) and not_negative(above, 1.0):
        place = place_now(m, x)
        away = 2.0 * root(x.ss)
        # Away from the nearer end of the SOC, where it would be cut off.
        other_soc = clip(x.soc + (away if x.soc < 0.5 else -away), 0.0, 1.0)
        less = 1.0 + c.remaining_share
        usual = flown(m, place, x, phases, count, holds_power, x.soc, 1.0, 0.0)
        other = flown(m, place, x, phases, count, holds_power, other_soc, 1.0, 0.0)
        soc_by_soc = magnitude(usual.soc - other.soc)
        low_by_soc_V = magnitude(usual.least_V - other.least_V)
        other = flown(m, place, x, phases, count, holds_power, x.soc, less, 0.0)
        soc_by_capacity = magnitude(usual.soc - other.soc)
        low_by_capacity_V = magnitude(usual.least_V - other.least_V)
        other = flown(m, place, x, phases, count, holds_power, x.soc, 1.0, 1.0)
        soc_by_voltage = magnitude(usual.soc - other.soc)
        low_by_voltage_V = magnitude(usual.least_V - other.least_V)
        off_soc = at_least(apart_by(soc_by_soc, soc_by_capacity, soc_by_voltage), LEAST_SPAN_V)
        off_V = apart_by(low_by_soc_V, low_by_capacity_V, low_by_voltage_V)
        off_V = at_least(off_V, LEAST_SPAN_V)
        out.soc = clip(usual.soc, 0.0, 1.0)
        out.soc_low = clip(usual.soc - off_soc, 0.0, 1.0)
        out.soc_high = clip(usual.soc + off_soc, 0.0, 1.0)
        out.least_V = usual.least_V
        out.least_low_V = usual.least_V - off_V
        out.energy_J = usual.energy_J
        out.failed_s = usual.failed_s
        by_soc = normal((2.0 * (usual.soc - above)) / off_soc)
        by_voltage = normal((2.0 * (usual.least_V - c.remaining_low_V)) / off_V)
        out.chance = by_soc * by_voltage
