"""A plan of loads on the fixed step: where it ends, and the chance to end above a SOC."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.estimate.fixed.arithmetic import (
    DEVIATIONS_MOST,
    HALF,
    LARGE,
    LEAST_SPAN_V,
    LONGEST,
    NORMAL_1,
    NORMAL_2,
    NORMAL_3,
    NORMAL_4,
    NORMAL_5,
    NORMAL_6,
    ONE,
    PHASE_PARTS_MOST,
    PHASE_PARTS_PER_S,
    PHASE_TURNS,
    REMAINING_PARTS,
    TWO,
    ZERO,
    Count,
    F,
    Flag,
    Float,
    Landing,
    Phases,
    State,
    U,
    at_least,
    clip,
    magnitude,
    noinline,
    not_negative,
    root,
    size_within,
)
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import Place
from cellwise.estimate.fixed.state import is_sound, taken
from cellwise.estimate.power.fixed_power import place_now
from cellwise.estimate.power.fixed_remaining import apart_by, as_it_is, go_on


class End(NamedTuple):
    """Where a plan ends; ``failed_s`` is when its voltage was at the cutoff or its charge gone."""

    soc: Float
    least_V: Float
    energy_J: Float
    failed_s: Float


def is_plan_sound(phases: Phases, count: Count) -> Flag:
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
    count: Count,
    holds_power: Flag,
    begun: Float,
    per_capacity: Float,
    lower: Float,
) -> End:
    """Through the plan from a SOC, with a capacity, as many times two deviations lower in voltage.

    A phase is gone through in equal parts; a power finds its current by the voltage that it leaves.
    """
    c = m.constant
    low_V = c.remaining_low_V
    soc = begun
    now = as_it_is(x)
    then = go_on(m, place, x, now, soc, ZERO, ZERO)
    voltage_V = then.voltage_V
    least_V = voltage_V
    energy_J = ZERO
    failed_s = LONGEST
    time_s = ZERO
    turns = PHASE_TURNS if holds_power else U(1)
    for phase in range(count):
        load = phases[phase].load
        current = load / at_least(voltage_V, low_V) if holds_power else load
        current = clip(current, -c.current_limit_A, c.current_limit_A)
        parts = U(1)
        if magnitude(load) > ZERO:
            per_s = magnitude(taken(c, x, current)) / c.step_s
            asked = PHASE_PARTS_PER_S + (REMAINING_PARTS * per_s)
            asked = ONE + (phases[phase].seconds * asked)
            parts = U(clip(asked, ONE, PHASE_PARTS_MOST))
        part_s = phases[phase].seconds / F(parts)
        steps = part_s / c.step_s
        for _ in range(parts):
            after = soc
            for _turn in range(turns):
                if holds_power:
                    current = load / at_least(voltage_V, low_V)
                    current = clip(current, -c.current_limit_A, c.current_limit_A)
                after = soc - ((per_capacity * taken(c, x, current)) * steps)
                after = clip(after, -ONE, TWO)
                then = go_on(m, place, x, now, after, current, steps)
                voltage_V = then.voltage_V - (lower * then.off_V)
            soc = after
            now = then
            time_s = clip(time_s + part_s, ZERO, LONGEST)
            energy_J = clip(energy_J + ((current * voltage_V) * part_s), -LONGEST, LONGEST)
            least_V = clip(voltage_V, -LARGE, least_V)
            if (voltage_V <= low_V or soc <= ZERO) and failed_s >= LONGEST:
                failed_s = time_s
    return End(soc, least_V, energy_J, failed_s)


@noinline
def normal(deviations: Float) -> Float:
    """Probability that a normal number is below so many deviations, to 1e-6.

    Abramowitz and Stegun (1964), 26.2.19: a polynomial to the power of -16.
    """
    z = clip(magnitude(deviations), ZERO, DEVIATIONS_MOST)
    far = NORMAL_4 + (z * (NORMAL_5 + (z * NORMAL_6)))
    grown = ONE + (z * (NORMAL_1 + (z * (NORMAL_2 + (z * (NORMAL_3 + (z * far)))))))
    for _ in range(4):
        grown = grown * grown
    tail = HALF / grown
    return tail if deviations < ZERO else ONE - tail


def plan(
    m: Model,
    x: State,
    phases: Phases,
    count: Count,
    holds_power: Flag,
    above: Float,
    out: Landing,
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
    out.soc = ZERO
    out.soc_low = ZERO
    out.soc_high = ZERO
    out.least_V = ZERO
    out.least_low_V = ZERO
    out.energy_J = ZERO
    out.failed_s = ZERO
    out.chance = ZERO
    if is_sound(c, x) and is_plan_sound(phases, count) and not_negative(above, ONE):
        place = place_now(m, x)
        away = TWO * root(x.ss)
        # Away from the nearer end of the SOC, where it would be cut off.
        other_soc = clip(x.soc + (away if x.soc < HALF else -away), ZERO, ONE)
        less = ONE + c.remaining_share
        usual = flown(m, place, x, phases, count, holds_power, x.soc, ONE, ZERO)
        other = flown(m, place, x, phases, count, holds_power, other_soc, ONE, ZERO)
        soc_by_soc = magnitude(usual.soc - other.soc)
        low_by_soc_V = magnitude(usual.least_V - other.least_V)
        other = flown(m, place, x, phases, count, holds_power, x.soc, less, ZERO)
        soc_by_capacity = magnitude(usual.soc - other.soc)
        low_by_capacity_V = magnitude(usual.least_V - other.least_V)
        other = flown(m, place, x, phases, count, holds_power, x.soc, ONE, ONE)
        soc_by_voltage = magnitude(usual.soc - other.soc)
        low_by_voltage_V = magnitude(usual.least_V - other.least_V)
        off_soc = at_least(apart_by(soc_by_soc, soc_by_capacity, soc_by_voltage), LEAST_SPAN_V)
        off_V = apart_by(low_by_soc_V, low_by_capacity_V, low_by_voltage_V)
        off_V = at_least(off_V, LEAST_SPAN_V)
        out.soc = clip(usual.soc, ZERO, ONE)
        out.soc_low = clip(usual.soc - off_soc, ZERO, ONE)
        out.soc_high = clip(usual.soc + off_soc, ZERO, ONE)
        out.least_V = usual.least_V
        out.least_low_V = usual.least_V - off_V
        out.energy_J = usual.energy_J
        out.failed_s = usual.failed_s
        by_soc = normal((TWO * (usual.soc - above)) / off_soc)
        by_voltage = normal((TWO * (usual.least_V - c.remaining_low_V)) / off_V)
        out.chance = by_soc * by_voltage
