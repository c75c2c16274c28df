"""An interval of constant current: the equations one after the other."""

from __future__ import annotations

from cellwise.cell.compiled import inline
from cellwise.cell.equations.load import under_load
from cellwise.cell.equations.lookup import moved, place_of, tables_at
from cellwise.cell.equations.records import CellState, CellTables, with_heat
from cellwise.cell.equations.states import soc_step, states_step, transition
from cellwise.cell.equations.surface import slow_step, surface_soc, surfaced
from cellwise.cell.equations.temperature import at_temperature, heat_step
from cellwise.cell.equations.voltage import polarisation_of
from cellwise.cell.point_kernels import CellPoint


@inline
def look_up(tables: CellTables, soc: float, temperature_C: float, slow_A: float = 0.0) -> CellPoint:
    """Tables at one SOC and temperature, and what temperature does beside, under no load.

    Resistances and time constants are those of the particles' surface, which follows ``slow_A``.
    """
    cell = tables.cell
    table = tables.table
    mean = place_of(tables, soc, temperature_C)
    below = mean
    if cell.surface_per_A != 0.0:
        surface = surface_soc(cell, soc, slow_A, temperature_C)
        below = moved(table, mean, surface)
    # Of either look-up only the columns that are used are part of a kernel.
    point = surfaced(tables_at(table, mean), tables_at(table, below))
    return at_temperature(cell, point, temperature_C)


@inline
def loaded(
    tables: CellTables, soc: float, temperature_C: float, current_A: float, slow_A: float
) -> CellPoint:
    """Tables at one SOC, temperature and current, and that behind the surface's lag."""
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
    after = states_step(state, t, current_A, soc, slow)
    heat = heat_step(cell, state.heat_K, current_A, polarisation_of(point, after, current_A), dt_s)
    return with_heat(after, heat), point
