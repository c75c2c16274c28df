"""A sketch of the residual: sums of an open-loop simulation beside the filter, every 15 s.

The simulation starts where the filter knows the SOC and is never corrected; between the rows of the
sums it needs no table. Residual and derivatives of its voltage are freed of what the model's slow
error explains (a voltage and a share of the drop, both of first order, by a Kalman filter of these
two), and their products are summed: the normal equations of all causes. A small sketch has the
first of the derivatives alone. One float a sum loses up to 0.7 % in the 240,000 rows of 1,000 h,
two less than 0.01 %. The slow error is two processes of unit variance, of which a row has
``slow_V`` and ``share_V``; a small sketch has one for both.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from cellwise.cell.description import BRANCHES, V1, V2, V3
from cellwise.cell.unrolled import THERE, unrolled_by_option
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import look_up, place_now
from cellwise.estimate.fixed.state import taken


class Simulated(NamedTuple):
    """Of a row: voltage, OCV slope, drops, their change in a step, what of it may be off."""

    voltage_V: float
    slope_V: float
    drop_V: float
    drop_per_A: float
    change_V: float
    fast_V2: float
    slow_V: float
    share_V: float


def clear_sketch(m: Model, k: Sketch, unit: int) -> None:
    """An empty sketch of the target with that number."""
    k.unit = unit
    k.degrees = 0.0
    k.segments = 0.0
    k.rows = 0.0
    k.count = NOT_SIMULATED
    k.blocks = U(0)
    for a in range(U(k.past.size)):
        k.past[a] = 0.0
        k.now[a] = 0.0
    for a in range(U(k.sum.size)):
        k.sum[a] = 0.0
        if SKETCH_LARGE:
            k.part[a] = 0.0


def fade(c: Constants, k: Sketch) -> None:
    """What was summed counts for less after the rows of one more simulation."""
    keep = 1.0 - (c.sketch_fade * F(k.blocks))
    k.segments = keep * k.segments
    k.rows = keep * k.rows
    k.degrees = keep * k.degrees
    for a in range(U(k.sum.size)):
        if SKETCH_LARGE:
            k.sum[a] = k.sum[a] + k.part[a]
            k.part[a] = 0.0
        k.sum[a] = keep * k.sum[a]


def anchor(c: Constants, x: State, k: Sketch) -> None:
    """The simulation's SOC is the filter's from here on."""
    fade(c, k)
    k.soc = x.soc
    if SKETCH_LARGE:
        k.start_soc = x.soc
    k.blocks = U(0)
    k.slow = -1.0
    for a in range(U(k.past.size)):
        k.past[a] = 0.0
        if SKETCH_LARGE:
            k.past_share[a] = 0.0


@noinline
@unrolled_by_option
def begin_segment(m: Model, x: State, k: Sketch) -> None:
    """A cell at rest. What the filter guesses of its branches under load is no evidence."""
    anchor(m.constant, x, k)
    place = place_now(m, x)
    p = look_up(m, place, k.soc, 0.0)
    k.fast_ohm = p.r1_ohm
    k.fast_gain = p.gain1
    for i in BRANCHES:
        k.state[i] = 0.0
    if HYSTERESIS:
        k.h = x.h
    k.slow_A = 0.0
    k.path = 0.0
    k.sum_A = 0.0
    k.last_A = 0.0
    k.count = U(0)


def follow_path(h: float, current: float, per_A: float) -> float:
    """A hysteresis after a row's mean current."""
    end = 1.0 if current < 0.0 else -1.0
    return F(h + (risen(per_A * magnitude(current)) * (end - h)))


@unrolled_by_option
def simulate_row(
    m: Model, x: State, k: Sketch, current: float, jump_A: float, mean_A: float
) -> Simulated:
    """The voltage now: slow states over the row's mean current, the fast one has followed."""
    c = m.constant
    k.soc = k.soc - (c.sketch_steps * taken(c, x, mean_A))
    place = place_now(m, x)
    p = look_up(m, place, k.soc, current)
    change_V = (p.r0_ohm * jump_A) + (k.fast_gain * ((k.fast_ohm * current) - k.state[V1]))
    drop_V = (p.r0_ohm * current) + k.state[V1]
    drop_per_A = p.r0_ohm + p.r1_ohm
    k.fast_ohm = p.r1_ohm
    k.fast_gain = p.gain1
    gain: dict[Any, float] = {}
    for i in (V2, V3):
        gain[i] = risen(c.sketch_steps * p.gain[i]) if THERE else 0.0
        k.state[i] = k.state[i] + (gain[i] * ((p.r[i] * mean_A) - k.state[i]))
        drop_V = drop_V + k.state[i]
        drop_per_A = drop_per_A + p.r[i]
    voltage_V = p.ocv_V - drop_V
    if HYSTERESIS:
        k.h = follow_path(k.h, mean_A, c.sketch_steps * c.hysteresis_per_A)
        voltage_V = voltage_V + (p.m_V * k.h)
    stated_V2 = p.noise_V2 - c.fixed_V2
    square_V2 = drop_V * drop_V
    fast_V2 = c.sketch_V2 + ((c.sketch_fast * stated_V2) + (c.sketch_fast_share * square_V2))
    slow_V = 0.0
    share_V = 0.0
    if SKETCH_LARGE:
        slow_V = root(c.sketch_slow * stated_V2)
        share_V = c.sketch_slow_share * drop_V
    else:
        slow_share = c.sketch_slow_share * c.sketch_slow_share
        slow_V = root((c.sketch_slow * stated_V2) + (slow_share * square_V2))
    return Simulated(voltage_V, p.slope_V, drop_V, drop_per_A, change_V, fast_V2, slow_V, share_V)


def derive(c: Constants, k: Sketch, r: Simulated, current: float, mean_A: float) -> None:
    """Derivatives of the voltage by every cause, in the order of `cellwise.diagnose.sketched`."""
    k.slow_A = mean_A + (c.sketch_branch * (k.slow_A - mean_A))
    k.path = follow_path(k.path, mean_A, c.sketch_path)
    k.now[1] = r.drop_per_A + (r.slope_V * (F(k.blocks) * c.sketch_soc))
    k.now[2] = r.change_V * c.sketch_per_s
    k.now[3] = -k.slow_A
    k.now[4] = k.path
    k.now[5] = r.slope_V
    k.now[6] = 1.0
    if SKETCH_LARGE:
        k.now[7] = -r.drop_V
        k.now[8] = -current
        k.now[9] = r.slope_V * (k.start_soc - k.soc)


def whiten(c: Constants, k: Sketch, r: Simulated) -> float:
    """What the rows before do not explain of this one; returns one over its variance."""
    keep = c.sketch_keep
    square = keep * keep
    if k.slow < 0.0:
        k.segments = k.segments + 1.0
        k.slow = 1.0
        if SKETCH_LARGE:
            k.share = 1.0
            k.both = 0.0
    k.slow = (square * k.slow) + (1.0 - square)
    slow = k.slow * r.slow_V
    inverse = 1.0 / (r.fast_V2 + (r.slow_V * slow))
    if SKETCH_LARGE:
        k.share = (square * k.share) + (1.0 - square)
        k.both = square * k.both
        slow = slow + (k.both * r.share_V)
        share = (k.both * r.slow_V) + (k.share * r.share_V)
        inverse = 1.0 / (r.fast_V2 + ((r.slow_V * slow) + (r.share_V * share)))
        share_gain = share * inverse
        k.share = k.share - (share * share_gain)
        k.both = k.both - (slow * share_gain)
    slow_gain = slow * inverse
    k.slow = k.slow - (slow * slow_gain)
    for a in range(U(k.past.size)):
        known = keep * k.past[a]
        news = k.now[a] - (r.slow_V * known)
        if SKETCH_LARGE:
            known_share = keep * k.past_share[a]
            news = news - (r.share_V * known_share)
            k.past_share[a] = known_share + (share_gain * news)
        k.past[a] = known + (slow_gain * news)
        k.now[a] = news
    return F(inverse)


def sum_up(k: Sketch, inverse: float) -> None:
    """Products of all pairs, weighed; a simulation has sums of its own where there is room."""
    at = U(0)
    for a in range(U(k.past.size)):
        weighed = inverse * k.now[a]
        for b in range(U(a + 1)):
            more = weighed * k.now[b]
            if SKETCH_LARGE:
                k.part[at] = k.part[at] + more
            else:
                k.sum[at] = k.sum[at] + more
            at = U(at + 1)
    k.rows = k.rows + 1.0


@noinline
def end_row(m: Model, x: State, k: Sketch, sample: Sample, current: float, jump_A: float) -> None:
    """Simulate the voltage that was read now, and sum where the model says what it should be."""
    c = m.constant
    k.blocks = U(k.blocks + 1)
    mean_A = k.sum_A * c.sketch_share
    r = simulate_row(m, x, k, current, jump_A, mean_A)
    derive(c, k, r, current, mean_A)
    shown = positive_within(sample.voltage_V, c.voltage_low_V, c.voltage_high_V)
    if shown and k.soc > c.sketch_low:
        k.now[0] = sample.voltage_V - r.voltage_V
        sum_up(k, whiten(c, k, r))
        warm = size_within(sample.temperature_C, HOTTEST_C)
        k.degrees = k.degrees + (sample.temperature_C if warm else USUAL_DEGREES)
    k.count = U(0)
    k.sum_A = 0.0
    if k.blocks >= c.sketch_most and x.ss <= c.sketch_soc2:
        anchor(c, x, k)


def add_to_sketch(m: Model, x: State, k: Sketch, sample: Sample) -> None:
    """After a step: the sample of that step to the sketch.

    The simulation begins where the deviation of SOC is small. A gap, or a current that no
    sensor can have meant, ends it. A sample that comes again is left out.
    """
    c = m.constant
    elapsed = U(sample.sequence - k.sequence)
    k.sequence = sample.sequence
    read_A = sample.current_A
    usable = size_within(read_A, c.current_limit_A)
    if k.count == NOT_SIMULATED or elapsed > U(1) or not usable:
        k.count = NOT_SIMULATED
        if usable and x.ss <= c.sketch_soc2:
            begin_segment(m, x, k)
    elif elapsed == U(1):
        jump_A = read_A - k.last_A
        k.last_A = read_A
        current = read_A
        if SKEW:
            current = read_A - (c.skew_share * jump_A)
        k.sum_A = k.sum_A + current
        k.v1_V = k.v1_V + (k.fast_gain * ((k.fast_ohm * current) - k.v1_V))
        k.count = U(k.count + 1)
        if k.count >= c.sketch_rows:
            end_row(m, x, k, sample, current, jump_A)
