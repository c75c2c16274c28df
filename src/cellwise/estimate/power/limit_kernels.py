"""The largest load that stays within every limit over a horizon, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline, kernel, part, rows
from cellwise.cell.equations import CellTables, with_soc
from cellwise.cell.equations.scalar import distance_beyond
from cellwise.cell.packed import changed, record_at
from cellwise.cell.plausibility.validity_kernels import ValidityScalars
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.power.load_kernels import (
    BIAS_S,
    LoadedState,
    OperatingPoint,
    end_variance,
    held,
    moment_of,
)
from cellwise.typing import FloatArray

# Which limit a load reaches first.
BY_VOLTAGE, BY_CURRENT, BY_SOC, BY_SUPPLY = range(4)
IMPOSSIBLE = -1.0
SMALLEST_SHIFT = 1e-6  # of SOC: below it there is no chord


class LimitSearch(NamedTuple):
    """How the largest load is looked for."""

    widenings: int = 24  # doublings of the bracket at most
    trials: int = 60  # false positions at most
    tolerance: float = 1e-6  # of the load
    near: float = 0.02  # of the load: how far a neighbour's answer is tried to either side


SEARCH = LimitSearch()

SUSTAINED_SIGMAS = 1.6449  # one-sided 95 % of a normal distribution


class LimitScalars(NamedTuple):
    """Limits of a cell as the kernels see them; currents without sign, infinite where none is."""

    low_V: float
    high_V: float
    discharge_A: float
    charge_A: float
    low_soc: float
    high_soc: float


class StatedModel(NamedTuple):
    """A model, and by how much it says that it is off."""

    tables: CellTables
    noise: NoiseScalars


class Question(NamedTuple):
    """What is asked of a cell one way: the largest load, within what, and for how long.

    ``power`` holds a power, not a current; ``side`` is 1 on discharge and -1 on charge; ``sigmas``
    deviations of the voltage and of the SOC are kept from the limits.
    """

    tables: CellTables
    noise: NoiseScalars
    limits: LimitScalars
    now: OperatingPoint
    power: bool
    horizon_s: float
    side: float
    sigmas: float


class Trial(NamedTuple):
    """A load that was tried: where it leads, its room to the nearest limit, which one that is.

    ``off_V`` is by how much the voltage may be lower or higher than it says.
    """

    load: LoadedState
    off_V: float
    margin: float
    reason: int


class Capability(NamedTuple):
    """The largest load: power and current at the horizon's end, without sign, and what limits it.

    ``load`` is what was held, without sign; ``voltage_V`` the terminal voltage at the end.
    """

    power_W: float
    current_A: float
    voltage_V: float
    reason: int
    load: float


@part
def led_to(q: Question, load: float, soc: float) -> LoadedState:
    """Where a load, without sign, leads to from a SOC."""
    start = with_soc(q.now.cell, soc)
    return held(
        q.tables, start, q.side * load, q.power, q.horizon_s, q.now.temperature_C, q.now.but
    )


@inline
def is_known(valid: ValidityScalars, now: OperatingPoint) -> bool:
    """Whether what ``BIAS_S`` of voltages have shown of the model's error is so of the next load.

    Not beyond the temperatures of its data: there the resistances are off, and an error that was
    seen at one current is another one at the next.
    """
    inside = distance_beyond(now.temperature_C, valid.cold_C, valid.warm_C) == 0.0
    return inside and now.but.seen_s >= BIAS_S


@part
def known_slope_V(q: Question) -> float:
    """Of the voltage at no load over SOC, where ``BIAS_S`` of voltages have been seen; else 0.

    A SOC that is off has moved these as well, and the bias has taken that away.
    """
    now = q.now
    if not q.sigmas > 0.0 or not is_known(q.noise.valid, now):
        return 0.0
    here = moment_of(q.tables, now.cell, 0.0, False, now.temperature_C, now.but)
    off_soc = q.side * q.sigmas * math.sqrt(now.soc_variance)
    if abs(off_soc) <= SMALLEST_SHIFT:
        return here.point.ocv_slope_V
    shifted = with_soc(now.cell, now.cell.soc - off_soc)
    worse = moment_of(q.tables, shifted, 0.0, False, now.temperature_C, now.but)
    return (here.voltage_V - worse.voltage_V) / off_soc


@part
def trial(q: Question, load: float, seen_slope_V: float) -> Trial:
    """Hold one load, without sign; the margin to the nearest limit is above 0 within all.

    Margins are compared as shares: a volt, the largest current, all of the SOC. The slope of the
    voltage over SOC is the chord to the SOC that is ``sigmas`` deviations worse, so that a
    resistance that rises there counts; ``seen_slope_V`` of it is known.
    """
    soc = q.now.cell.soc
    there = led_to(q, load, soc)
    possible = there.now.possible
    off_V = 0.0
    off_soc = q.sigmas * math.sqrt(q.now.soc_variance)
    if possible and q.sigmas > 0.0:
        slope_V = there.now.point.ocv_slope_V
        if off_soc > SMALLEST_SHIFT:
            worse = led_to(q, load, soc - q.side * off_soc).now
            possible = worse.possible
            slope_V = (there.now.voltage_V - worse.voltage_V) / (q.side * off_soc)
        slope_V -= seen_slope_V
        variance_V2 = end_variance(q.tables, q.noise, q.now, there, slope_V)
        off_V = q.sigmas * math.sqrt(variance_V2)
    if not possible:
        return Trial(there, 0.0, IMPOSSIBLE, BY_SUPPLY)
    if q.side > 0.0:
        margin = there.lowest_V - off_V - q.limits.low_V
        most_A = q.limits.discharge_A
        left_soc = there.end.soc - off_soc - q.limits.low_soc
    else:
        margin = q.limits.high_V - there.highest_V - off_V
        most_A = q.limits.charge_A
        left_soc = q.limits.high_soc - there.end.soc - off_soc
    reason = BY_VOLTAGE
    if math.isfinite(most_A):
        left = (most_A - there.largest_A) / max(most_A, 1e-12)
        if left < margin:
            margin = left
            reason = BY_CURRENT
    if left_soc < margin:
        margin = left_soc
        reason = BY_SOC
    return Trial(there, off_V, margin, reason)


@kernel
def largest_load(q: Question, guess: float) -> Capability:
    """The largest load that stays within the limits; ``guess`` is a neighbour's, or 0.

    Bracketed, then false position (Illinois) on the margin to the nearest limit, which falls as
    the load grows. Not even no load: the power is 0.

    Source: G. Plett, High-performance battery-pack power estimation using a dynamic cell model,
    IEEE Trans. Veh. Technol. 53 (2004) 1586, 10.1109/TVT.2004.832408, section IV (bisection).
    """
    now, limits = q.now, q.limits
    none = moment_of(q.tables, now.cell, 0.0, False, now.temperature_C, now.but)
    discharge = q.side > 0.0
    far_V = none.voltage_V - limits.low_V if discharge else limits.high_V - none.voltage_V
    # As if R0 alone took it all: more than a cell gives, for most.
    b = max(far_V, 1e-3) / max(none.point.r0_ohm, 1e-9)
    b = min(b, 1.001 * (limits.discharge_A if discharge else limits.charge_A) + 1e-9)
    if q.power:
        b *= max(limits.low_V if discharge else limits.high_V, 1e-3)
    known_V = known_slope_V(q)
    a = (1.0 - SEARCH.near) * guess
    best = trial(q, a, known_V)
    if a > 0.0 and best.margin > 0.0:
        b = (1.0 + SEARCH.near) * guess
    elif a > 0.0:
        b = a
        a = 0.0
        best = trial(q, a, known_V)
    fa = best.margin
    if not fa > 0.0:
        return Capability(0.0, 0.0, best.load.now.voltage_V, best.reason, 0.0)
    worst = best
    for _ in range(SEARCH.widenings):
        worst = trial(q, b, known_V)
        if not worst.margin > 0.0:
            break
        a, fa, best = b, worst.margin, worst
        b *= 2.0
    fb = worst.margin
    reason = worst.reason
    last = 0
    for k in range(SEARCH.trials):
        if fb > 0.0 or b - a <= SEARCH.tolerance * b:
            break
        c = (a * fb - b * fa) / (fb - fa)
        # A jump (a power that no current gives) or a kink: halve now and then.
        if k % 4 == 3 or not (a < c < b):
            c = 0.5 * (a + b)
        there = trial(q, c, known_V)
        if there.margin > 0.0:
            a, fa, best = c, there.margin, there
            if last == 1:
                fb *= 0.5
            last = 1
            if there.margin < SEARCH.tolerance:
                reason = there.reason
                break
        else:
            b, fb, reason = c, there.margin, there.reason
            if last == -1:
                fa *= 0.5
            last = -1
    end = best.load.now
    end_A = abs(end.current_A)
    end_W = a if q.power else end_A * (end.voltage_V - best.off_V)
    return Capability(end_W, end_A, end.voltage_V, reason, a)


@kernel
def present_at(values: FloatArray, k: int) -> OperatingPoint:
    """One row as it was put."""
    now: OperatingPoint = record_at(OperatingPoint, values[k], 0, 1)
    return now


@rows
def power_rows(
    unseen: StatedModel,
    seen: StatedModel,
    limits: LimitScalars,
    power: bool,
    horizon_s: float,
    present: FloatArray,
    out: FloatArray,
) -> None:
    """Power of every row, shape (rows, ways, 5), from rows of an `OperatingPoint` each.

    On discharge and on charge the power, its lower bound, current and voltage at the horizon's end
    and what limits it. ``unseen`` is what the model states, ``seen`` what it states of a cell whose
    voltages have been seen for `BIAS_S`. The search begins at the loads of the row before.
    """
    down, down_low, up, up_low = 0.0, 0.0, 0.0, 0.0
    for k in range(present.shape[0]):
        now = present_at(present, k)
        tables, noise = seen if is_known(unseen.noise.valid, now) else unseen
        for way in range(2):
            side = 1.0 - 2.0 * way
            value = Question(tables, noise, limits, now, power, horizon_s, side, 0.0)
            sure = changed(value, "sigmas", SUSTAINED_SIGMAS)
            found = largest_load(value, up if way else down)
            low = largest_load(sure, up_low if way else down_low)
            if way:
                up, up_low = found.load, low.load
            else:
                down, down_low = found.load, low.load
            out[k, way, 0] = found.power_W
            out[k, way, 1] = min(low.power_W, found.power_W)
            out[k, way, 2] = found.current_A
            out[k, way, 3] = found.voltage_V
            out[k, way, 4] = found.reason
