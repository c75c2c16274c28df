"""A sketch of the residual: sums of an open-loop simulation beside the filter, by means of 10 s.

The simulation starts where the filter knows the SOC and is never corrected. Residual and
derivatives of its voltage by every cause are freed of what the model's slow error explains (one
process of first order, by a scalar Kalman filter), and their products are summed: the normal
equations of all causes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from cellwise.cell.description import BRANCHES
from cellwise.cell.unrolled import THERE, unrolled_by_option
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import look_up, place_now
from cellwise.estimate.fixed.state import taken


class Block(NamedTuple):
    """Of one block: mean SOC and current, voltage, OCV slope, drops, what of it may be off."""

    soc: float
    current: float
    voltage_V: float
    slope_V: float
    drop_V: float
    drop_per_A: float
    fast_V2: float
    slow_V2: float


def clear_sketch(m: Model, k: Sketch) -> None:
    """An empty sketch."""
    k.generation = U(0)
    k.sequence = U(0)
    k.segments = U(0)
    k.rows = U(0)
    k.on = U(0)
    for a in range(REGRESSORS):
        k.past[a] = 0.0
        k.now[a] = 0.0
    for a in range(SKETCH_SUMS):
        k.sum[a] = 0.0
        k.carry[a] = 0.0


def anchor(x: State, k: Sketch) -> None:
    """The simulation's SOC is the filter's from here on."""
    k.soc = x.soc
    k.start_soc = x.soc
    k.offset_soc = 0.0
    k.blocks = U(0)
    k.counted = U(0)
    for a in range(REGRESSORS):
        k.past[a] = 0.0


@unrolled_by_option
def begin_segment(x: State, k: Sketch) -> None:
    """A cell at rest. What the filter guesses of its branches under load is no evidence."""
    anchor(x, k)
    for i in BRANCHES:
        k.state[i] = 0.0
        k.d[i] = 0.0
    if HYSTERESIS:
        k.h = x.h
    k.slow_A = 0.0
    k.path = 0.0
    k.last_V = 0.0
    k.sum_A = 0.0
    k.sum_V = 0.0
    k.count = U(0)
    k.read = U(0)
    k.on = U(1)


@unrolled_by_option
def simulate_block(m: Model, x: State, k: Sketch, current: float, steps: float) -> Block:
    """Over one block at its mean current; voltages are means of the block."""
    c = m.constant
    used = steps * taken(c, x, current)
    soc = k.soc - (0.5 * used)
    k.soc = clip(k.soc - used, -1.0, 2.0)
    place = place_now(m, x)
    p = look_up(m, place, soc, current)
    drop_V = p.r0_ohm * current
    drop_per_A = p.r0_ohm
    z: dict[Any, float] = {}
    left: dict[Any, float] = {}
    share: dict[Any, float] = {}
    end: dict[Any, float] = {}
    for i in BRANCHES:
        z[i] = steps * (p.gain[i] / (1.0 - (0.5 * p.gain[i]))) if THERE else 0.0
        left[i] = vanishing(z[i]) if THERE else 0.0
        share[i] = (1.0 - left[i]) / z[i] if THERE else 0.0
        end[i] = p.r[i] * current if THERE else 0.0
        drop_V = drop_V + (end[i] + (share[i] * (k.state[i] - end[i])))
        k.state[i] = end[i] + (left[i] * (k.state[i] - end[i]))
        drop_per_A = drop_per_A + (p.r[i] + (share[i] * (k.d[i] - p.r[i])))
        k.d[i] = p.r[i] + (left[i] * (k.d[i] - p.r[i]))
    voltage_V = p.ocv_V - drop_V
    if HYSTERESIS:
        keep = vanishing((c.hysteresis_per_A * magnitude(current)) * steps)
        end_h = 1.0 if current < 0.0 else -1.0
        k.h = end_h + (keep * (k.h - end_h))
        voltage_V = voltage_V + (p.m_V * k.h)
    fast_V2 = c.sketch_V2 + (c.share_variance * (drop_V * drop_V))
    slow_V2 = p.noise_V2 - c.fixed_V2
    return Block(soc, current, voltage_V, p.slope_V, drop_V, drop_per_A, fast_V2, slow_V2)


def derive(c: Constants, k: Sketch, b: Block, steps: float) -> None:
    """Derivatives of the voltage by every cause, in the order of `cellwise.diagnose.sketched`."""
    gone = k.start_soc - b.soc
    offset_soc = k.offset_soc + ((0.5 * steps) * c.soc_per_A)
    k.offset_soc = k.offset_soc + (steps * c.soc_per_A)
    k.slow_A = b.current + (c.sketch_slow * (k.slow_A - b.current))
    keep = vanishing((c.sketch_path * magnitude(b.current)) * steps)
    end = 1.0 if b.current < 0.0 else -1.0
    k.path = end + (keep * (k.path - end))
    k.now[0] = b.drop_per_A + (b.slope_V * offset_soc)
    k.now[1] = b.drop_V + (b.slope_V * gone)
    k.now[2] = 1.0
    k.now[3] = 0.0
    if k.blocks > U(0):
        k.now[3] = (k.last_V - b.voltage_V) / c.sketch_s
    k.now[4] = -b.current
    k.now[5] = -b.drop_V
    k.now[6] = -k.slow_A
    k.now[7] = k.path
    k.now[8] = b.slope_V * gone
    k.now[9] = b.slope_V
    k.last_V = b.voltage_V


def whiten(c: Constants, k: Sketch, fast_V2: float, slow_V2: float) -> float:
    """What the last blocks do not explain of this one; returns one over its variance."""
    keep = c.sketch_keep
    square = keep * keep
    before = slow_V2
    if k.counted == U(1):
        before = (square * k.slow_V2) + ((1.0 - square) * slow_V2)
    inverse = 1.0 / (before + fast_V2)
    gain = before * inverse
    k.slow_V2 = before * (1.0 - gain)
    for a in range(REGRESSORS):
        known = keep * k.past[a]
        news = k.now[a] - known
        k.past[a] = known + (gain * news)
        k.now[a] = news
    return inverse


def sum_up(k: Sketch, inverse: float) -> None:
    """Products of all pairs, weighed, into compensated sums."""
    at = U(0)
    for a in range(REGRESSORS):
        weighed = inverse * k.now[a]
        for b in range(U(a + 1)):
            more = weighed * k.now[b]
            k.sum[at], k.carry[at] = add(k.sum[at], k.carry[at], more)
            at = U(at + 1)
    k.rows = U(k.rows + 1)


@noinline
def end_block(m: Model, x: State, k: Sketch) -> None:
    """Simulate the block, and sum it where the model says what it should."""
    c = m.constant
    steps = F(k.count)
    b = simulate_block(m, x, k, k.sum_A / steps, steps)
    derive(c, k, b, steps)
    if k.read > U(0) and b.soc > c.sketch_low:
        k.now[RESIDUAL] = (k.sum_V / F(k.read)) - b.voltage_V
        sum_up(k, whiten(c, k, b.fast_V2, b.slow_V2))
        if k.counted == U(0):
            k.segments = U(k.segments + 1)
            k.counted = U(1)
    k.blocks = U(k.blocks + 1)
    k.count = U(0)
    k.read = U(0)
    k.sum_A = 0.0
    k.sum_V = 0.0
    if k.blocks >= c.sketch_most and x.ss <= c.sketch_soc2:
        anchor(x, k)


def add_to_sketch(m: Model, x: State, k: Sketch, sample: Sample) -> None:
    """After a step: the sample of that step to the sketch.

    The simulation begins where the deviation of SOC is small. A gap, or a current that no
    sensor can have meant, ends it. A sample that comes again is left out.
    """
    c = m.constant
    if k.on == U(0) or sample.sequence != k.sequence:
        if k.on == U(1) and sample.sequence != U(k.sequence + 1):
            k.on = U(0)
        k.sequence = sample.sequence
        if not size_within(sample.current_A, c.current_limit_A):
            k.on = U(0)
        elif k.on == U(0):
            if x.ss <= c.sketch_soc2:
                begin_segment(x, k)
        else:
            k.sum_A = k.sum_A + sample.current_A
            if positive_within(sample.voltage_V, c.voltage_low_V, c.voltage_high_V):
                k.sum_V = k.sum_V + sample.voltage_V
                k.read = U(k.read + 1)
            k.count = U(k.count + 1)
            if k.count >= c.sketch_steps:
                end_block(m, x, k)
