"""Slopes over SOC while it is badly known: chords in place of tangents."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.compiled import inline, kernel
from cellwise.cell.equations import CellTables, loaded
from cellwise.cell.point_kernels import OCV, CellPoint

SHORTEST_CHORD = 1e-6
FLAT_SHARE = 0.25


class WideSlopes(NamedTuple):
    """Slopes over SOC while it is badly known: of the voltage, its bend, of the branches."""

    voltage_V: float
    bend_V: float
    r1_ohm: float
    r2_ohm: float
    r3_ohm: float


@kernel
def wide_slopes(
    tables: CellTables,
    soc: float,
    point: CellPoint,
    spread: float,
    temperature_C: float,
    current_A: float,
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
    a = loaded(tables, low, temperature_C, current_A)
    b = loaded(tables, high, temperature_C, current_A)
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
