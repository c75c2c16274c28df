"""Slopes over SOC while it is badly known: chords in place of tangents."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations import CellTables, loaded
from cellwise.cell.point_kernels import OCV, CellPoint

WIDE_VARIANCE = 4e-4  # beyond 2 points of SOC the tangent is no guide
SMALL_MOVE = 0.05  # of a standard deviation: the slope is that of the spot left
SHORTEST_CHORD = 1e-6
FLAT_SHARE = 0.25


class WideSlopes(NamedTuple):
    """Slopes over SOC while it is badly known: of the voltage, its bend, of the branches."""

    voltage_V: float
    bend_V: float
    r1_ohm: float
    r2_ohm: float
    r3_ohm: float


@inline
def wide_slopes(
    tables: CellTables,
    soc: float,
    point: CellPoint,
    spread: float,
    temperature_C: float,
    current_A: float,
    slow_A: float,
) -> WideSlopes:
    """Chords over one standard deviation of SOC on either side; inside 0..1.

    A far-off start must not be corrected with the slope of the spot where it happens to stand, nor
    be thought of as right afterwards when the OCV is no straight line: the bend is the distance
    from the OCV here to the chord.

    A SOC that is far off brings the resistances of another SOC with it: R0's slope joins the
    OCV's, those of the branches drive the branch voltages.
    """
    low = min(max(soc - spread, 0.0), 1.0)
    high = min(max(soc + spread, 0.0), 1.0)
    if high - low < SHORTEST_CHORD:  # both beyond the same end
        return WideSlopes(point.ocv_slope_V, 0.0, 0.0, 0.0, 0.0)
    a = loaded(tables, low, temperature_C, current_A, slow_A)
    b = loaded(tables, high, temperature_C, current_A, slow_A)
    per = 1.0 / (high - low)
    ocv = (b.ocv_V - a.ocv_V) * per
    return WideSlopes(
        ocv - (b.r0_ohm - a.r0_ohm) * per * current_A,
        a.ocv_V + ocv * (soc - low) - point.ocv_V,
        (b.r1_ohm - a.r1_ohm) * per,
        (b.r2_ohm - a.r2_ohm) * per,
        (b.r3_ohm - a.r3_ohm) * per,
    )


@inline
def flat_slope(tables: CellTables) -> float:
    """OCV slope below which the OCV is flat for its kind: a quarter of its mean slope [V]."""
    table = tables.table
    return FLAT_SHARE * float(table[0, table.shape[1] - 1, OCV] - table[0, 0, OCV])


class Slopes(NamedTuple):
    """Slopes as a step takes them: tangents, or chords where SOC is badly known.

    ``spread`` is the standard deviation of SOC, 0 while it is well known; ``r1_ohm`` ... are the
    slopes of the branches' resistances, 0 then.
    """

    slope_V: float
    bend_V: float
    tangent_V: float
    spread: float
    r1_ohm: float
    r2_ohm: float
    r3_ohm: float


@inline
def slopes_at(
    tables: CellTables,
    soc: float,
    soc_variance: float,
    point: CellPoint,
    temperature_C: float,
    current_A: float,
    slow_A: float,
) -> Slopes:
    """Tangents while SOC is known to WIDE_VARIANCE, chords beyond."""
    tangent = point.ocv_slope_V
    if soc_variance <= WIDE_VARIANCE:
        return Slopes(tangent, 0.0, tangent, 0.0, 0.0, 0.0, 0.0)
    spread = math.sqrt(soc_variance)
    w = wide_slopes(tables, soc, point, spread, temperature_C, current_A, slow_A)
    return Slopes(w.voltage_V, w.bend_V, tangent, spread, w.r1_ohm, w.r2_ohm, w.r3_ohm)


@inline
def landing_slope(
    tables: CellTables,
    soc: float,
    at: Slopes,
    temperature_C: float,
    current_A: float,
    slow_A: float,
    move: float,
) -> float:
    """The flattest slope between where the estimate stands and where the gain takes it [V]."""
    if abs(move) <= SMALL_MOVE * at.spread:
        return min(at.slope_V, at.tangent_V)
    there = soc + move
    landed = loaded(tables, there, temperature_C, current_A, slow_A)
    w = wide_slopes(tables, there, landed, at.spread, temperature_C, current_A, slow_A)
    return min(min(w.voltage_V, landed.ocv_slope_V), at.slope_V)


@inline
def bends(tables: CellTables, at: Slopes, bend_V2: float, one_V2: float) -> bool:
    """Whether the voltage is no straight line over SOC's band, or flat: too bent for a slope."""
    return bend_V2 > one_V2 or at.slope_V < flat_slope(tables)
