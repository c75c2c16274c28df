"""A CC/CV supply on the cell's own equations: the limit's instant and the holding current, solved.

Every function adds rows to ``out``, shape (ROW, rows), and says why it stopped. A row holds for
the interval that ends there, so that simulating the rows again gives the same voltages.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import kernel, rows
from cellwise.cell.equations import BEYOND, CellState, CellTables, advance, voltage_of
from cellwise.typing import FloatArray

# Rows of the output: time since the step's start, current, voltage.
TIME, CURRENT, VOLTAGE = range(3)
ROW = 3

# Why a kernel stopped; FULL: no room for another row, call again with a new output.
FULL, ENDED, AT_LIMIT, OUT_OF_RANGE = range(4)

# The OCV goes no further: a step that gets here will not reach its limit.
SOC_MARGIN = BEYOND

BISECTIONS = 60
VOLTAGE_TOLERANCE_V = 1e-12
SLIVER = 1e-9  # intervals shorter than this share of a period are rounding


class Progress(NamedTuple):
    """Where a step stands: the cell, time since the step's start, rows written, why it stopped."""

    state: CellState
    elapsed_s: float
    rows: int
    reason: int


@kernel
def interval(
    tables: CellTables,
    state: CellState,
    current_A: float,
    dt_s: float,
    temperature_C: float,
) -> tuple[CellState, float]:
    """State and terminal voltage at the end of an interval of constant current."""
    after, point = advance(tables, state, current_A, dt_s, temperature_C)
    return after, voltage_of(point, after, current_A)


@kernel
def time_to_voltage(
    tables: CellTables,
    state: CellState,
    current_A: float,
    dt_s: float,
    temperature_C: float,
    voltage_V: float,
) -> float:
    """Instant within an interval of constant current at which the voltage is reached [s].

    The voltage has to lie between those at the interval's two ends; the instant found is on the
    far side of it, by less than rounding.
    """
    near, far = 0.0, dt_s
    beyond = interval(tables, state, current_A, far, temperature_C)[1] > voltage_V
    for _ in range(BISECTIONS):
        middle = 0.5 * (near + far)
        v = interval(tables, state, current_A, middle, temperature_C)[1]
        if v == voltage_V:
            return middle
        if (v > voltage_V) == beyond:
            far = middle
        else:
            near = middle
    return far


@kernel
def holding_current(
    tables: CellTables,
    state: CellState,
    voltage_V: float,
    dt_s: float,
    temperature_C: float,
    low_A: float,
    high_A: float,
    guess_A: float,
) -> float:
    """Current within [low, high] that makes the voltage at the interval's end the one asked for.

    The end voltage falls with the current. It is solved by bracketing, then false position
    (Illinois); where even a bound does not get there, the bound is the answer.
    """
    a = min(max(guess_A, low_A), high_A)
    after, point = advance(tables, state, a, dt_s, temperature_C)
    fa = voltage_of(point, after, a) - voltage_V
    if abs(fa) <= VOLTAGE_TOLERANCE_V:
        return a
    # Bracket: step outwards, at first by what R0 alone would ask for.
    step = fa / point.r0_ohm
    b, fb = a, fa
    while True:
        b = min(max(a + step, low_A), high_A)
        fb = interval(tables, state, b, dt_s, temperature_C)[1] - voltage_V
        if (fb > 0.0) != (fa > 0.0):
            break
        if b in (low_A, high_A) or not math.isfinite(fb):
            return b
        a, fa = b, fb
        step *= 2.0
    side = 0
    for _ in range(2 * BISECTIONS):
        c = (a * fb - b * fa) / (fb - fa)
        fc = interval(tables, state, c, dt_s, temperature_C)[1] - voltage_V
        if abs(fc) <= VOLTAGE_TOLERANCE_V or c in (a, b):
            return c
        if (fc > 0.0) == (fb > 0.0):
            b, fb = c, fc
            if side == 1:
                fa *= 0.5
            side = 1
        else:
            a, fa = c, fc
            if side == -1:
                fb *= 0.5
            side = -1
    return b


@kernel
def next_row(elapsed_s: float, period_s: float, end_s: float) -> float:
    """Instant of the next row: the next multiple of the period, or the end."""
    k = math.floor(elapsed_s / period_s + SLIVER) + 1.0
    following = k * period_s
    if following > end_s - SLIVER * period_s:
        return end_s
    return following


@rows
def constant_current_rows(
    tables: CellTables,
    state: CellState,
    current_A: float,
    temperature_C: float,
    elapsed_s: float,
    end_s: float,
    period_s: float,
    limit_V: float,
    out: FloatArray,
) -> Progress:
    """Constant current until ``end_s`` or until the voltage passes ``limit_V`` (NaN: none).

    On discharge the limit is a lower one, on charge an upper one; the last row is at its instant.
    """
    sign = 1.0 if current_A > 0.0 else -1.0
    _, v = interval(tables, state, current_A, 0.0, temperature_C)
    if sign * (v - limit_V) <= 0.0:
        return Progress(state, elapsed_s, 0, AT_LIMIT)
    rows = 0
    while elapsed_s < end_s:
        if rows == out.shape[1]:
            return Progress(state, elapsed_s, rows, FULL)
        stop = next_row(elapsed_s, period_s, end_s)
        dt = stop - elapsed_s
        after, v = interval(tables, state, current_A, dt, temperature_C)
        reached = sign * (v - limit_V) <= 0.0
        if reached:
            dt = time_to_voltage(tables, state, current_A, dt, temperature_C, limit_V)
            after, v = interval(tables, state, current_A, dt, temperature_C)
            stop = elapsed_s + dt
        state = after
        elapsed_s = stop
        out[TIME, rows] = elapsed_s
        out[CURRENT, rows] = current_A
        out[VOLTAGE, rows] = v
        rows += 1
        if reached:
            return Progress(state, elapsed_s, rows, AT_LIMIT)
    return Progress(state, elapsed_s, rows, ENDED)


@rows
def constant_voltage_rows(
    tables: CellTables,
    state: CellState,
    voltage_V: float,
    low_A: float,
    high_A: float,
    until_A: float,
    temperature_C: float,
    elapsed_s: float,
    end_s: float,
    period_s: float,
    out: FloatArray,
) -> Progress:
    """Hold a voltage by a current within [low, high] until ``end_s``, or to ``until_A`` (NaN: no).

    The last row is at the instant at which the current has come down to ``until_A``.
    """
    # What the supply would deliver at this instant gives the direction.
    current = holding_current(tables, state, voltage_V, 0.0, temperature_C, low_A, high_A, 0.0)
    sign = 1.0 if current > 0.0 else -1.0
    if sign * current <= until_A:
        return Progress(state, elapsed_s, 0, AT_LIMIT)
    rows = 0
    while elapsed_s < end_s:
        if rows == out.shape[1]:
            return Progress(state, elapsed_s, rows, FULL)
        stop = next_row(elapsed_s, period_s, end_s)
        dt = stop - elapsed_s
        current = holding_current(
            tables, state, voltage_V, dt, temperature_C, low_A, high_A, current
        )
        reached = sign * current <= until_A
        if reached:
            current = sign * until_A
            dt = time_to_voltage(tables, state, current, dt, temperature_C, voltage_V)
            stop = elapsed_s + dt
        state, v = interval(tables, state, current, dt, temperature_C)
        elapsed_s = stop
        out[TIME, rows] = elapsed_s
        out[CURRENT, rows] = current
        out[VOLTAGE, rows] = v
        rows += 1
        if reached:
            return Progress(state, elapsed_s, rows, AT_LIMIT)
        if abs(state.soc - 0.5) > 0.5 + SOC_MARGIN:
            return Progress(state, elapsed_s, rows, OUT_OF_RANGE)
    return Progress(state, elapsed_s, rows, ENDED)


@rows
def profile_rows(
    tables: CellTables,
    state: CellState,
    end_s: FloatArray,
    current_A: FloatArray,
    low_V: float,
    high_V: float,
    temperature_C: float,
    out: FloatArray,
) -> Progress:
    """Follow a current; where a limit would be passed, hold it (``out`` has a row for each end).

    The held current lies between zero and the one asked for: a supply that trims a discharge
    pulse does not charge.
    """
    elapsed = 0.0
    for k in range(end_s.size):
        dt = end_s[k] - elapsed
        current = current_A[k]
        after, v = interval(tables, state, current, dt, temperature_C)
        if current > 0.0 and v < low_V:
            current = holding_current(
                tables, state, low_V, dt, temperature_C, 0.0, current, current
            )
            after, v = interval(tables, state, current, dt, temperature_C)
        elif current < 0.0 and v > high_V:
            current = holding_current(
                tables, state, high_V, dt, temperature_C, current, 0.0, current
            )
            after, v = interval(tables, state, current, dt, temperature_C)
        state = after
        elapsed = end_s[k]
        out[TIME, k] = elapsed
        out[CURRENT, k] = current
        out[VOLTAGE, k] = v
        if abs(state.soc - 0.5) > 0.5 + SOC_MARGIN:
            return Progress(state, elapsed, k + 1, OUT_OF_RANGE)
    return Progress(state, elapsed, end_s.size, ENDED)
