"""Slopes over SOC while it is badly known: chords in place of tangents."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES
from cellwise.cell.equations import CellTables, loaded
from cellwise.cell.point_kernels import CellPoint
from cellwise.cell.unrolled import ByState, unrolled
from cellwise.estimate.equations.constants import SHORTEST_CHORD, WIDE_VARIANCE
from cellwise.estimate.equations.evidence import chord_of
from cellwise.estimate.filters.covariance_kernels import Branches, no_branches


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

    Those of the branches' resistances drive the branch voltages.
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
    # fmt: off
    chord = chord_of(
        a.ocv_V, a.r0_ohm, b.ocv_V, b.r0_ohm, per, current_A, soc - low, point.ocv_V
    )
    # fmt: on
    return Slopes(
        chord.slope_V,
        chord.bend_V,
        spread,
        Branches(*((b.r[i] - a.r[i]) * per for i in BRANCHES)),
    )
