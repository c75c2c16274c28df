"""The cell's equations as compiled scalars: one place, shared by simulation and every filter.

A model without an effect is a model with that effect's neutral value, so there is one set of
kernels. The C twin repeats these sentences in this order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from cellwise.typing import FloatArray

# Columns of CellScalars.table.
OCV, R0, R1, TAU1, R2, TAU2, R3, TAU3, M, ERROR = range(10)
COLUMNS = 10

ZERO_CELSIUS_K = 273.15

# How far beyond 0..1 the OCV goes on along its last segment.
BEYOND = 0.05


class CellScalars(NamedTuple):
    """A CellModel as the kernels see it.

    ``table`` has shape (temperatures, soc points, COLUMNS) over a uniform SOC grid 0..1.
    """

    charge_As: float
    charge_efficiency: float
    activation_K: float
    reference_K: float
    hysteresis_rate: float
    skew_s: float
    rate_per_A: float
    charge_scale: float
    leak_A: float
    heating_K_per_W: float
    heating_s: float


class CellPoint(NamedTuple):
    """The tables at one SOC and temperature."""

    ocv_V: float
    ocv_slope_V: float
    r0_ohm: float
    r1_ohm: float
    tau1_s: float
    r2_ohm: float
    tau2_s: float
    r3_ohm: float
    tau3_s: float
    m_V: float
    error_V: float


class CellState(NamedTuple):
    """What a cell carries from one interval to the next."""

    soc: float
    v1_V: float
    v2_V: float
    v3_V: float
    h: float
    heat_K: float = 0.0


@njit(cache=True, error_model="numpy", inline="always")
def look_up(
    table: FloatArray, grid: FloatArray, cell: CellScalars, soc: float, temperature_C: float
) -> CellPoint:
    """Tables at one SOC and temperature, linear between grid points.

    Outside 0..1 the OCV goes on along its last segment for BEYOND, so that a filter keeps a slope
    to come back on; every other parameter stays at its end value. Temperature is held at the ends.
    """
    n = table.shape[1]
    x = soc * (n - 1)
    k = np.uint64(min(max(x, 0.0), n - 2.0))  # unsigned: no test for indices from the end
    k1 = k + np.uint64(1)
    f = min(max(x - float(k), -BEYOND * (n - 1)), 1.0 + BEYOND * (n - 1))
    g = min(max(f, 0.0), 1.0)
    lo = np.uint64(0)
    w = 0.0
    if table.shape[0] > 1:
        last = np.uint64(grid.size - 2)
        while lo < last and temperature_C > grid[lo + np.uint64(1)]:
            lo += np.uint64(1)
        w = (temperature_C - grid[lo]) / (grid[lo + np.uint64(1)] - grid[lo])
        w = min(max(w, 0.0), 1.0)
    ocv = table[lo, k, OCV] + f * (table[lo, k1, OCV] - table[lo, k, OCV])
    slope = (table[lo, k1, OCV] - table[lo, k, OCV]) * (n - 1)
    r0 = table[lo, k, R0] + g * (table[lo, k1, R0] - table[lo, k, R0])
    r1 = table[lo, k, R1] + g * (table[lo, k1, R1] - table[lo, k, R1])
    tau1 = table[lo, k, TAU1] + g * (table[lo, k1, TAU1] - table[lo, k, TAU1])
    r2 = table[lo, k, R2] + g * (table[lo, k1, R2] - table[lo, k, R2])
    tau2 = table[lo, k, TAU2] + g * (table[lo, k1, TAU2] - table[lo, k, TAU2])
    r3 = table[lo, k, R3] + g * (table[lo, k1, R3] - table[lo, k, R3])
    tau3 = table[lo, k, TAU3] + g * (table[lo, k1, TAU3] - table[lo, k, TAU3])
    m = table[lo, k, M] + g * (table[lo, k1, M] - table[lo, k, M])
    error = table[lo, k, ERROR] + g * (table[lo, k1, ERROR] - table[lo, k, ERROR])
    if w > 0.0:
        up = lo + np.uint64(1)
        ocv += w * (table[up, k, OCV] + f * (table[up, k1, OCV] - table[up, k, OCV]) - ocv)
        slope += w * ((table[up, k1, OCV] - table[up, k, OCV]) * (n - 1) - slope)
        r0 += w * (table[up, k, R0] + g * (table[up, k1, R0] - table[up, k, R0]) - r0)
        r1 += w * (table[up, k, R1] + g * (table[up, k1, R1] - table[up, k, R1]) - r1)
        tau1 += w * (table[up, k, TAU1] + g * (table[up, k1, TAU1] - table[up, k, TAU1]) - tau1)
        r2 += w * (table[up, k, R2] + g * (table[up, k1, R2] - table[up, k, R2]) - r2)
        tau2 += w * (table[up, k, TAU2] + g * (table[up, k1, TAU2] - table[up, k, TAU2]) - tau2)
        r3 += w * (table[up, k, R3] + g * (table[up, k1, R3] - table[up, k, R3]) - r3)
        tau3 += w * (table[up, k, TAU3] + g * (table[up, k1, TAU3] - table[up, k, TAU3]) - tau3)
        m += w * (table[up, k, M] + g * (table[up, k1, M] - table[up, k, M]) - m)
        error += w * (
            table[up, k, ERROR] + g * (table[up, k1, ERROR] - table[up, k, ERROR]) - error
        )
    if cell.activation_K != 0.0:
        scale = arrhenius(temperature_C, cell.activation_K, cell.reference_K)
        r0 *= scale
        r1 *= scale
        r2 *= scale
        r3 *= scale
    return CellPoint(ocv, slope, r0, r1, tau1, r2, tau2, r3, tau3, m, error)


@njit(cache=True, error_model="numpy", inline="always")
def arrhenius(temperature_C: float, activation_K: float, reference_K: float) -> float:
    """Factor on every resistance, exp(E (1/T - 1/T_ref)) with T in kelvin; 1 at T_ref."""
    kelvin = temperature_C + ZERO_CELSIUS_K
    return math.exp(activation_K * (1.0 / kelvin - 1.0 / reference_K))


@njit(cache=True, error_model="numpy", inline="always")
def soc_step(cell: CellScalars, soc: float, current_A: float, dt_s: float) -> float:
    """Coulomb counting over one interval: soc - I dt / (3600 Q), charging times efficiency.

    What leaks inside the cell adds to what the terminals give.
    """
    used = current_A if current_A > 0.0 else current_A * cell.charge_efficiency
    return soc - (used + cell.leak_A) * dt_s / cell.charge_As


@njit(cache=True, error_model="numpy", inline="always")
def under_load(cell: CellScalars, point: CellPoint, current_A: float) -> CellPoint:
    r"""Resistances at one current: they fall with its size, and differ on charge.

    .. math:: R_{0,1,2}(I) = \frac{R_{0,1,2}}{1 + k |I|}, \qquad R_{0..3}(I < 0) = c R_{0..3}

    The first is the falling resistance of a charge transfer (Butler-Volmer) as a fraction of first
    order, which an embedded target can compute; k = 0 and c = 1 leave every resistance as it is.
    """
    r0 = point.r0_ohm
    r1 = point.r1_ohm
    r2 = point.r2_ohm
    r3 = point.r3_ohm
    if cell.rate_per_A != 0.0:
        fall = 1.0 / (1.0 + cell.rate_per_A * abs(current_A))
        r0 *= fall
        r1 *= fall
        r2 *= fall
    if cell.charge_scale != 1.0 and current_A < 0.0:
        r0 *= cell.charge_scale
        r1 *= cell.charge_scale
        r2 *= cell.charge_scale
        r3 *= cell.charge_scale
    # fmt: off
    return CellPoint(
        point.ocv_V, point.ocv_slope_V, r0, r1, point.tau1_s, r2, point.tau2_s, r3, point.tau3_s,
        point.m_V, point.error_V,
    )
    # fmt: on


@njit(cache=True, error_model="numpy", inline="always")
def heat_step(
    cell: CellScalars, heat_K: float, current_A: float, polarisation_V: float, dt_s: float
) -> float:
    r"""Temperature of the cell above what is measured, after an interval.

    .. math:: \vartheta^{+} = b \vartheta + R_{th} P (1 - b), \quad b = e^{-\Delta t/\tau_{th}},
       \quad P = I (R_0 I + V_1 + V_2 + V_3)
    """
    b = math.exp(-dt_s / cell.heating_s)
    return b * heat_K + cell.heating_K_per_W * (1.0 - b) * (current_A * polarisation_V)


@njit(cache=True, error_model="numpy", inline="always")
def rc_step(v_rc: float, current: float, r: float, tau: float, dt: float) -> float:
    r"""Advance one RC branch over an interval of constant current, exactly.

    .. math:: v^{+} = e^{-\Delta t/\tau} v + R (1 - e^{-\Delta t/\tau}) I

    Parameters
    ----------
    v_rc : float      branch voltage at the start [V]
    current : float   cell current, positive on discharge [A]
    r, tau : float    resistance [ohm], time constant [s], tau > 0
    dt : float        length of the interval [s], dt >= 0

    Returns
    -------
    float             branch voltage at the end [V]
    """
    a = math.exp(-dt / tau)
    return a * v_rc + r * (1.0 - a) * current


@njit(cache=True, error_model="numpy", inline="always")
def hysteresis_decay(cell: CellScalars, current_A: float, dt_s: float) -> float:
    r"""How much of the old hysteresis state is left after an interval.

    .. math:: h^{+} = a h - (1 - a)\,\mathrm{sgn}(I), \quad a = e^{-\gamma |I| \Delta t / (3600 Q)}

    Source: G. Plett, Battery Management Systems vol. 1, section 2.6 (one-state hysteresis),
    with discharge current positive.
    """
    return math.exp(-cell.hysteresis_rate * abs(current_A) * dt_s / cell.charge_As)


@njit(cache=True, error_model="numpy", inline="always")
def seen_current(cell: CellScalars, current_A: float, previous_A: float, dt_s: float) -> float:
    """Current that the logged voltage has seen: delayed by the instrument's skew.

    Linear between the two last samples; a skew longer than one interval counts as one interval.
    """
    if cell.skew_s <= 0.0 or dt_s <= 0.0:
        return current_A
    w = min(cell.skew_s / dt_s, 1.0)
    return current_A + w * (previous_A - current_A)


@njit(cache=True, error_model="numpy", inline="always")
def advance(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    state: CellState,
    current_A: float,
    dt_s: float,
    temperature_C: float,
) -> tuple[CellState, CellPoint]:
    """One interval of constant current: charge first, then the branches at the new SOC."""
    soc = soc_step(cell, state.soc, current_A, dt_s)
    point = under_load(
        cell, look_up(table, grid, cell, soc, temperature_C + state.heat_K), current_A
    )
    v1 = rc_step(state.v1_V, current_A, point.r1_ohm, point.tau1_s, dt_s)
    v2 = rc_step(state.v2_V, current_A, point.r2_ohm, point.tau2_s, dt_s)
    v3 = state.v3_V
    if point.r3_ohm != 0.0:
        v3 = rc_step(v3, current_A, point.r3_ohm, point.tau3_s, dt_s)
    h = state.h
    if cell.hysteresis_rate != 0.0:
        left = hysteresis_decay(cell, current_A, dt_s)
        h = left * h - (1.0 - left) * math.copysign(1.0, current_A)
    heat = state.heat_K
    if cell.heating_K_per_W != 0.0:
        polarisation = (point.r0_ohm * current_A + v1) + (v2 + v3)
        heat = heat_step(cell, heat, current_A, polarisation, dt_s)
    return CellState(soc, v1, v2, v3, h, heat), point


@njit(cache=True, error_model="numpy", inline="always")
def terminal_voltage(point: CellPoint, state: CellState, current_A: float) -> float:
    """V = OCV - R0 I - V1 - V2 - V3 + M h."""
    return (
        point.ocv_V
        - point.r0_ohm * current_A
        - state.v1_V
        - state.v2_V
        - state.v3_V
        + point.m_V * state.h
    )


@njit(cache=True, error_model="numpy", nogil=True)
def simulate_rows(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
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
        seen = seen_current(cell, current_A[k], previous, dt_s[k])
        previous = current_A[k]
        state, point = advance(table, grid, cell, state, seen, dt_s[k], temperature_C[k])
        voltage_V[k] = terminal_voltage(point, state, seen)
        soc[k] = state.soc
    return state


def empty_state(soc: float, h: float = 0.0) -> CellState:
    """A cell at rest at the given SOC."""
    return CellState(float(soc), 0.0, 0.0, 0.0, float(h), 0.0)


def table_rows(columns: list[FloatArray]) -> FloatArray:
    """Stack COLUMNS arrays of shape (temperatures, soc points) into one contiguous table."""
    return np.ascontiguousarray(np.stack(columns, axis=-1))
