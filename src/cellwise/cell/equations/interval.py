"""An interval of constant current: the equations one after the other."""

from __future__ import annotations

from cellwise.cell.compiled import inline
from cellwise.cell.equations.load import under_load
from cellwise.cell.equations.lookup import place_of, tables_at
from cellwise.cell.equations.records import CellState, CellTables
from cellwise.cell.equations.states import hysteresis_step, relaxed, soc_step, transition
from cellwise.cell.equations.surface import at_surface, slow_step, surface_soc
from cellwise.cell.equations.temperature import at_temperature, heat_step
from cellwise.cell.equations.voltage import polarisation
from cellwise.cell.point_kernels import CellPoint


@inline
def look_up(tables: CellTables, soc: float, temperature_C: float, slow_A: float = 0.0) -> CellPoint:
    """Tables at one SOC and temperature, and what temperature does beside, under no load.

    Resistances and time constants are those of the particles' surface, which follows ``slow_A``.
    """
    cell = tables.cell
    point = tables_at(tables.table, place_of(tables, soc, temperature_C))
    if cell.surface_per_A != 0.0:
        surface = surface_soc(cell, soc, slow_A, temperature_C)
        point = at_surface(tables, point, surface, temperature_C)
    return at_temperature(cell, point, temperature_C)


@inline
def loaded(
    tables: CellTables, soc: float, temperature_C: float, current_A: float, slow_A: float
) -> CellPoint:
    """Tables at one SOC, temperature and current, and the one that the surface has followed."""
    return under_load(tables.cell, look_up(tables, soc, temperature_C, slow_A), current_A)


@inline
def advance(
    tables: CellTables, state: CellState, current_A: float, dt_s: float, temperature_C: float
) -> tuple[CellState, CellPoint]:
    """One interval of constant current: charge first, then the branches at the new SOC."""
    cell = tables.cell
    soc = soc_step(cell, state.soc, current_A, dt_s)
    slow = slow_step(cell, state.slow_A, current_A, dt_s)
    cell_C = temperature_C + state.heat_K
    point = loaded(tables, soc, cell_C, current_A, slow)
    t = transition(cell, point, current_A, dt_s)
    v1 = relaxed(state.v1_V, t.a1, t.g1, current_A)
    v2 = relaxed(state.v2_V, t.a2, t.g2, current_A)
    v3 = relaxed(state.v3_V, t.a3, t.g3, current_A)
    h = hysteresis_step(state.h, t.ah, current_A)
    drop = polarisation(point.r0_ohm, current_A, v1, v2, v3)
    heat = heat_step(cell, state.heat_K, current_A, drop, dt_s)
    return CellState(soc, v1, v2, v3, h, heat, slow), point
