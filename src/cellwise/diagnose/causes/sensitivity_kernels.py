"""Voltage of a whole log and its derivatives with respect to anything, in one pass of scalar code.

A *direction* says how a parameter enters: as a change of the packed table (looked up like the
table itself), of a scalar of the cell, of the start, of the current that flows. Each direction
carries the derivative of every state; the equations are those of :mod:`cellwise.cell.equations`,
differentiated line by line.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from cellwise.cell.equations import (
    BEYOND,
    ZERO_CELSIUS_K,
    CellState,
    CellTables,
    advance,
    voltage_of,
)
from cellwise.cell.point_kernels import (
    COLUMNS,
    ERROR,
    OCV,
    R0,
    R1,
    R2,
    R3,
    TAU1,
    TAU2,
    TAU3,
    CellScalars,
    M,
)
from cellwise.typing import FloatArray, IntArray

# Columns of ``scalars`` of the directions: derivative of ...
(
    D_SOC0,  # the SOC at the start
    D_LN_CHARGE,  # ln of the capacity
    D_VOLTAGE,  # what is added to the voltage [V]
    D_ACTIVATION,  # the Arrhenius activation [K]
    D_LN_HYSTERESIS,  # ln of the hysteresis rate
    D_RATE,  # rate_per_A
    D_LN_CHARGE_SCALE,  # ln of charge_scale
    D_LEAK,  # leak_A
    D_HEATING,  # heating_K_per_W
    D_LN_HEATING_S,  # ln of heating_s
) = range(10)
D_SCALARS = 10

# States whose derivatives are carried.
S_SOC, S_V1, S_V2, S_V3, S_H, S_HEAT = range(6)
STATES = 6


class Directions(NamedTuple):
    """How P parameters enter.

    scalars : (P, D_SCALARS)                  derivatives of scalars
    tables : (Q, temperatures, points, COLUMNS)  derivatives of the packed table
    table_of : (P,) int                       row of ``tables``, -1 for none
    currents : (C, rows)                      derivatives of the current that flows [A]
    current_of : (P,) int                     row of ``currents``, -1 for none
    """

    scalars: FloatArray
    tables: FloatArray
    table_of: IntArray
    currents: FloatArray
    current_of: IntArray


@njit(cache=True, error_model="numpy", nogil=True)
def voltage_rows(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    start: CellState,
    dt_s: FloatArray,
    flow_A: FloatArray,
    temperature_C: FloatArray,
    added_V: float,
    stride: int,
    voltage_V: FloatArray,
    soc: FloatArray,
) -> None:
    """Voltage and SOC of every ``stride``-th row, ``flow_A`` being the current that flows."""
    tables_ = CellTables(table, grid, cell)
    state = start
    out = 0
    for k in range(dt_s.size):
        state, point = advance(tables_, state, flow_A[k], dt_s[k], temperature_C[k])
        if k % stride == 0:
            voltage_V[out] = voltage_of(point, state, flow_A[k]) + added_V
            soc[out] = state.soc
            out += 1


@njit(cache=True, error_model="numpy", inline="always")
def _between(
    table: FloatArray, lo: int, up: int, k: int, f: float, w: float, column: int
) -> tuple[float, float, float]:
    """Value of a column, its slope over a grid step of SOC, its rise over a temperature step."""
    a = table[lo, k, column]
    b = table[lo, k + 1, column]
    c = table[up, k, column]
    d = table[up, k + 1, column]
    low = a + f * (b - a)
    high = c + f * (d - c)
    return low + w * (high - low), (b - a) + w * ((d - c) - (b - a)), high - low


@njit(cache=True, error_model="numpy", nogil=True)
def derivative_rows(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    start: CellState,
    dt_s: FloatArray,
    flow_A: FloatArray,
    temperature_C: FloatArray,
    scalars: FloatArray,
    tables: FloatArray,
    table_of: IntArray,
    currents: FloatArray,
    current_of: IntArray,
    stride: int,
    jacobian: FloatArray,
) -> None:
    """Derivatives of every ``stride``-th row's voltage, into ``jacobian`` (rows, P)."""
    directions = table_of.size
    n = table.shape[1]
    x = np.zeros((directions, STATES))
    for p in range(directions):
        x[p, S_SOC] = scalars[p, D_SOC0]
    value = np.zeros(COLUMNS)
    by_soc = np.zeros(COLUMNS)
    by_kelvin = np.zeros(COLUMNS)
    change = np.zeros(COLUMNS)
    resistance = np.zeros(4)
    tau = np.zeros(4)
    tables_ = CellTables(table, grid, cell)
    state = start
    out = 0
    for row in range(dt_s.size):
        dt = dt_s[row]
        current = flow_A[row]
        before = state
        state, _ = advance(tables_, before, current, dt, temperature_C[row])
        # The point again, with its slopes.
        kelvin = temperature_C[row] + before.heat_K + ZERO_CELSIUS_K
        position = state.soc * (n - 1)
        k = int(min(max(position, 0.0), n - 2.0))
        f = min(max(position - k, -BEYOND * (n - 1)), 1.0 + BEYOND * (n - 1))
        g = min(max(f, 0.0), 1.0)
        inside = 1.0 if f == g else 0.0
        beyond = 1.0 if f == position - k else 0.0
        lo = 0
        up = 0
        w = 0.0
        span = 1.0
        warmer = 0.0
        if table.shape[0] > 1:
            warm = kelvin - ZERO_CELSIUS_K
            while lo < grid.size - 2 and warm > grid[lo + 1]:
                lo += 1
            up = lo + 1
            span = grid[up] - grid[lo]
            w = (warm - grid[lo]) / span
            warmer = 1.0 if 0.0 < w < 1.0 else 0.0
            w = min(max(w, 0.0), 1.0)
        for c in range(COLUMNS):
            here = f if c == OCV else g
            value[c], slope, rise = _between(table, lo, up, k, here, w, c)
            by_soc[c] = slope * (n - 1) * (beyond if c == OCV else inside)
            by_kelvin[c] = rise / span * warmer
        by_arrhenius = 1.0 / kelvin - 1.0 / cell.reference_K
        arrhenius = math.exp(cell.activation_K * by_arrhenius)
        fall = 1.0 / (1.0 + cell.rate_per_A * abs(current))
        on_charge = 1.0 if current < 0.0 else 0.0
        charged = cell.charge_scale if current < 0.0 else 1.0
        sign = math.copysign(1.0, current)
        efficiency = 1.0 if current > 0.0 else cell.charge_efficiency
        for j in range(4):
            column = R0 if j == 0 else (R1 if j == 1 else (R2 if j == 2 else R3))
            resistance[j] = value[column] * arrhenius * charged * (fall if j < 3 else 1.0)
        tau[1] = value[TAU1]
        tau[2] = value[TAU2]
        tau[3] = value[TAU3]
        a1 = math.exp(-dt / tau[1])
        a2 = math.exp(-dt / tau[2])
        a3 = math.exp(-dt / tau[3])
        left = 1.0
        if cell.hysteresis_rate != 0.0:
            left = math.exp(-cell.hysteresis_rate * abs(current) * dt / cell.charge_As)
        lost = (resistance[0] * current + state.v1_V) + (state.v2_V + state.v3_V)
        cooled = math.exp(-dt / cell.heating_s)
        used = current * efficiency + cell.leak_A
        for p in range(directions):
            flow = currents[current_of[p], row] if current_of[p] >= 0 else 0.0
            d_charge = scalars[p, D_LN_CHARGE]
            s = x[p, S_SOC] - (flow * efficiency + scalars[p, D_LEAK]) * dt / cell.charge_As
            s += used * dt / cell.charge_As * d_charge
            heat = x[p, S_HEAT]
            for c in range(COLUMNS):
                change[c] = by_soc[c] * s + by_kelvin[c] * heat
            if table_of[p] >= 0:
                moved = tables[table_of[p]]
                for c in range(COLUMNS):
                    if c != ERROR:
                        here = f if c == OCV else g
                        added, _, _ = _between(moved, lo, up, k, here, w, c)
                        change[c] += added
            d_arrhenius = scalars[p, D_ACTIVATION] * by_arrhenius
            d_arrhenius -= cell.activation_K / (kelvin * kelvin) * heat
            d_charged = d_arrhenius + on_charge * scalars[p, D_LN_CHARGE_SCALE]
            d_fall = -fall * (scalars[p, D_RATE] * abs(current) + cell.rate_per_A * sign * flow)
            factor = arrhenius * charged
            r0 = change[R0] * factor * fall + resistance[0] * (d_charged + d_fall)
            r1 = change[R1] * factor * fall + resistance[1] * (d_charged + d_fall)
            r2 = change[R2] * factor * fall + resistance[2] * (d_charged + d_fall)
            r3 = change[R3] * factor + resistance[3] * d_charged
            v1 = a1 * x[p, S_V1] + (1.0 - a1) * (r1 * current + resistance[1] * flow)
            v1 += (
                a1 * dt / (tau[1] * tau[1]) * change[TAU1] * (before.v1_V - resistance[1] * current)
            )
            v2 = a2 * x[p, S_V2] + (1.0 - a2) * (r2 * current + resistance[2] * flow)
            v2 += (
                a2 * dt / (tau[2] * tau[2]) * change[TAU2] * (before.v2_V - resistance[2] * current)
            )
            v3 = 0.0
            if resistance[3] != 0.0 or r3 != 0.0:
                v3 = a3 * x[p, S_V3] + (1.0 - a3) * (r3 * current + resistance[3] * flow)
                v3 += (
                    a3
                    * dt
                    / (tau[3] * tau[3])
                    * change[TAU3]
                    * (before.v3_V - resistance[3] * current)
                )
            elif x[p, S_V3] != 0.0:
                v3 = a3 * x[p, S_V3]
            h = left * x[p, S_H]
            if cell.hysteresis_rate != 0.0:
                size = abs(current) * (scalars[p, D_LN_HYSTERESIS] - d_charge) + sign * flow
                d_rate = cell.hysteresis_rate * size * dt / cell.charge_As
                h -= left * (before.h + sign) * d_rate
            voltage = change[OCV] - r0 * current - resistance[0] * flow - (v1 + v2 + v3)
            voltage += change[M] * state.h + value[M] * h + scalars[p, D_VOLTAGE]
            warmer_by = cooled * heat
            if cell.heating_K_per_W != 0.0 or scalars[p, D_HEATING] != 0.0:
                d_lost = (r0 * current + resistance[0] * flow) + (v1 + v2 + v3)
                power = current * lost
                d_power = flow * lost + current * d_lost
                warmer_by += (1.0 - cooled) * (
                    scalars[p, D_HEATING] * power + cell.heating_K_per_W * d_power
                )
                warmer_by += (
                    cooled
                    * dt
                    / cell.heating_s
                    * scalars[p, D_LN_HEATING_S]
                    * (before.heat_K - cell.heating_K_per_W * power)
                )
            x[p, S_SOC] = s
            x[p, S_V1] = v1
            x[p, S_V2] = v2
            x[p, S_V3] = v3
            x[p, S_H] = h
            x[p, S_HEAT] = warmer_by
            if row % stride == 0:
                jacobian[out, p] = voltage
        if row % stride == 0:
            out += 1
