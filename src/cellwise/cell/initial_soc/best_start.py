"""The initial SOC from which a simulation fits a log best."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import for_kernel, inline, rows
from cellwise.cell.equations import (
    CellState,
    CellTables,
    advance,
    at_rest,
    look_up,
    seen_current,
    voltage_of,
)
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import UPPER_HALF, known_temperature_C
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray, IndexArray


class MeasuredRows(NamedTuple):
    """The rows of a log, shape (n,) each, as `simulate_rows` takes them; a voltage may be NaN."""

    interval_s: FloatArray
    current_A: FloatArray
    temperature_C: FloatArray
    voltage_V: FloatArray


class Starts(NamedTuple):
    """SOC and hysteresis state of rested starts, shape (m,) each."""

    soc: FloatArray
    h: FloatArray


class Pieces(NamedTuple):
    """Shape (n,): the piece of the log a row is of, what share of an unknown past remains."""

    number: IndexArray
    past: FloatArray


class PieceSums(NamedTuple):
    """Of every start over every piece, shape (m, pieces), and how far SOC left 0..1, shape (m,).

    Squared errors, errors times the share of the past that remains, the model's own variance.
    """

    squares_V2: FloatArray
    products_V: FloatArray
    known_V2: FloatArray
    beyond: FloatArray


@inline
def rested(starts: Starts, k: int) -> CellState:
    """One of the starts as a state."""
    return at_rest(starts.soc[k], starts.h[k])


@rows
def best_start(tables: CellTables, starts: Starts, log: MeasuredRows) -> tuple[int, float]:
    """Which of the rested starts has the smallest sum of squared voltage errors, and that sum.

    A missing voltage counts nothing. A start is left as soon as it is worse than the best one
    before it. Returns its number and the sum [V^2].
    """
    best, least = 0, math.inf
    likely = nearest_start(tables, starts, log)
    for place in range(-1, starts.soc.size):
        k = likely if place < 0 else place  # the likely one first: most others are left early then
        state = rested(starts, k)
        previous, total = log.current_A[0], 0.0
        for i in range(log.interval_s.size):
            seen = seen_current(tables.cell, log.current_A[i], previous, log.interval_s[i])
            previous = log.current_A[i]
            state, point = advance(tables, state, seen, log.interval_s[i], log.temperature_C[i])
            error = log.voltage_V[i] - voltage_of(point, state, seen)
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
    starts: Starts,
    log: MeasuredRows,
    pieces: Pieces,
    slow_error_V: FloatArray,
    sums: PieceSums,
) -> None:
    """Sums over the pieces of a log of the voltage error from every rested start, into ``sums``.

    ``slow_error_V`` is the model's persistent error over even SOC from 0 to 1 [V].
    """
    last = slow_error_V.size - 1
    for k in range(starts.soc.size):
        state = rested(starts, k)
        previous = log.current_A[0]
        for i in range(log.interval_s.size):
            seen = seen_current(tables.cell, log.current_A[i], previous, log.interval_s[i])
            previous = log.current_A[i]
            state, point = advance(tables, state, seen, log.interval_s[i], log.temperature_C[i])
            sums.beyond[k] = max(sums.beyond[k], state.soc - 1.0, -state.soc)
            error = log.voltage_V[i] - voltage_of(point, state, seen)
            if error == error:  # not NaN
                piece = pieces.number[i]
                sums.squares_V2[k, piece] += error * error
                sums.products_V[k, piece] += error * pieces.past[i]
                slow = slow_error_V[min(max(int(state.soc * last + 0.5), 0), last)]
                sums.known_V2[k, piece] += slow * slow


@rows
def nearest_start(tables: CellTables, starts: Starts, log: MeasuredRows) -> int:
    """The start whose voltage is nearest at the first row where one was measured."""
    row = 0
    while row < log.voltage_V.size - 1 and not math.isfinite(log.voltage_V[row]):
        row += 1
    nearest, least = 0, math.inf
    for k in range(starts.soc.size):
        point = look_up(tables, starts.soc[k], log.temperature_C[row])
        error = abs(log.voltage_V[row] - voltage_of(point, rested(starts, k), log.current_A[row]))
        if error < least:
            nearest, least = k, error
    return nearest


def best_start_soc(model: CellModel, log: CellLog, soc0: FloatArray) -> tuple[float, float]:
    """The initial SOC from which `simulate` fits a log's voltage best, of those given.

    Parameters
    ----------
    model : CellModel
    log : CellLog
    soc0 : (m,) float     SOC at the first row, each within 0..1

    Returns
    -------
    float, float          the SOC, and the root mean square of the voltage error from there [V]
    """
    return best_start_of(model, rows_to_fit(model, log), soc0)


def rows_to_fit(model: CellModel, log: CellLog) -> MeasuredRows:
    """What the search for a start needs of a log."""
    return MeasuredRows(
        log.interval_s,
        log.known_current_A(),
        known_temperature_C(model, log),
        for_kernel(log.voltage_V),
    )


def best_start_of(model: CellModel, rows: MeasuredRows, soc0: FloatArray) -> tuple[float, float]:
    """:func:`best_start_soc` of rows that are prepared."""
    starts = np.array(soc0, dtype=np.float64)
    h0 = np.where(starts > UPPER_HALF, 1.0, -1.0)
    number, total = best_start(model.parameters(), Starts(starts, h0), rows)
    known = max(int(np.count_nonzero(np.isfinite(rows.voltage_V))), 1)
    return float(starts[number]), math.sqrt(total / known)
