"""Tables of the fixed step at one SOC, temperature and current."""

from __future__ import annotations

from typing import Any, NamedTuple

from cellwise.cell.compiled import inlined
from cellwise.cell.description import BRANCHES, V1, V2, V3
from cellwise.cell.equations.scalar import charge_transfer
from cellwise.cell.unrolled import THERE, unrolled_by_option
from cellwise.estimate.equations.components import SlowBranch
from cellwise.estimate.equations.covariance import Point, Slopes
from cellwise.estimate.equations.evidence import chord_of, error_variance
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.layout import Model

# Columns of the table: as the options have them once a step is compiled, by name in C.
OCV_V = ERROR_V = R0_OHM = M_V = 0
R = LAG = dict.fromkeys(BRANCHES, 0)  # R1_OHM, LAG1 ...


class Place(NamedTuple):
    """Where a temperature lies between two tables, and what it does to every resistance.

    ``lag`` is the SOC that the particles' surface is below the mean.
    """

    low: int
    weight: float
    scale: float
    lag: SurfaceFloat


class SocPlace(NamedTuple):
    """Where a SOC lies between two points of the tables.

    ``beyond`` is the fraction for the OCV, which goes on outside 0..1, ``within`` that for the
    others; ``at`` and ``share`` are those of the particles' surface.
    """

    k: int
    beyond: float
    within: float
    at: int
    share: float


class Loaded(NamedTuple):
    """Resistances at one SOC, temperature and current."""

    r0_ohm: float
    r1_ohm: float
    r2_ohm: float
    r3_ohm: SlowFloat

    @property
    def r(self) -> dict[Any, float]:
        """By the branch."""
        return dict(zip(BRANCHES, self[1:], strict=True))


def place_of(m: Model, temperature_C: float) -> Place:
    """Neighbouring tables of a temperature, and the Arrhenius factor."""
    low = U(0)
    weight = 0.0
    scale = 1.0
    if TEMPERATURES:
        while low < U(m.constant.grid_C.size - 2) and temperature_C > m.constant.grid_C[low + 1]:
            low = U(low + 1)
        weight = (temperature_C - m.constant.grid_C[low]) * m.constant.per_K[low]
        weight = clip(weight, 0.0, 1.0)
    if ARRHENIUS:
        most = F(m.constant.arrhenius.size - 1)
        y = (temperature_C - m.constant.arrhenius_low_C) * m.constant.arrhenius_per_K
        y = clip(y, 0.0, most)
        k = U(y)
        if k > U(m.constant.arrhenius.size - 3):
            k = U(m.constant.arrhenius.size - 3)
        # The parabola through three neighbouring points: an exponential bends too much for a line.
        f = y - F(k)
        start = m.constant.arrhenius[k]
        first = m.constant.arrhenius[k + 1] - start
        second = m.constant.arrhenius[k + 2] - m.constant.arrhenius[k + 1]
        scale = start + (f * (first + ((0.5 * (f - 1.0)) * (second - first))))
    return Place(low, weight, scale, 0.0)


def within_one(soc: float) -> float:
    """The nearer end of 0..1 for a SOC beyond it."""
    return soc if not_negative(soc, 1.0) else (0.0 if soc < 0.5 else 1.0)


def depth_at(c: Constants, temperature_C: float) -> float:
    """SOC that the particles' surface is below the mean at 1 A and one temperature."""
    most = F(c.depth.size - 1)
    y = (temperature_C - c.depth_low_C) * c.depth_per_K
    y = clip(y, 0.0, most)
    k = U(y)
    if k > U(c.depth.size - 2):
        k = U(c.depth.size - 2)
    f = known_fraction(y - F(k))
    return between(c.depth[k], c.depth[k + 1], f)


def under_surface(c: Constants, x: State, at: Place, temperature_C: WarmFloat) -> Place:
    """The same place with the lag of the particles' surface."""
    depth = depth_at(c, temperature_C) if DEPTH else c.surface_per_A
    lag = clip(depth * x.slow_A, -1.0, 1.0)
    return Place(at.low, at.weight, at.scale, lag)


def aged(x: State, at: Place) -> Place:
    """The same place with the resistances that a history gives."""
    return Place(at.low, at.weight, at.scale * x.resistance_scale, at.lag)


def effective_temperature(x: State) -> float:
    """Temperature of the cell: what was measured last, and its own warming."""
    temperature_C = x.temperature_C
    if HEATING:
        temperature_C = temperature_C + x.heat_K
    return F(temperature_C)


def place_now(m: Model, x: State) -> Place:
    """Where the cell's temperature lies between the tables."""
    effective_temperature_C = effective_temperature(x) if WARM else 0.0
    here = place_of(m, effective_temperature_C) if WARM else place_of(m, 0.0)
    if SURFACE:
        here = under_surface(m.constant, x, here, effective_temperature_C)
    if HEALTH:
        here = aged(x, here)
    return Place(here.low, here.weight, here.scale, here.lag)


def index_of(x: float, points: int) -> int:
    """Lower point of the SOC interval that holds x, a SOC in units of the grid."""
    if WIDE:
        held = x if x > 0.0 else 0.0
        k = U(held) if held < F(points - 2) else U(points - 2)
    else:
        # x is within 0..points - 1
        k = U(x)
        k = k if k < U(points - 2) else U(points - 2)
    return k


def read(m: Model, place: Place, k: int, column: int, f: float) -> Any:
    """One table at a fraction of an interval."""
    low = between(m.row[place.low, k, column], m.row[place.low, k + U(1), column], f)
    if TEMPERATURES:
        above = U(place.low + 1)
        high = between(m.row[above, k, column], m.row[above, k + U(1), column], f)
        low = between(low, high, place.weight)
    return low


def rise(m: Model, place: Place, k: int, column: int) -> Any:
    """How far a table rises over an interval."""
    low = m.row[place.low, k + U(1), column] - m.row[place.low, k, column]
    if TEMPERATURES:
        above = U(place.low + 1)
        low = between(low, m.row[above, k + U(1), column] - m.row[above, k, column], place.weight)
    return low


def soc_place(place: Place, points: int, soc: float) -> SocPlace:
    """Outside 0..1 the OCV goes on along its last segment, every other table stays at its end.

    Without CELLWISE_WIDE the OCV stays, too. With CELLWISE_SURFACE resistances and gains are those
    of the particles' surface.
    """
    if WIDE:
        x = soc * F(points - 1)
        k = index_of(x, points)
        f = x - F(k)
        f = clip(f, -(BEYOND * F(points - 1)), 1.0 + (BEYOND * F(points - 1)))
        g = clip(f, 0.0, 1.0)
    else:
        x = within_one(soc) * F(points - 1)
        k = index_of(x, points)
        f = known_fraction(x - F(k))
        g = f
    at = k
    share = g
    if SURFACE:
        below = within_one(soc - place.lag) * F(points - 1)
        at = index_of(below, points)
        share = known_fraction(below - F(at))
    return SocPlace(k, f, g, at, share)


@inlined
@unrolled_by_option
def resistances_at(m: Model, place: Place, z: SocPlace, current: float) -> Loaded:
    """Resistances by temperature, age and current."""
    r0_ohm = read(m, place, z.at, R0_OHM, z.share)
    r: dict[Any, float] = {}
    for i in BRANCHES:
        r[i] = read(m, place, z.at, R[i], z.share) if THERE else 0.0
    if SCALED:
        scale = place.scale
        if ASYMMETRY and current < 0.0:
            scale = scale * m.constant.charge_scale
        for i in (V3,):  # knows no rate
            r[i] = r[i] * scale
        if RATE:
            fall = 1.0 + (m.constant.rate_per_A * magnitude(current))
            scale = scale / clip(fall, LEAST_FALL, LARGE)
        r0_ohm = r0_ohm * scale
        for i in (V1, V2):
            r[i] = r[i] * scale
    if TRANSFER:
        overvoltage = (m.constant.asinh_per_V * r[V1]) * magnitude(current)
        r[V1] = r[V1] * known_fraction(charge_transfer(at_most(overvoltage, LARGE)))
    return Loaded(r0_ohm, *(r[i] for i in BRANCHES))


@unrolled_by_option
def look_up(m: Model, place: Place, soc: float, current: float) -> Point:
    """All of the tables."""
    points = U(m.row.shape[1])
    z = soc_place(place, points, soc)
    ocv_V = read(m, place, z.k, OCV_V, z.beyond)
    slope_V = rise(m, place, z.k, OCV_V) * F(points - 1)
    error_V = read(m, place, z.k, ERROR_V, z.within)
    noise_V2 = error_variance(m.constant.fixed_V2, error_V, m.constant.ocv_soc2, slope_V)
    gain: dict[Any, float] = {}
    for i in BRANCHES:
        gain[i] = 1.0 / read(m, place, z.at, LAG[i], z.share) if THERE else 0.0
    m_V = read(m, place, z.k, M_V, z.within) if HYSTERESIS else 0.0
    under = resistances_at(m, place, z, current)
    return Point(
        ocv_V,
        slope_V,
        noise_V2,
        under.r0_ohm,
        m_V,
        *(under.r[i] for i in BRANCHES),
        *(gain[i] for i in BRANCHES),
    )


@unrolled_by_option
def slow_branch(m: Model, place: Place, soc: float, current: float) -> SlowBranch:
    """What a load at a SOC does to the slow branch."""
    z = soc_place(place, U(m.row.shape[1]), soc)
    under = resistances_at(m, place, z, current)
    gain: dict[Any, float] = {}
    for i in (V3,):
        gain[i] = 1.0 / read(m, place, z.at, LAG[i], z.share) if THERE else 0.0
    return SlowBranch(*(under.r[i] for i in (V3,)), *(gain[i] for i in (V3,)))


def no_slopes(p: Point) -> Slopes:
    """SOC is well known: the OCV's tangent, and nothing else."""
    return Slopes(p.slope_V, 0.0, 0.0, 0.0, 0.0, 0.0)


@noinline
@unrolled_by_option
def slopes_of(
    m: Model, place: Place, soc: float, spread: float, current: float, p: Point
) -> Slopes:
    """While SOC is badly known slopes are chords over one standard deviation to either side."""
    low_soc = clip(soc - spread, 0.0, 1.0)
    high_soc = clip(soc + spread, 0.0, 1.0)
    slope_V = p.slope_V
    bend_V = 0.0
    rise: dict[Any, float] = {}
    for i in BRANCHES:
        rise[i] = 0.0 if THERE else 0.0  # noqa: RUF034  # named where it is there
    if (high_soc - low_soc) >= SHORTEST_CHORD:
        per = 1.0 / (high_soc - low_soc)
        z = soc_place(place, U(m.row.shape[1]), low_soc)
        low_V = read(m, place, z.k, OCV_V, z.beyond)
        end = resistances_at(m, place, z, current)
        ohmic = end.r0_ohm
        for i in BRANCHES:
            rise[i] = end.r[i]
        z = soc_place(place, U(m.row.shape[1]), high_soc)
        high_V = read(m, place, z.k, OCV_V, z.beyond)
        end = resistances_at(m, place, z, current)
        for i in BRANCHES:
            rise[i] = (end.r[i] - rise[i]) * per
        chord = chord_of(low_V, ohmic, high_V, end.r0_ohm, per, current, soc - low_soc, p.ocv_V)
        slope_V = chord.slope_V
        bend_V = chord.bend_V
    return Slopes(slope_V, bend_V, spread, *(rise[i] for i in BRANCHES))
