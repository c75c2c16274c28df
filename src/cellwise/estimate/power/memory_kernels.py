"""What a model has been off by of late: a voltage, and how resistances follow the current.

A load that begins after a rest meets more resistance at small currents than the same load in the
midst of a drive, by up to a fifth. A model of all logs is right in the mean of both; which of the
two a cell does now is seen in the log, at the currents that flow there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline, kernel
from cellwise.cell.equations import CellState, CellTables, seen_current
from cellwise.cell.packed import changed
from cellwise.estimate.power.load_kernels import (
    AS_MODEL,
    FACTOR_VARIANCE,
    Correction,
    Spread,
    falling_share,
    moment_of,
)
from cellwise.estimate.sensing_kernels import Reading
from cellwise.estimate.status import INNOVATION_REJECTED, VOLTAGE_FROZEN, VOLTAGE_INVALID

# What the model has been off by over the longest usual horizon is taken to stay over the next.
BIAS_S = 30.0
# A factor is judged by what moves between the shortest and the longest usual horizon.
NEAR_S, FAR_S = 2.0, BIAS_S
FORGOTTEN_PER_S = FACTOR_VARIANCE / 40_000.0  # half a day: SOC and temperature are others then
LEAST_SWING_V2 = 0.003**2  # of R0 I + V1: below, sensors and OCV move as much
LEAST_MISS_V2 = 0.002**2  # no voltage is measured and modelled better
LONGER = 10.0  # mean squares are taken over this many times the means
UNUSED = INNOVATION_REJECTED | VOLTAGE_INVALID | VOLTAGE_FROZEN


class Smoothed(NamedTuple):
    """One quantity, its mean over ``NEAR_S``, and that one's over ``FAR_S``."""

    near: float
    far: float


class Memory(NamedTuple):
    """A correction, the voltages ``seen_s`` it goes by, and the means it is estimated from.

    ``fast`` is R0 I + V1, ``fallen`` the same times the share that falls with the current, ``tail``
    V2, ``miss`` measured less modelled voltage; the last two are mean squares of what moves.
    """

    but: Correction
    seen_s: float
    current_A: float
    fast: Smoothed
    fallen: Smoothed
    tail: Smoothed
    miss: Smoothed
    swing_V2: float
    miss_V2: float


@kernel
def no_memory() -> Memory:
    """Before any sample."""
    none = Smoothed(0.0, 0.0)
    return Memory(AS_MODEL, 0.0, math.nan, none, none, none, none, 0.0, 0.0)


@inline
def smoothed(was: Smoothed, value: float, near: float, far: float) -> Smoothed:
    """A quantity followed, by shares of the way to it."""
    mean = was.near + near * (value - was.near)
    return Smoothed(mean, was.far + far * (mean - was.far))


@inline
def forgetting(s: Spread, dt_s: float) -> Spread:
    """Variances grow towards what they were before anything was seen."""
    more, most = FORGOTTEN_PER_S * dt_s, FACTOR_VARIANCE
    return Spread(
        min(s.cc + more, most), s.cf, s.ct, min(s.ff + more, most), s.ft, min(s.tt + more, most)
    )


@inline
def taken_off(but: Correction, fast_V: float, fallen_V: float, tail_V: float) -> float:
    """By how much more the corrected cell's voltage falls than the model's [V]."""
    return but.common * fast_V + (but.falling * fallen_V + but.tail * tail_V)


@inline
def least_squares(
    but: Correction, fast_V: float, fallen_V: float, tail_V: float, left_V: float, noise_V2: float
) -> Correction:
    """One step of recursive least squares of the three numbers; ``left_V`` is what they miss."""
    s = but.spread
    c = s.cc * fast_V + (s.cf * fallen_V + s.ct * tail_V)
    f = s.cf * fast_V + (s.ff * fallen_V + s.ft * tail_V)
    t = s.ct * fast_V + (s.ft * fallen_V + s.tt * tail_V)
    k = 1.0 / (noise_V2 + (fast_V * c + (fallen_V * f + tail_V * t)))
    spread = Spread(
        max(s.cc - k * c * c, 0.0), s.cf - k * c * f, s.ct - k * c * t,
        max(s.ff - k * f * f, 0.0), s.ft - k * f * t, max(s.tt - k * t * t, 0.0),
    )  # fmt: skip
    k *= left_V
    return Correction(but.common - k * c, but.falling - k * f, but.tail - k * t, but.bias_V, spread)


@kernel
def remembered(
    tables: CellTables,
    was: Memory,
    x: CellState,
    reading: Reading,
    temperature_C: float,
    status: int,
) -> Memory:
    """One sample on; the voltage is that of the state ``x`` after it was used.

    The bias is the mean over ``BIAS_S`` of measured less corrected voltage, a plain one until that
    has gone by. A sample that was rejected, or is the sensor's fault, is left out.
    """
    dt_s = reading.dt_s
    before = was.current_A if math.isfinite(was.current_A) else reading.current_A
    seen_A = seen_current(tables.cell, reading.current_A, before, dt_s)
    now = moment_of(tables, x, seen_A, False, temperature_C + x.heat_K, AS_MODEL)
    miss_V = reading.voltage_V - now.voltage_V
    if not math.isfinite(miss_V) or status & UNUSED:
        return changed(was, "current_A", reading.current_A)
    near, far = min(dt_s / NEAR_S, 1.0), min(dt_s / FAR_S, 1.0)
    if was.seen_s <= 0.0:
        near = far = 1.0
    fast_V, old = now.point.r0_ohm * seen_A + x.v1_V, was.but
    fallen_V = fast_V * falling_share(tables.cell, seen_A)
    fast = smoothed(was.fast, fast_V, near, far)
    fallen = smoothed(was.fallen, fallen_V, near, far)
    tail = smoothed(was.tail, x.v2_V, near, far)
    miss = smoothed(was.miss, miss_V, near, far)
    a, b, c = fast.near - fast.far, fallen.near - fallen.far, tail.near - tail.far
    left_V = (miss.near - miss.far) + taken_off(old, a, b, c)
    share = far / LONGER
    swing_V2 = was.swing_V2 + share * (a * a - was.swing_V2)
    miss_V2 = was.miss_V2 + share * (left_V * left_V - was.miss_V2)
    but = changed(old, "spread", forgetting(old.spread, dt_s))
    if swing_V2 >= LEAST_SWING_V2 and dt_s > 0.0:
        # One piece of evidence in twice the time of the band.
        noise_V2 = max(miss_V2, LEAST_MISS_V2) * max(2.0 * FAR_S / dt_s, 1.0)
        but = least_squares(but, a, b, c, left_V, noise_V2)
    seen_s = min(was.seen_s + dt_s, BIAS_S)
    off_V = miss_V + taken_off(but, fast_V, fallen_V, x.v2_V)
    share = min(dt_s / seen_s, 1.0) if seen_s > 0.0 else 1.0
    but = changed(but, "bias_V", but.bias_V + share * (off_V - but.bias_V))
    return Memory(but, seen_s, reading.current_A, fast, fallen, tail, miss, swing_V2, miss_V2)
