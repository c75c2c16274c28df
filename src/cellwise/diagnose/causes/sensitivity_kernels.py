"""Voltage of a whole log and its derivatives with respect to anything, in one pass of scalar code.

A *direction* says how a parameter enters: as a change of the packed table (looked up like the
table itself), of a scalar of the cell, of the start, of the current that flows. Each direction
carries the derivative of every state; how an interval moves them is printed from the equations,
:mod:`cellwise.cell.derivative_kernels`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import inline, rows
from cellwise.cell.derivative_kernels import carried, driven, partials
from cellwise.cell.equations import (
    BEYOND,
    CellState,
    CellTables,
    Place,
    advance,
    followed,
    place_of,
    surface_soc,
    surfaced,
    tables_at,
    voltage_of,
)
from cellwise.cell.packed import record_at
from cellwise.cell.point_kernels import (
    R1,
    R2,
    R3,
    TAU1,
    TAU2,
    TAU3,
    CellPoint,
    CellScalars,
    rise,
)
from cellwise.typing import BoolArray, FloatArray, IntArray

UNCHANGED = CellPoint(*(0.0 for _ in CellPoint._fields))
STATES = len(CellState._fields)
SCALARS = len(CellScalars._fields)
# The surface's scalars stand together.
FIRST = CellScalars._fields.index("surface_per_A")
# Columns of the table that states follow, whether the cell heats itself or not.
CARRIED = (R1, TAU1, R2, TAU2, R3, TAU3)
SURFACE = slice(FIRST, CellScalars._fields.index("surface_reference_K") + 1)


class Flow(NamedTuple):
    """What drives a cell, shape (n,) each: intervals [s], the current that flows [A], [degC]."""

    interval_s: FloatArray
    current_A: FloatArray
    temperature_C: FloatArray


class Directions(NamedTuple):
    """How P parameters enter.

    scalars : (P, fields of CellScalars)      derivatives of the scalars; ``branch_activation``
                                              is a switch and has none, ``skew_s`` enters by the
                                              current. An OCV that is to move with temperature
                                              needs its reference ``entropy_K``
    soc0 : (P,)                               derivatives of the SOC at the start
    voltage_V : (P,)                          derivatives of what is added to the voltage [V]
    tables : (Q, temperatures, points, COLUMNS)  derivatives of the packed table
    table_of : (P,) int                       row of ``tables``, -1 for none
    currents : (C, rows)                      derivatives of the current that flows [A]
    current_of : (P,) int                     row of ``currents``, -1 for none
    """

    scalars: FloatArray
    soc0: FloatArray
    voltage_V: FloatArray
    tables: FloatArray
    table_of: IntArray
    currents: FloatArray
    current_of: IntArray


@rows
def voltage_rows(
    tables: CellTables,
    start: CellState,
    flow: Flow,
    added_V: float,
    stride: int,
    voltage_V: FloatArray,
    soc: FloatArray,
) -> None:
    """Voltage and SOC of every ``stride``-th row."""
    dt_s, flow_A, temperature_C = flow
    state = start
    out = 0
    for k in range(dt_s.size):
        state, point = advance(tables, state, flow_A[k], dt_s[k], temperature_C[k])
        if k % stride == 0:
            voltage_V[out] = voltage_of(point, state, flow_A[k]) + added_V
            soc[out] = state.soc
            out += 1


@inline
def slopes_at(tables: CellTables, at: Place) -> tuple[CellPoint, CellPoint]:
    """Slopes of the tables over SOC and over temperature [1/K]; none where they are held."""
    table, grid = tables.table, tables.grid_C
    n = table.shape[1]
    end = BEYOND * (n - 1)
    inside = n - 1.0 if at.f == at.g else 0.0
    beyond = n - 1.0 if -end < at.f < 1.0 + end else 0.0
    low = tables_at(table, Place(at.lo, at.k, 0.0, 0.0, at.w))
    high = tables_at(table, Place(at.lo, at.k, 1.0, 1.0, at.w))
    by_soc = rise(low, high, beyond, inside)
    by_kelvin = UNCHANGED
    if 0.0 < at.w < 1.0:
        per_kelvin = 1.0 / (grid[at.lo + np.uint64(1)] - grid[at.lo])
        cold = tables_at(table, Place(at.lo, at.k, at.f, at.g, 0.0))
        warm = tables_at(table, Place(at.lo, at.k, at.f, at.g, 1.0))
        by_kelvin = rise(cold, warm, per_kelvin, per_kelvin)
    return by_soc, by_kelvin


@inline
def with_lag(
    cell: CellScalars, before: CellState, after: CellState, current_A: float, dt_s: float
) -> CellState:
    """The state with the surface's lag, which a model without a surface does not carry.

    The derivative with respect to its depth, at a depth of none, needs it.
    """
    slow = followed(cell, before.slow_A, current_A, dt_s)
    return CellState(after.soc, after.v1_V, after.v2_V, after.v3_V, after.h, after.heat_K, slow)


@inline
def changed(table: FloatArray, mean: Place, surface: Place, surfaces: bool) -> CellPoint:
    """A table at the mean SOC; resistances and time constants at the surface's."""
    here = tables_at(table, mean)
    return surfaced(here, tables_at(table, surface)) if surfaces else here


class Known(NamedTuple):
    """What is known of the directions before the first row: what can be left out where.

    states : (P, STATES)             derivatives of the state, zero but for the start's SOC
    somewhere : (Q, points - 1)      whether a table's derivative has anything between two points
    still : (P,)                     directions that move no state: they change the OCV, its
                                     entropy, R0 or the hysteresis gap alone, or what is added to
                                     the voltage; in a cell that heats itself the loss follows each
    scaled : (P,)                    directions that change a scalar
    surfaces : bool                  whether the particles' surface has a SOC of its own
    """

    states: FloatArray
    somewhere: BoolArray
    still: BoolArray
    scaled: BoolArray
    surfaces: bool


def known(cell: CellScalars, directions: Directions) -> Known:
    """What :func:`row_derivatives` asks of the directions in every row."""
    states = np.zeros((directions.table_of.size, STATES))
    states[:, 0] = directions.soc0
    any_change = np.any(directions.tables != 0.0, axis=(1, 3))
    scaled = np.any(directions.scalars != 0.0, axis=1)
    carries = np.any(directions.tables[..., CARRIED] != 0.0, axis=(1, 2, 3))
    carries |= cell.heating_K_per_W != 0.0
    still = (directions.current_of < 0) & (directions.soc0 == 0.0) & ~scaled
    tabled = directions.table_of >= 0
    still[tabled] &= ~carries[directions.table_of[tabled]]
    surfaces = cell.surface_per_A != 0.0 or bool(np.any(directions.scalars[:, SURFACE] != 0.0))
    return Known(states, any_change[:, :-1] | any_change[:, 1:], still, scaled, surfaces)


def derivative_rows(
    tables: CellTables,
    start: CellState,
    flow: Flow,
    directions: Directions,
    stride: int,
    jacobian: FloatArray,
) -> None:
    """Derivatives of every ``stride``-th row's voltage, into ``jacobian`` (rows, P)."""
    asked = known(tables.cell, directions)
    row_derivatives(tables, start, flow, directions, asked, stride, jacobian)


@rows
def row_derivatives(
    tables: CellTables,
    start: CellState,
    flow: Flow,
    directions: Directions,
    asked: Known,
    stride: int,
    jacobian: FloatArray,
) -> None:
    """The same, compiled."""
    dt_s, flow_A, temperature_C = flow
    scalars, _, voltage_V, changes_of, table_of, currents, current_of = directions
    d, somewhere, still, has_scalars, surfaces = asked
    table, cell = tables.table, tables.cell
    many = table_of.size
    state = start
    out = 0
    for row in range(dt_s.size):
        before, current = state, flow_A[row]
        state, _ = advance(tables, before, current, dt_s[row], temperature_C[row])
        cell_C = temperature_C[row] + before.heat_K
        place = place_of(tables, state.soc, cell_C)
        surface = place
        by_soc, by_kelvin = slopes_at(tables, place)
        if surfaces:
            state = with_lag(cell, before, state, current, dt_s[row])
            surface = place_of(tables, surface_soc(cell, state.soc, state.slow_A, cell_C), cell_C)
            below_soc, below_kelvin = slopes_at(tables, surface)
            by_soc, by_kelvin = surfaced(by_soc, below_soc), surfaced(by_kelvin, below_kelvin)
        here = changed(table, place, surface, surfaces)
        now = partials(
            cell,
            before,
            current,
            dt_s[row],
            temperature_C[row],
            here,
            by_soc,
            by_kelvin,
            surfaces,
        )
        wanted = row % stride == 0
        for p in range(many):
            if still[p] and not wanted:
                continue
            by_flow = currents[current_of[p], row] if current_of[p] >= 0 else 0.0
            change = UNCHANGED
            q = table_of[p]
            if q >= 0 and (somewhere[q, place.k] or somewhere[q, surface.k]):
                change = changed(changes_of[q], place, surface, surfaces)
            # fmt: off
            old = CellState(
                d[p, 0], d[p, 1], d[p, 2], d[p, 3], d[p, 4], d[p, 5], d[p, 6]
            )
            # fmt: on
            # Each compiled for its case, without a branch inside.
            if surfaces:
                new, voltage = carried(now, old, by_flow, change, True)
            else:
                new, voltage = carried(now, old, by_flow, change, False)
            d[p, 0], d[p, 1], d[p, 2] = new.soc, new.v1_V, new.v2_V
            d[p, 3], d[p, 4], d[p, 5], d[p, 6] = new.v3_V, new.h, new.heat_K, new.slow_A
            if has_scalars[p]:
                changes = record_at(CellScalars, scalars, p * SCALARS)
                if surfaces:
                    more, by_scalars = driven(now, changes, True)
                else:
                    more, by_scalars = driven(now, changes, False)
                d[p, 0] += more.soc
                d[p, 1] += more.v1_V
                d[p, 2] += more.v2_V
                d[p, 3] += more.v3_V
                d[p, 4] += more.h
                d[p, 5] += more.heat_K
                d[p, 6] += more.slow_A
                voltage += by_scalars
            if wanted:
                jacobian[out, p] = voltage + voltage_V[p]
        if wanted:
            out += 1
