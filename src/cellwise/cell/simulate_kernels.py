"""A whole log through the cell's equations."""

from __future__ import annotations

from cellwise.cell.compiled import rows
from cellwise.cell.equations import CellState, CellTables, advance, seen_current, voltage_of
from cellwise.typing import FloatArray


@rows
def simulate_rows(
    tables: CellTables,
    start: CellState,
    dt_s: FloatArray,
    current_A: FloatArray,
    temperature_C: FloatArray,
    voltage_V: FloatArray,
    soc: FloatArray,
) -> CellState:
    """Terminal voltage and SOC of every row, into ``voltage_V`` and ``soc``.

    Row k carries the current of the interval that ends there; row 0 has an interval of zero
    length, so its voltage is that of the start state under the first row's current.
    """
    state = start
    previous = current_A[0]
    for k in range(dt_s.size):
        seen = seen_current(tables.cell, current_A[k], previous, dt_s[k])
        previous = current_A[k]
        state, point = advance(tables, state, seen, dt_s[k], temperature_C[k])
        voltage_V[k] = voltage_of(point, state, seen)
        soc[k] = state.soc
    return state
