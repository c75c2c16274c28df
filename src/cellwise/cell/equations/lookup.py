"""Where a SOC and a temperature lie in the tables, and what stands there."""

from __future__ import annotations

import numpy as np

from cellwise.cell.compiled import inline
from cellwise.cell.equations.records import CellTables, TablePlace
from cellwise.cell.point_kernels import CellPoint, between, point_of
from cellwise.typing import FloatArray

# How far beyond 0..1 the OCV goes on along its last segment.
BEYOND = 0.05


@inline
def place_of(tables: CellTables, soc: float, temperature_C: float) -> TablePlace:
    """Where one SOC and temperature lie in the tables.

    Outside 0..1 the OCV goes on along its last segment for BEYOND, so that a filter keeps a slope
    to come back on; every other parameter stays at its end value. Temperature is held at the ends.
    """
    table, grid = tables.table, tables.grid_C
    lo = np.uint64(0)
    w = 0.0
    if table.shape[0] > 1:
        last = np.uint64(grid.size - 2)
        while lo < last and temperature_C > grid[lo + np.uint64(1)]:
            lo += np.uint64(1)
        w = (temperature_C - grid[lo]) / (grid[lo + np.uint64(1)] - grid[lo])
        w = min(max(w, 0.0), 1.0)
    return moved(table, TablePlace(lo, np.uint64(0), 0.0, 0.0, w), soc)


@inline
def moved(table: FloatArray, place: TablePlace, soc: float) -> TablePlace:
    """The place of another SOC at the same temperature."""
    n = table.shape[1]
    x = soc * (n - 1)
    k = np.uint64(min(max(x, 0.0), n - 2.0))  # unsigned: no test for indices from the end
    past = BEYOND * (n - 1)
    f = min(max(x, -past), n - 1 + past) - float(k)
    g = min(max(x, 0.0), n - 1.0) - float(k)
    return TablePlace(place.lo, k, f, g, place.w)


@inline
def tables_at(table: FloatArray, place: TablePlace) -> CellPoint:
    """Tables at one place, linear between grid points."""
    point = point_of(table, place.lo, place.k, place.f, place.g)
    if place.w > 0.0:
        warm = point_of(table, place.lo + np.uint64(1), place.k, place.f, place.g)
        point = between(point, warm, place.w)
    return point
