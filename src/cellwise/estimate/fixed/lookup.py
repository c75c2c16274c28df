"""Tables of the fixed step at one SOC, temperature and current; see ``arithmetic``."""

from __future__ import annotations

from typing import Any, NamedTuple

from cellwise.estimate.fixed.arithmetic import (
    BEYOND,
    HALF,
    LARGE,
    LEAST_FALL,
    ONE,
    SHORTEST_CHORD,
    ZERO,
    F,
    U,
    between,
    clip,
    helper,
    kernel,
    magnitude,
    not_negative,
)

# Columns of a table row; what follows depends on the options.
OCV, NOISE, R0, R1, LAG1, R2, LAG2, R3, LAG3 = range(9)


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
    """Constants of the tables: what the load does to resistances, what the voltage's noise is."""

    rate: int
    asymmetry: int
    rate_per_A: float
    charge_scale: float
    fixed_V2: float
    ocv_soc2: float


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
        if k > U(c.arrhenius.size - 3):
            k = U(c.arrhenius.size - 3)
        # The parabola through three neighbouring points: an exponential bends too much for a line.
        f = y - F(k)
        start = c.arrhenius[k]
        first = c.arrhenius[k + U(1)] - start
        second = c.arrhenius[k + U(2)] - c.arrhenius[k + U(1)]
        scale = start + (f * (first + ((HALF * (f - ONE)) * (second - first))))
    return Place(low, weight, scale)


@helper
def within_one(soc: float) -> Any:
    """The nearer end of 0..1 for a SOC beyond it."""
    if not not_negative(soc, ONE):
        return ZERO if soc < HALF else ONE
    return soc


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
    WIDE: int,
) -> Point:
    """Outside 0..1 the OCV goes on along its last segment, every other table stays at its end.

    Without WIDE the OCV stays, too.
    """
    points = t.shape[1]
    if not WIDE:
        soc = within_one(soc)
    x = soc * F(points - 1)
    k = index_of(x, points)
    f = x - F(k)
    g = f
    if WIDE:
        f = clip(f, -(BEYOND * F(points - 1)), ONE + (BEYOND * F(points - 1)))
        g = clip(f, ZERO, ONE)
    ocv = read(t, place, k, OCV, f, TEMPERATURES)
    slope = rise(t, place, k, TEMPERATURES) * F(points - 1)
    noise = read(t, place, k, NOISE, g, TEMPERATURES)
    if WIDE:
        noise = (load.fixed_V2 + (noise * noise)) + (load.ocv_soc2 * (slope * slope))
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
    WIDE: int,
) -> Point:
    """The tables of a model with one temperature."""
    return tables_at(t, place, soc, current, load, 0, SLOW, HYSTERESIS, SCALED, WIDE)


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
    WIDE: int,
) -> Point:
    """The tables of a model with several temperatures."""
    return tables_at(t, place, soc, current, load, 1, SLOW, HYSTERESIS, SCALED, WIDE)


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
    WIDE: int,
) -> Any:
    """The tables at one SOC, temperature and current."""
    if TEMPERATURES:
        return look_up_many(t, place, soc, current, load, SLOW, HYSTERESIS, SCALED, WIDE)
    return look_up_one(t, place, soc, current, load, SLOW, HYSTERESIS, SCALED, WIDE)


@kernel
def load_of(c: Any, RATE: int, ASYMMETRY: int, WIDE: int) -> Load:
    """The constants of the tables."""
    rate_per_A = ZERO
    charge_scale = ONE
    if RATE:
        rate_per_A = c.rate_per_A
    if ASYMMETRY:
        charge_scale = c.charge_scale
    fixed_V2 = ZERO
    ocv_soc2 = ZERO
    if WIDE:
        fixed_V2 = c.fixed_V2
        ocv_soc2 = c.ocv_soc2
    return Load(RATE, ASYMMETRY, rate_per_A, charge_scale, fixed_V2, ocv_soc2)


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
        return look_up_many(t, place, soc, current, load, SLOW, HYSTERESIS, SCALED, 1)
    return look_up_one(t, place, soc, current, load, SLOW, HYSTERESIS, SCALED, 1)


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
