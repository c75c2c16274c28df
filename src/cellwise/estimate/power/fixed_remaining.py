"""Remaining time of the fixed step: a constant load carried on to its cutoff or to empty."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.estimate.fixed.arithmetic import (
    FOUR,
    HALF,
    LARGE,
    LEAST_SPAN_V,
    LONGEST,
    ONE,
    REMAINING_PARTS,
    TWO,
    ZERO,
    Flag,
    Float,
    HysteresisFloat,
    Outlook,
    SlowFloat,
    State,
    SurfaceFloat,
    at_least,
    clip,
    known_fraction,
    magnitude,
    noinline,
    positive_above,
    risen,
    root,
    size_within,
)
from cellwise.estimate.fixed.innovation import extrapolated
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import Place, depth_at, look_up
from cellwise.estimate.fixed.options import (
    DEPTH,
    HEALTH,
    HYSTERESIS,
    SLOW,
    SURFACE,
    VALIDITY,
)
from cellwise.estimate.fixed.state import is_sound
from cellwise.estimate.power.fixed_power import place_now, warmth_of


class Along(NamedTuple):
    """A cell under a load at one SOC; ``off_V`` is two deviations of its voltage."""

    v1_V: Float
    v2_V: Float
    v3_V: SlowFloat
    h: HysteresisFloat
    slow_A: SurfaceFloat
    voltage_V: Float
    off_V: Float


def passed(old: Float, end: Float, rise: Float) -> Float:
    """A state of first order after that share of its way to its end."""
    return clip(old + (rise * (end - old)), -LARGE, LARGE)


def behind(at: Place, lag: Float) -> Place:
    """The same place with another lag of the particles' surface."""
    return Place(at.low, at.weight, at.scale, lag)


def as_it_is(x: State) -> Along:
    """The cell's state, under no load yet."""
    v3_V = x.v3_V if SLOW else ZERO
    h = x.h if HYSTERESIS else ZERO
    slow_A = x.slow_A if SURFACE else ZERO
    return Along(x.v1_V, x.v2_V, v3_V, h, slow_A, ZERO, ZERO)


@noinline
def go_on(
    m: Model, place: Place, x: State, was: Along, soc: Float, current: Float, steps: Float
) -> Along:
    """So many time steps of a constant current later, at a SOC.

    The exponent of a branch comes from its gain g over one time step, as g / (1 - g / 2).
    """
    c = m.constant
    v3_V = was.v3_V if SLOW else ZERO
    h = was.h if HYSTERESIS else ZERO
    slow_A = was.slow_A if SURFACE else ZERO
    lag = ZERO
    if SURFACE:
        slow_A = passed(slow_A, current, risen(steps * c.surface_rate))
        depth = depth_at(c, warmth_of(x)) if DEPTH else c.surface_per_A
        lag = clip(depth * slow_A, -ONE, ONE)
    here = behind(place, lag)
    p = look_up(m, here, soc, current)
    drop = p.r0_ohm * current
    rise1 = risen(steps * (p.gain1 / (ONE - (HALF * p.gain1))))
    rise2 = risen(steps * (p.gain2 / (ONE - (HALF * p.gain2))))
    v1_V = passed(was.v1_V, p.r1_ohm * current, rise1)
    v2_V = passed(was.v2_V, p.r2_ohm * current, rise2)
    held_V = (magnitude(drop) + magnitude(v1_V)) + magnitude(v2_V)
    voltage_V = p.ocv_V - (drop + (v1_V + v2_V))
    if SLOW:
        rise3 = risen(steps * (p.gain3 / (ONE - (HALF * p.gain3))))
        v3_V = passed(v3_V, p.r3_ohm * current, rise3)
        held_V = held_V + magnitude(v3_V)
        voltage_V = voltage_V - v3_V
    if HYSTERESIS:
        end = ONE if current < ZERO else -ONE
        h = passed(h, end, risen((c.hysteresis_per_A * magnitude(current)) * steps))
        voltage_V = voltage_V + (p.m_V * h)
    share = c.share_variance if current >= ZERO else c.charge_variance
    variance_V2 = p.noise_V2 + (share * (held_V * held_V))
    if VALIDITY:
        beyond_V = extrapolated(c, x, current, held_V)
        variance_V2 = variance_V2 + (beyond_V * beyond_V)
    if positive_above(x.mismatch, ONE):
        variance_V2 = variance_V2 * x.mismatch
    off_V = TWO * root(variance_V2 if variance_V2 < FOUR else FOUR)
    voltage_V = clip(voltage_V, -LARGE, LARGE)
    return Along(v1_V, v2_V, v3_V, h, slow_A, voltage_V, off_V)


@noinline
def share_of(before_V: Float, after_V: Float, low_V: Float) -> Float:
    """How much of a part goes by until the voltage, taken as linear within it, is at a cutoff."""
    share = ONE
    if after_V <= low_V:
        share = clip((before_V - low_V) / at_least(before_V - after_V, LEAST_SPAN_V), ZERO, ONE)
    return share


@noinline
def apart_by(a: Float, b: Float, d: Float) -> Float:
    """Root of the sum of three squares, each at least 0: by the largest of them."""
    most = at_least(at_least(a, b), d)
    found = ZERO
    if most > ZERO:
        a = known_fraction(a / most)
        b = known_fraction(b / most)
        d = known_fraction(d / most)
        found = most * root(((a * a) + (b * b)) + (d * d))
    return found


def remaining(m: Model, x: State, load_A: Float, holds_power: Flag, out: Outlook) -> None:
    """Time and energy until a load reaches the cutoff, or the cell is empty; nothing is changed.

    ``load_A`` is held, or with ``holds_power`` what it gives now. One below C/50 counts as that.
    The SOC down to empty is gone through in equal parts; temperature stays. The band of two
    deviations holds the SOC's, the voltage's along the way, and those of the capacity. Zero
    throughout for a load that no cell carries and for a state that is not sound.
    """
    c = m.constant
    out.time_s = ZERO
    out.time_low_s = ZERO
    out.time_high_s = ZERO
    out.energy_J = ZERO
    out.energy_low_J = ZERO
    out.energy_high_J = ZERO
    if is_sound(c, x) and size_within(load_A, c.current_limit_A):
        place = place_now(m, x)
        current = at_least(load_A, c.remaining_least_A)
        low_V = c.remaining_low_V
        then = as_it_is(x)
        now = go_on(m, place, x, then, x.soc, current, ZERO)
        power_W = current * at_least(now.voltage_V, low_V)
        per_A = c.soc_per_A
        if HEALTH:
            per_A = per_A * x.per_capacity
        part = x.soc / REMAINING_PARTS
        usual_s = ZERO
        usual_J = ZERO
        worse_s = ZERO
        better_s = ZERO
        usual_ends = now.voltage_V <= low_V
        worse_ends = (now.voltage_V - now.off_V) <= low_V
        better_ends = (now.voltage_V + now.off_V) <= low_V
        ahead = REMAINING_PARTS
        while ahead > ZERO:
            ahead = ahead - ONE
            if holds_power:
                asked_A = power_W / at_least(now.voltage_V, low_V)
                current = clip(asked_A, c.remaining_least_A, c.current_limit_A)
            steps = part / (per_A * current)
            then = go_on(m, place, x, now, part * ahead, current, steps)
            part_s = steps * c.step_s
            if not usual_ends:
                share = share_of(now.voltage_V, then.voltage_V, low_V)
                middle_V = at_least(HALF * (now.voltage_V + then.voltage_V), low_V)
                usual_s = clip(usual_s + (share * part_s), ZERO, LONGEST)
                part_J = (current * middle_V) * part_s
                usual_J = clip(usual_J + (share * part_J), ZERO, LONGEST)
                usual_ends = then.voltage_V <= low_V
            if not worse_ends:
                after_V = then.voltage_V - then.off_V
                share = share_of(now.voltage_V - now.off_V, after_V, low_V)
                worse_s = clip(worse_s + (share * part_s), ZERO, LONGEST)
                worse_ends = after_V <= low_V
            if not better_ends:
                after_V = then.voltage_V + then.off_V
                share = share_of(now.voltage_V + now.off_V, after_V, low_V)
                better_s = clip(better_s + (share * part_s), ZERO, LONGEST)
                better_ends = after_V <= low_V
            now = then
        load_W = current * at_least(now.voltage_V, low_V)
        by_soc_s = ((TWO * root(x.ss)) / (per_A * current)) * c.step_s
        by_capacity_s = c.remaining_share * usual_s
        below_s = apart_by(by_soc_s, by_capacity_s, at_least(usual_s - worse_s, ZERO))
        above_s = apart_by(by_soc_s, by_capacity_s, at_least(better_s - usual_s, ZERO))
        out.time_s = usual_s
        out.time_low_s = at_least(usual_s - below_s, ZERO)
        out.time_high_s = usual_s + above_s
        out.energy_J = usual_J
        out.energy_low_J = at_least(usual_J - (below_s * load_W), ZERO)
        out.energy_high_J = usual_J + (above_s * load_W)
