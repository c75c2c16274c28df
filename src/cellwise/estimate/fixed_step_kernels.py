"""The fixed step in float32: the same sentences, in the same order, as firmware_ref/cellwise_ekf.c.

Same bits as the C: full parentheses, no contraction, no exp, pow or sqrt, every constant float32,
every conversion written out. Upper-case arguments are known when a loop is compiled, so that what
is not compiled in costs nothing; an effect's fields exist in the records only where it is.

State x = [soc, v1, v2, v3, h, offset]; ``c`` are the constants, ``t`` the table of shape
(temperatures, points, fields of a row), ``x`` the state: see ``fixed_step_layout``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from cellwise.estimate.status import OUT_OF_RANGE

# Typed as anything: numba sees float32 and uint32, a type checker should not see more.
F: Any = np.float32
U: Any = np.uint32

ZERO, QUARTER, HALF, ONE, TWO = F(0.0), F(0.25), F(0.5), F(1.0), F(2.0)
THREE, FOUR = F(3.0), F(4.0)
KNOW_NOTHING_SOC = F(0.5)
KNOW_NOTHING_VARIANCE = F(0.09)
SOC_VARIANCE_MOST = F(1.0)
VARIANCE_FLOOR = F(1e-12)
GROW = F(float.fromhex("0x1.000004p+0"))
BEYOND = F(0.05)
WIDE_VARIANCE = F(4e-4)
SHORTEST_CHORD = F(1e-6)
SMALL_MOVE = F(0.05)
SLOPE_FLOOR_V = F(0.05)
RECOVERY_VARIANCE = F(0.09)
TEMPERATURE_LOW_C, TEMPERATURE_HIGH_C = F(-60.0), F(120.0)
HEAT_MOST_K = F(200.0)
LARGE = F(1e6)
CARRY_MOST = F(1e-3)
LEAST_FALL = F(0.1)
LONGEST_GAP = 1_000_000
NOT_BEGUN, NO_VOLTAGE_YET, FIRST_VOLTAGE, EVIDENCE_MOST = U(0), U(1), U(2), U(2_000_000)
SHARED_GROWTH = F(4.0)
REST_RATE = F(0.01)
START_REST_RATE = F(0.1)
START_LOAD_SHARE = F(0.5)
START_LOAD_RATE = F(0.25)
RECOVERY_RATE = F(0.3)
REJECTION, UNDER_LOAD, FORGIVEN = U(20), U(1), U(2)  # a rejection counts twenty
LARGEST_FLOAT = F(float.fromhex("0x1.fffffep+127"))
SIXTH, TWENTY_FOURTH = F(1.0 / 6.0), F(1.0 / 24.0)
ROOT_STEPS = (F(0.0025), F(0.0144), F(0.09))
ROOT_STARTS = (F(0.035), F(0.08), F(0.2), F(0.5))

# Columns of a table row; what follows depends on the options.
OCV, NOISE, R0, R1, LAG1, R2, LAG2, R3, LAG3 = range(9)

helper = njit(cache=True, error_model="numpy", fastmath=False)
kernel = njit(cache=True, error_model="numpy", fastmath=False, inline="always")  # prunes options


class Place(NamedTuple):
    """Where a temperature lies between two tables, and what it does to every resistance."""

    low: int
    weight: float
    scale: float


class Slopes(NamedTuple):
    """Slopes over SOC, while it is badly known: of the voltage, the OCV's bend, of the branches.

    ``spread`` is the standard deviation of SOC, 0 while it is well known.
    """

    slope_V: float
    bend_V: float
    spread: float
    rise1: float
    rise2: float
    rise3: float


class Load(NamedTuple):
    """What the load does to resistances, and whether it does."""

    rate: int
    asymmetry: int
    rate_per_A: float
    charge_scale: float


class Point(NamedTuple):
    """The tables at one SOC and temperature."""

    ocv_V: float
    slope_V: float
    noise_V2: float
    r0_ohm: float
    r1_ohm: float
    gain1: float
    r2_ohm: float
    gain2: float
    r3_ohm: float
    gain3: float
    m_V: float


@helper
def between(a: float, b: float, f: float) -> Any:
    """From a at f = 0 to b at f = 1."""
    return a + (f * (b - a))


@helper
def clip(x: Any, low: float, high: float) -> Any:
    """Held within low..high."""
    if x < low:
        return low
    if x > high:
        return high
    return x


@helper
def magnitude(x: Any) -> Any:
    """Absolute value."""
    if x < ZERO:
        return -x
    return x


@helper
def within(x: Any, low: float, high: float) -> Any:
    """False for NaN too."""
    return (x >= low) & (x <= high)


@helper
def out_of_range(x: float) -> Any:
    """Bit for a number that no cell of this kind gives; asked of readings that were refused."""
    if within(x, -LARGEST_FLOAT, LARGEST_FLOAT):
        return U(OUT_OF_RANGE)
    return U(0)


@helper
def add(total: float, carry: float, value: float) -> tuple[float, float]:
    """Compensated sum: what rounding keeps from the total stays in the carry."""
    missed = value - carry
    new = total + missed
    return new, (new - total) - missed


@helper
def decay(z: float) -> Any:
    """exp(-z) for z >= 0 by five terms of exp(z): exact at 0, falls to 0, never negative."""
    fourth = SIXTH + (z * TWENTY_FOURTH)
    return ONE / (ONE + (z * (ONE + (z * (HALF + (z * fourth))))))


@helper
def root(square: float) -> Any:
    """Square root of a variance between WIDE_VARIANCE and 4, to 1e-4: three Newton steps."""
    r = ROOT_STARTS[0]
    if square > ROOT_STEPS[2]:
        r = ROOT_STARTS[3]
    elif square > ROOT_STEPS[1]:
        r = ROOT_STARTS[2]
    elif square > ROOT_STEPS[0]:
        r = ROOT_STARTS[1]
    r = HALF * (r + (square / r))
    r = HALF * (r + (square / r))
    return HALF * (r + (square / r))


@kernel
def place_of(c: Any, temperature_C: float, TEMPERATURES: int, ARRHENIUS: int) -> Place:
    """Neighbouring tables of a temperature, and the Arrhenius factor."""
    low = U(0)
    weight = ZERO
    scale = ONE
    if TEMPERATURES:
        while low < U(c.per_K.size - 1) and temperature_C > c.grid_C[low + U(1)]:
            low = U(low + U(1))
        weight = clip((temperature_C - c.grid_C[low]) * c.per_K[low], ZERO, ONE)
    if ARRHENIUS:
        y = clip(
            (temperature_C - c.arrhenius_low_C) * c.arrhenius_per_K, ZERO, F(c.arrhenius.size - 1)
        )
        k = U(y)
        if k > U(c.arrhenius.size - 2):
            k = U(c.arrhenius.size - 2)
        scale = between(c.arrhenius[k], c.arrhenius[k + U(1)], y - F(k))
    return Place(low, weight, scale)


@helper
def index_of(x: Any, points: int) -> Any:
    """Lower point of the SOC interval that holds x, a SOC in units of the grid."""
    k = U(0)
    if x > ZERO:
        k = U(x) if x < F(points - 2) else U(points - 2)
    return k


@kernel
def read(t: Any, place: Any, k: int, column: int, f: float, TEMPERATURES: int) -> Any:
    """One table at a fraction of an interval."""
    low = between(t[place.low, k, column], t[place.low, k + U(1), column], f)
    if TEMPERATURES:
        high = place.low + U(1)
        low = between(low, between(t[high, k, column], t[high, k + U(1), column], f), place.weight)
    return low


@kernel
def rise(t: Any, place: Any, k: int, TEMPERATURES: int) -> Any:
    """How far the OCV rises over an interval."""
    low = t[place.low, k + U(1), OCV] - t[place.low, k, OCV]
    if TEMPERATURES:
        high = place.low + U(1)
        low = between(low, t[high, k + U(1), OCV] - t[high, k, OCV], place.weight)
    return low


@kernel
def tables_at(
    t: Any,
    place: Any,
    soc: float,
    current: float,
    load: Load,
    TEMPERATURES: int,
    SLOW: int,
    HYSTERESIS: int,
    SCALED: int,
) -> Point:
    """Outside 0..1 the OCV goes on along its last segment, every other table stays at its end."""
    points = t.shape[1]
    x = soc * F(points - 1)
    k = index_of(x, points)
    f = clip(x - F(k), -(BEYOND * F(points - 1)), ONE + (BEYOND * F(points - 1)))
    g = clip(f, ZERO, ONE)
    ocv = read(t, place, k, OCV, f, TEMPERATURES)
    slope = rise(t, place, k, TEMPERATURES) * F(points - 1)
    noise = read(t, place, k, NOISE, g, TEMPERATURES)
    r0 = read(t, place, k, R0, g, TEMPERATURES)
    r1 = read(t, place, k, R1, g, TEMPERATURES)
    gain1 = ONE / read(t, place, k, LAG1, g, TEMPERATURES)
    r2 = read(t, place, k, R2, g, TEMPERATURES)
    gain2 = ONE / read(t, place, k, LAG2, g, TEMPERATURES)
    r3 = ZERO
    gain3 = ZERO
    m = ZERO
    if SLOW:
        r3 = read(t, place, k, R3, g, TEMPERATURES)
        gain3 = ONE / read(t, place, k, LAG3, g, TEMPERATURES)
    if HYSTERESIS:
        m = read(t, place, k, LAG2 + 1 + 2 * SLOW, g, TEMPERATURES)
    if SCALED:
        scale = place.scale
        if load.asymmetry and current < ZERO:
            scale = scale * load.charge_scale
        r3 = r3 * scale
        if load.rate:
            scale = scale / clip(ONE + (load.rate_per_A * magnitude(current)), LEAST_FALL, LARGE)
        r0 = r0 * scale
        r1 = r1 * scale
        r2 = r2 * scale
    return Point(ocv, slope, noise, r0, r1, gain1, r2, gain2, r3, gain3, m)


@helper
def look_up_one(
    t: Any,
    place: Any,
    soc: float,
    current: float,
    load: Load,
    SLOW: int,
    HYSTERESIS: int,
    SCALED: int,
) -> Point:
    """The tables of a model with one temperature."""
    return tables_at(t, place, soc, current, load, 0, SLOW, HYSTERESIS, SCALED)


@helper
def look_up_many(
    t: Any,
    place: Any,
    soc: float,
    current: float,
    load: Load,
    SLOW: int,
    HYSTERESIS: int,
    SCALED: int,
) -> Point:
    """The tables of a model with several temperatures."""
    return tables_at(t, place, soc, current, load, 1, SLOW, HYSTERESIS, SCALED)


@kernel
def look_up(
    t: Any,
    place: Any,
    soc: float,
    current: float,
    load: Load,
    TEMPERATURES: int,
    SLOW: int,
    HYSTERESIS: int,
    SCALED: int,
) -> Any:
    """The tables at one SOC, temperature and current."""
    if TEMPERATURES:
        return look_up_many(t, place, soc, current, load, SLOW, HYSTERESIS, SCALED)
    return look_up_one(t, place, soc, current, load, SLOW, HYSTERESIS, SCALED)


@kernel
def load_of(c: Any, RATE: int, ASYMMETRY: int) -> Load:
    """The constants of what the load does to resistances."""
    rate_per_A = ZERO
    charge_scale = ONE
    if RATE:
        rate_per_A = c.rate_per_A
    if ASYMMETRY:
        charge_scale = c.charge_scale
    return Load(RATE, ASYMMETRY, rate_per_A, charge_scale)


@helper
def look_up_many_or_one(
    t: Any,
    place: Any,
    soc: float,
    current: float,
    load: Load,
    SLOW: int,
    HYSTERESIS: int,
    SCALED: int,
) -> Point:
    """As :func:`look_up`, where speed does not matter."""
    if t.shape[0] > 1:
        return look_up_many(t, place, soc, current, load, SLOW, HYSTERESIS, SCALED)
    return look_up_one(t, place, soc, current, load, SLOW, HYSTERESIS, SCALED)


@helper
def slopes_of(
    t: Any,
    place: Any,
    soc: float,
    spread: float,
    current: float,
    p: Any,
    load: Load,
    SLOW: int,
    HYSTERESIS: int,
    SCALED: int,
) -> Slopes:
    """While SOC is badly known slopes are chords over one standard deviation to either side.

    A far-off start must not be corrected with the slope of where it stands. A SOC that is far off
    brings the resistances of another SOC with it, so R0's slope joins the OCV's.
    """
    slope = p.slope_V
    bend = ZERO
    rise1 = ZERO
    rise2 = ZERO
    rise3 = ZERO
    if spread > ZERO:
        low = clip(soc - spread, ZERO, ONE)
        high = clip(soc + spread, ZERO, ONE)
        if (high - low) >= SHORTEST_CHORD:
            per = ONE / (high - low)
            a = look_up_many_or_one(t, place, low, current, load, SLOW, HYSTERESIS, SCALED)
            b = look_up_many_or_one(t, place, high, current, load, SLOW, HYSTERESIS, SCALED)
            ocv = (b.ocv_V - a.ocv_V) * per
            ohmic = (b.r0_ohm - a.r0_ohm) * per
            rise1 = (b.r1_ohm - a.r1_ohm) * per
            rise2 = (b.r2_ohm - a.r2_ohm) * per
            if SLOW:
                rise3 = (b.r3_ohm - a.r3_ohm) * per
            slope = ocv - (ohmic * current)
            bend = (a.ocv_V - p.ocv_V) + (ocv * (soc - low))
    return Slopes(slope, bend, spread, rise1, rise2, rise3)
