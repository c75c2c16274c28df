"""A supply on the cell's own equations: follows a current, holds a voltage, finds the instant.

A row holds for the interval that ends there, so that simulating the rows again gives the same
voltages.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import kernel, rows
from cellwise.cell.equations import BEYOND, CellState, CellTables, advance, voltage_of
from cellwise.typing import FloatArray

# Rows of the output: current, voltage.
CURRENT, VOLTAGE = range(2)
ROW = 2
# Why it stopped: all rows done; the current came down to what was asked; the OCV goes no further.
ENDED, AT_LIMIT, OUT_OF_RANGE = range(3)

BISECTIONS = 60
VOLTAGE_TOLERANCE_V = 1e-12


class Supply(NamedTuple):
    """What a supply keeps to: voltage on discharge and on charge, and the current that ends it.

    ``until_A`` is a magnitude, NaN where no current ends the step.
    """

    low_V: float
    high_V: float
    until_A: float
    temperature_C: float


class SuppliedInterval(NamedTuple):
    """A current over an interval, and where it takes the cell."""

    current_A: float
    state: CellState
    voltage_V: float


class Progress(NamedTuple):
    """Where a step stands: the cell, time since the step's start, rows written, why it stopped."""

    state: CellState
    elapsed_s: float
    rows: int
    reason: int


@kernel
def interval(
    tables: CellTables, state: CellState, current_A: float, dt_s: float, temperature_C: float
) -> SuppliedInterval:
    """An interval of constant current."""
    after, point = advance(tables, state, current_A, dt_s, temperature_C)
    return SuppliedInterval(current_A, after, voltage_of(point, after, current_A))


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
    beyond = interval(tables, state, current_A, far, temperature_C).voltage_V > voltage_V
    for _ in range(BISECTIONS):
        middle = 0.5 * (near + far)
        v = interval(tables, state, current_A, middle, temperature_C).voltage_V
        if (v > voltage_V) == beyond:
            far = middle
        else:
            near = middle
    return far


@kernel
def kept_voltage(supply: Supply, high_A: float) -> float:
    """The voltage that is kept where the current may go up to this."""
    return supply.low_V if high_A > 0.0 else supply.high_V


@kernel
def held(
    tables: CellTables,
    state: CellState,
    supply: Supply,
    dt_s: float,
    low_A: float,
    high_A: float,
    guess_A: float,
) -> SuppliedInterval:
    """The current within [low, high] with which the interval ends at the supply's voltage.

    The end voltage falls with the current. It is solved by bracketing, then false position
    (Illinois); where even a bound does not get there, the bound is the answer.
    """
    voltage_V, temperature_C = kept_voltage(supply, high_A), supply.temperature_C
    if low_A >= 0.0:
        guess_A = high_A
    elif high_A <= 0.0:
        guess_A = low_A
    a = min(max(guess_A, low_A), high_A)
    after, point = advance(tables, state, a, dt_s, temperature_C)
    at_a = SuppliedInterval(a, after, voltage_of(point, after, a))
    fa = at_a.voltage_V - voltage_V
    if abs(fa) <= VOLTAGE_TOLERANCE_V or a == (high_A if fa > 0.0 else low_A):
        return at_a
    # Bracket: step outwards, at first by what R0 alone would ask for.
    step = fa / point.r0_ohm
    while True:
        b = min(max(a + step, low_A), high_A)
        at_b = interval(tables, state, b, dt_s, temperature_C)
        fb = at_b.voltage_V - voltage_V
        if (fb > 0.0) != (fa > 0.0):
            break
        if b in (low_A, high_A) or not math.isfinite(fb):
            return at_b
        a, fa = b, fb
        step *= 2.0
    side = 0
    for _ in range(2 * BISECTIONS):
        c = (a * fb - b * fa) / (fb - fa)
        at_c = interval(tables, state, c, dt_s, temperature_C)
        fc = at_c.voltage_V - voltage_V
        if abs(fc) <= VOLTAGE_TOLERANCE_V or c in (a, b):
            return at_c
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
    return interval(tables, state, b, dt_s, temperature_C)


@kernel
def at_limit(supply: Supply, now: SuppliedInterval, until_A: float, high_A: float) -> bool:
    """Whether an interval ends at the voltage with the very current that ends the step."""
    beside_V = abs(now.voltage_V - kept_voltage(supply, high_A))
    return now.current_A == until_A and beside_V <= VOLTAGE_TOLERANCE_V


@rows
def supply_rows(
    tables: CellTables,
    state: CellState,
    supply: Supply,
    elapsed_s: float,
    end_s: FloatArray,
    low_A: FloatArray,
    high_A: FloatArray,
    out: FloatArray,
) -> Progress:
    """A row for each instant of ``end_s``, the current within [low, high] and the voltage kept.

    A constant current has one bound at zero, as a drive has: a supply that trims a discharge does
    not charge. Where the current has come down to ``until_A``, the last row is at that instant,
    which is written into ``end_s``.

    Parameters
    ----------
    end_s, low_A, high_A : (n,) float      ends since the step's start [s], bounds [A]
    out : (ROW, n) float                   current [A], voltage [V]
    """
    now = held(tables, state, supply, 0.0, low_A[0], high_A[0], 0.0)
    sign = 1.0 if now.current_A > 0.0 else -1.0
    until_A, temperature_C = sign * supply.until_A, supply.temperature_C
    if sign * now.current_A < supply.until_A or at_limit(supply, now, until_A, high_A[0]):
        return Progress(state, elapsed_s, 0, AT_LIMIT)
    for k in range(end_s.size):
        dt = end_s[k] - elapsed_s
        now = held(tables, state, supply, dt, low_A[k], high_A[k], now.current_A)
        early = sign * now.current_A < supply.until_A
        if early:
            limit_V = kept_voltage(supply, high_A[k])
            dt = time_to_voltage(tables, state, until_A, dt, temperature_C, limit_V)
            now = interval(tables, state, until_A, dt, temperature_C)
            end_s[k] = elapsed_s + dt
        state, elapsed_s = now.state, end_s[k]
        out[CURRENT, k] = now.current_A
        out[VOLTAGE, k] = now.voltage_V
        if early or at_limit(supply, now, until_A, high_A[k]):
            return Progress(state, elapsed_s, k + 1, AT_LIMIT)
        off = state.soc - 0.5
        if abs(off) > 0.5 + BEYOND and now.current_A * off < 0.0:
            return Progress(state, elapsed_s, k + 1, OUT_OF_RANGE)
    return Progress(state, elapsed_s, end_s.size, ENDED)
