"""How well a log fits the simulations from many initial SOC."""

from __future__ import annotations

import math

from cellwise.cell.compiled import rows
from cellwise.cell.equations import (
    CellState,
    CellTables,
    advance,
    look_up,
    seen_current,
    voltage_of,
)
from cellwise.typing import FloatArray, IndexArray


@rows
def best_start(
    tables: CellTables,
    soc0: FloatArray,
    h0: FloatArray,
    dt_s: FloatArray,
    current_A: FloatArray,
    temperature_C: FloatArray,
    voltage_V: FloatArray,
) -> tuple[int, float]:
    """Which of the rested starts has the smallest sum of squared voltage errors, and that sum.

    ``soc0`` and ``h0`` are SOC and hysteresis state of every start, the others the log's rows as
    `simulate_rows` takes them; a missing voltage counts nothing. A start is left as soon as it is
    worse than the best one before it. Returns its number and the sum [V^2].
    """
    best, least = 0, math.inf
    likely = nearest_start(tables, soc0, h0, current_A, temperature_C, voltage_V)
    for place in range(-1, soc0.size):
        k = likely if place < 0 else place  # the likely one first: most others are left early then
        state = CellState(soc0[k], 0.0, 0.0, 0.0, h0[k], 0.0, 0.0)
        previous, total = current_A[0], 0.0
        for i in range(dt_s.size):
            seen = seen_current(tables.cell, current_A[i], previous, dt_s[i])
            previous = current_A[i]
            state, point = advance(tables, state, seen, dt_s[i], temperature_C[i])
            error = voltage_V[i] - voltage_of(point, state, seen)
            if error == error:  # not NaN
                total += error * error
                if total > least:
                    break
        if total < least or (total == least and k < best):
            best, least = k, total
    return best, least


@rows
def start_errors(
    tables: CellTables,
    soc0: FloatArray,
    h0: FloatArray,
    dt_s: FloatArray,
    current_A: FloatArray,
    temperature_C: FloatArray,
    voltage_V: FloatArray,
    past: FloatArray,
    piece: IndexArray,
    slow_error_V: FloatArray,
    squares_V2: FloatArray,
    products_V: FloatArray,
    known_V2: FloatArray,
    beyond: FloatArray,
) -> None:
    """Sums over the pieces of a log of the voltage error from every rested start.

    Parameters
    ----------
    soc0, h0 : (m,) float         SOC and hysteresis state of every start
    dt_s ... voltage_V : (n,)     the log's rows, as `simulate_rows` takes them
    past : (n,) float             remaining share of an unknown past, 1 at the first row
    piece : (n,) int              number of the piece that a row belongs to
    slow_error_V : (k,) float     the model's persistent error over even SOC from 0 to 1 [V]
    squares_V2 : (m, pieces)      out: sum of the squared errors
    products_V : (m, pieces)      out: sum of the errors times ``past``
    known_V2 : (m, pieces)        out: sum of the model's own variance
    beyond : (m,) float           out: furthest that SOC left 0..1
    """
    last = slow_error_V.size - 1
    for k in range(soc0.size):
        state = CellState(soc0[k], 0.0, 0.0, 0.0, h0[k], 0.0, 0.0)
        previous = current_A[0]
        for i in range(dt_s.size):
            seen = seen_current(tables.cell, current_A[i], previous, dt_s[i])
            previous = current_A[i]
            state, point = advance(tables, state, seen, dt_s[i], temperature_C[i])
            beyond[k] = max(beyond[k], state.soc - 1.0, -state.soc)
            error = voltage_V[i] - voltage_of(point, state, seen)
            if error == error:  # not NaN
                squares_V2[k, piece[i]] += error * error
                products_V[k, piece[i]] += error * past[i]
                slow = slow_error_V[min(max(int(state.soc * last + 0.5), 0), last)]
                known_V2[k, piece[i]] += slow * slow


@rows
def nearest_start(
    tables: CellTables,
    soc0: FloatArray,
    h0: FloatArray,
    current_A: FloatArray,
    temperature_C: FloatArray,
    voltage_V: FloatArray,
) -> int:
    """The start whose voltage is nearest at the first row where one was measured."""
    row = 0
    while row < voltage_V.size - 1 and not math.isfinite(voltage_V[row]):
        row += 1
    nearest, least = 0, math.inf
    for k in range(soc0.size):
        state = CellState(soc0[k], 0.0, 0.0, 0.0, h0[k], 0.0, 0.0)
        point = look_up(tables, soc0[k], temperature_C[row])
        error = abs(voltage_V[row] - voltage_of(point, state, current_A[row]))
        if error < least:
            nearest, least = k, error
    return nearest
