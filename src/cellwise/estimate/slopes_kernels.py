"""Slopes over SOC while it is badly known: chords in place of tangents."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES
from cellwise.cell.equations import CellTables, loaded
from cellwise.cell.point_kernels import CellPoint
from cellwise.cell.unrolled import ByState, unrolled
from cellwise.estimate.filters.covariance_kernels import Branches, no_branches

WIDE_VARIANCE = 4e-4  # beyond 2 points of SOC the tangent is no guide
SHORTEST_CHORD = 1e-6


class Slopes(NamedTuple):
    """Slopes as a step takes them: tangents, or chords where SOC is badly known.

    Of the voltage over SOC, its bend, ``rise`` of the branches' resistances (0 for tangents);
    ``spread`` is the standard deviation of SOC, 0 while it is well known.
    """

    slope_V: float
    bend_V: float
    spread: float
    rise: Branches


@inline
def tangent(slope_V: float, spread: float) -> Slopes:
    """The voltage as a straight line over SOC."""
    return Slopes(slope_V, 0.0, spread, no_branches())


@inline
@unrolled
def slopes_at(
    tables: CellTables,
    soc: float,
    soc_variance: float,
    point: CellPoint,
    temperature_C: float,
    current_A: float,
    slow_A: float,
) -> Slopes:
    """Tangents while SOC is known to WIDE_VARIANCE; beyond, chords over a deviation either side.

    A far-off start must not be corrected with the slope of the spot where it happens to stand, nor
    be thought of as right afterwards when the OCV is no straight line: the bend is the distance
    from the OCV here to the chord.

    A SOC that is far off brings the resistances of another SOC with it: R0's slope joins the
    OCV's, those of the branches drive the branch voltages.
    """
    if soc_variance <= WIDE_VARIANCE:
        return tangent(point.ocv_slope_V, 0.0)
    spread = math.sqrt(soc_variance)
    low = min(max(soc - spread, 0.0), 1.0)
    high = min(max(soc + spread, 0.0), 1.0)
    if high - low < SHORTEST_CHORD:  # both beyond the same end
        return tangent(point.ocv_slope_V, spread)
    a: ByState = loaded(tables, low, temperature_C, current_A, slow_A)
    b: ByState = loaded(tables, high, temperature_C, current_A, slow_A)
    per = 1.0 / (high - low)
    ocv = (b.ocv_V - a.ocv_V) * per
    return Slopes(
        ocv - (b.r0_ohm - a.r0_ohm) * per * current_A,
        a.ocv_V + ocv * (soc - low) - point.ocv_V,
        spread,
        Branches(*((b.r[i] - a.r[i]) * per for i in BRANCHES)),
    )
