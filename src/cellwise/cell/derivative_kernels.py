"""Derivatives of the cell's equations over an interval of constant current.

Line by line, and with respect to an effect that is at its neutral value, too.

Printed from :mod:`cellwise.cell.equations` by `python -m cellwise.printing`; do not edit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations import ZERO_CELSIUS_K, CellState
from cellwise.cell.point_kernels import CellPoint, CellScalars


class Partials(NamedTuple):
    """How states and voltage follow what the interval began with."""

    soc_by_charge_As: float
    soc_by_leak_A: float
    soc_by_current_A: float
    soc_by_charge_efficiency: float
    slow_by_old_slow_A: float
    slow_by_current_A: float
    slow_by_surface_s: float
    v1_by_old_v1_V: float
    v1_by_current_A: float
    v1_by_asinh_per_V: float
    v1_by_charge_scale: float
    v1_by_rate_per_A: float
    v1_by_tau1_activation_K: float
    v1_by_r1_activation_K: float
    v1_by_activation_K: float
    v1_by_reference_K: float
    v1_by_old_heat_K: float
    v1_by_r1_ohm: float
    v1_by_tau1_s: float
    v1_by_soc: float
    v1_by_slow: float
    v1_by_surface_per_A: float
    v1_by_surface_activation_K: float
    v1_by_surface_reference_K: float
    v2_by_old_v2_V: float
    v2_by_current_A: float
    v2_by_charge_scale: float
    v2_by_rate_per_A: float
    v2_by_tau2_activation_K: float
    v2_by_r2_activation_K: float
    v2_by_activation_K: float
    v2_by_reference_K: float
    v2_by_old_heat_K: float
    v2_by_r2_ohm: float
    v2_by_tau2_s: float
    v2_by_soc: float
    v2_by_slow: float
    v2_by_surface_per_A: float
    v2_by_surface_activation_K: float
    v2_by_surface_reference_K: float
    v3_by_old_v3_V: float
    v3_by_current_A: float
    v3_by_charge_scale: float
    v3_by_tau3_activation_K: float
    v3_by_r3_activation_K: float
    v3_by_activation_K: float
    v3_by_reference_K: float
    v3_by_old_heat_K: float
    v3_by_r3_ohm: float
    v3_by_tau3_s: float
    v3_by_soc: float
    v3_by_slow: float
    v3_by_surface_per_A: float
    v3_by_surface_activation_K: float
    v3_by_surface_reference_K: float
    h_by_old_h: float
    h_by_hysteresis_rate: float
    h_by_current_A: float
    h_by_charge_As: float
    drop_by_current_A: float
    drop_by_charge_scale: float
    drop_by_rate_per_A: float
    drop_by_r0_activation_K: float
    drop_by_activation_K: float
    drop_by_reference_K: float
    drop_by_old_heat_K: float
    drop_by_r0_ohm: float
    drop_by_soc: float
    drop_by_slow: float
    drop_by_surface_per_A: float
    drop_by_surface_activation_K: float
    drop_by_surface_reference_K: float
    heat_by_old_heat_K: float
    heat_by_heating_K_per_W: float
    heat_by_current_A: float
    heat_by_drop: float
    heat_by_heating_s: float
    voltage_by_h: float
    voltage_by_entropy_K: float
    voltage_by_old_heat_K: float
    voltage_by_soc: float
    voltage_by_m_V: float
    voltage_by_entropy_V: float


@inline
def partials(
    cell: CellScalars,
    state: CellState,
    current_A: float,
    dt_s: float,
    temperature_C: float,
    table: CellPoint,
    by_soc: CellPoint,
    by_kelvin: CellPoint,
    surface_counts: bool,
) -> Partials:
    """Derivatives; ``table`` at the new SOC under no load, and its slopes.

    Where not ``surface_counts`` nothing of the surface's SOC counts, nor is it right.
    """
    # charge_used
    used = current_A if current_A > 0.0 else current_A * cell.charge_efficiency
    charge_used = used + cell.leak_A
    # followed
    a = math.exp(-dt_s / cell.surface_s) if surface_counts else 0.0
    # advance
    slow = a * state.slow_A + (1.0 - a) * current_A
    cell_C = temperature_C + state.heat_K
    # inverse_kelvin
    kelvin = cell_C + ZERO_CELSIUS_K
    inverse_kelvin = 1.0 / kelvin - 1.0 / cell.surface_reference_K
    # surface_soc
    scale = math.exp(cell.surface_activation_K * inverse_kelvin) if surface_counts else 0.0
    depth = cell.surface_per_A * scale
    # at_temperature
    warmer = cell_C + ZERO_CELSIUS_K - cell.entropy_K
    # inverse_kelvin
    inverse_kelvin_2 = 1.0 / kelvin - 1.0 / cell.reference_K
    # at_temperature
    scale_2 = math.exp(cell.activation_K * inverse_kelvin_2) if cell.activation_K != 0.0 else 1.0
    r0 = table.r0_ohm * scale_2
    r1 = table.r1_ohm * scale_2
    r2 = table.r2_ohm * scale_2
    r3 = table.r3_ohm * scale_2
    r0_factor = (
        math.exp(cell.r0_activation_K * inverse_kelvin_2) if cell.r0_activation_K != 0.0 else 1.0
    )
    r0_2 = r0 * r0_factor
    r1_factor = (
        math.exp(cell.r1_activation_K * inverse_kelvin_2) if cell.r1_activation_K != 0.0 else 1.0
    )
    r1_2 = r1 * r1_factor
    tau1_factor = (
        math.exp(cell.tau1_activation_K * inverse_kelvin_2)
        if cell.tau1_activation_K != 0.0
        else 1.0
    )
    tau1 = table.tau1_s * tau1_factor
    r2_factor = (
        math.exp(cell.r2_activation_K * inverse_kelvin_2) if cell.r2_activation_K != 0.0 else 1.0
    )
    r2_2 = r2 * r2_factor
    tau2_factor = (
        math.exp(cell.tau2_activation_K * inverse_kelvin_2)
        if cell.tau2_activation_K != 0.0
        else 1.0
    )
    tau2 = table.tau2_s * tau2_factor
    r3_factor = (
        math.exp(cell.r3_activation_K * inverse_kelvin_2) if cell.r3_activation_K != 0.0 else 1.0
    )
    r3_2 = r3 * r3_factor
    tau3_factor = (
        math.exp(cell.tau3_activation_K * inverse_kelvin_2)
        if cell.tau3_activation_K != 0.0
        else 1.0
    )
    tau3 = table.tau3_s * tau3_factor
    # under_load
    growth = 1.0 + cell.rate_per_A * abs(current_A)
    fall = 1.0 / growth
    r0_3 = r0_2 * fall
    r1_3 = r1_2 * fall
    r2_3 = r2_2 * fall
    r0_4 = r0_3 * cell.charge_scale if current_A < 0.0 else r0_3
    r1_4 = r1_3 * cell.charge_scale if current_A < 0.0 else r1_3
    r2_4 = r2_3 * cell.charge_scale if current_A < 0.0 else r2_3
    r3_3 = r3_2 * cell.charge_scale if current_A < 0.0 else r3_2
    # charge_transfer
    overvoltage = cell.asinh_per_V * r1_4 * current_A
    y = abs(overvoltage)
    above = 0.42143288 + y * 0.01126451
    above_2 = 0.66171232 + y * above
    above_3 = 1.0 + y * above_2
    below = 0.11957555 + y * 0.00170013
    below_2 = 0.59291773 + y * below
    below_3 = 0.66171232 + y * below_2
    below_4 = 1.0 + y * below_3
    charge_transfer = above_3 / below_4
    # under_load
    r1_5 = r1_4 * charge_transfer
    # transition
    a1 = math.exp(-dt_s / tau1)
    a2 = math.exp(-dt_s / tau2)
    a3 = math.exp(-dt_s / tau3)
    # hysteresis_decay
    per_A = dt_s / cell.charge_As
    folds = -cell.hysteresis_rate * abs(current_A) * per_A
    # transition
    ah = math.exp(folds)
    # advance
    g1 = r1_5 * (1.0 - a1)
    g2 = r2_4 * (1.0 - a2)
    g3 = r3_3 * (1.0 - a3)
    # states_step
    v1 = a1 * state.v1_V + g1 * current_A
    v2 = a2 * state.v2_V + g2 * current_A
    v3 = a3 * state.v3_V + g3 * current_A
    h = ah * state.h - (1.0 - ah) * math.copysign(1.0, current_A)
    # advance
    drop = r0_4 * current_A + v1 + (v2 + v3)
    # heat_step
    b = math.exp(-dt_s / cell.heating_s)
    # chain rule, from the last line to the first
    heat_by_b = state.heat_K - cell.heating_K_per_W * (current_A * drop)
    h_by_ah = state.h + math.copysign(1.0, current_A)
    h_by_folds = h_by_ah * ah
    h_by_per_A = h_by_folds * (-cell.hysteresis_rate * abs(current_A))
    v3_by_a3 = state.v3_V - r3_3 * current_A
    v2_by_a2 = state.v2_V - r2_4 * current_A
    v1_by_a1 = state.v1_V - r1_5 * current_A
    v1_by_r1_5 = current_A * (1.0 - a1)
    v1_by_charge_transfer = v1_by_r1_5 * r1_4
    v1_by_below_4 = -(charge_transfer / below_4 * v1_by_charge_transfer)
    v1_by_below_3 = v1_by_below_4 * y
    v1_by_below_2 = v1_by_below_3 * y
    v1_by_below = v1_by_below_2 * y
    v1_by_above_3 = v1_by_charge_transfer * (1.0 / below_4)
    v1_by_above_2 = v1_by_above_3 * y
    v1_by_above = v1_by_above_2 * y
    v1_by_y = (
        v1_by_below_4 * below_3
        + v1_by_below_3 * below_2
        + v1_by_below_2 * below
        + v1_by_below * 0.00170013
        + v1_by_above_3 * above_2
        + v1_by_above_2 * above
        + v1_by_above * 0.01126451
    )
    v1_by_overvoltage = v1_by_y * math.copysign(1.0, overvoltage)
    v3_by_r3_3 = current_A * (1.0 - a3)
    v2_by_r2_4 = current_A * (1.0 - a2)
    v1_by_r1_4 = v1_by_r1_5 * charge_transfer + v1_by_overvoltage * (cell.asinh_per_V * current_A)
    v2_by_r2_3 = v2_by_r2_4 * (cell.charge_scale if current_A < 0.0 else 1.0)
    v1_by_r1_3 = v1_by_r1_4 * (cell.charge_scale if current_A < 0.0 else 1.0)
    drop_by_r0_3 = current_A * (cell.charge_scale if current_A < 0.0 else 1.0)
    fall_by_growth = -(fall / growth)
    v1_by_fall = v1_by_r1_3 * r1_2
    v2_by_fall = v2_by_r2_3 * r2_2
    drop_by_fall = drop_by_r0_3 * r0_2
    growth_by_rate_per_A = abs(current_A)
    growth_by_current_A = cell.rate_per_A * math.copysign(1.0, current_A)
    v1_by_growth = v1_by_fall * fall_by_growth
    v2_by_growth = v2_by_fall * fall_by_growth
    drop_by_growth = drop_by_fall * fall_by_growth
    v3_by_tau3 = -(-dt_s / tau3 / tau3 * a3 * v3_by_a3)
    v3_by_tau3_factor = v3_by_tau3 * table.tau3_s
    v3_by_r3_2 = v3_by_r3_3 * (cell.charge_scale if current_A < 0.0 else 1.0)
    v3_by_r3_factor = v3_by_r3_2 * r3
    v2_by_tau2 = -(-dt_s / tau2 / tau2 * a2 * v2_by_a2)
    v2_by_tau2_factor = v2_by_tau2 * table.tau2_s
    v2_by_r2_2 = v2_by_r2_3 * fall
    v2_by_r2_factor = v2_by_r2_2 * r2
    v1_by_tau1 = -(-dt_s / tau1 / tau1 * a1 * v1_by_a1)
    v1_by_tau1_factor = v1_by_tau1 * table.tau1_s
    v1_by_r1_2 = v1_by_r1_3 * fall
    v1_by_r1_factor = v1_by_r1_2 * r1
    drop_by_r0_2 = drop_by_r0_3 * fall
    drop_by_r0_factor = drop_by_r0_2 * r0
    v3_by_r3 = v3_by_r3_2 * r3_factor
    v2_by_r2 = v2_by_r2_2 * r2_factor
    v1_by_r1 = v1_by_r1_2 * r1_factor
    drop_by_r0 = drop_by_r0_2 * r0_factor
    scale_2_by_activation_K = scale_2 * inverse_kelvin_2
    scale_2_by_inverse_kelvin_2 = scale_2 * cell.activation_K
    v1_by_scale_2 = v1_by_r1 * table.r1_ohm
    v2_by_scale_2 = v2_by_r2 * table.r2_ohm
    v3_by_scale_2 = v3_by_r3 * table.r3_ohm
    drop_by_scale_2 = drop_by_r0 * table.r0_ohm
    inverse_kelvin_2_by_kelvin = -(1.0 / kelvin / kelvin)
    inverse_kelvin_2_by_reference_K = 1.0 / cell.reference_K / cell.reference_K
    v1_by_inverse_kelvin_2 = (
        v1_by_tau1_factor * (tau1_factor * cell.tau1_activation_K)
        + v1_by_r1_factor * (r1_factor * cell.r1_activation_K)
        + v1_by_scale_2 * scale_2_by_inverse_kelvin_2
    )
    v2_by_inverse_kelvin_2 = (
        v2_by_tau2_factor * (tau2_factor * cell.tau2_activation_K)
        + v2_by_r2_factor * (r2_factor * cell.r2_activation_K)
        + v2_by_scale_2 * scale_2_by_inverse_kelvin_2
    )
    v3_by_inverse_kelvin_2 = (
        v3_by_tau3_factor * (tau3_factor * cell.tau3_activation_K)
        + v3_by_r3_factor * (r3_factor * cell.r3_activation_K)
        + v3_by_scale_2 * scale_2_by_inverse_kelvin_2
    )
    drop_by_inverse_kelvin_2 = (
        drop_by_r0_factor * (r0_factor * cell.r0_activation_K)
        + drop_by_scale_2 * scale_2_by_inverse_kelvin_2
    )
    inverse_kelvin_by_kelvin = -(1.0 / kelvin / kelvin)
    v1_by_kelvin = v1_by_inverse_kelvin_2 * inverse_kelvin_2_by_kelvin
    v2_by_kelvin = v2_by_inverse_kelvin_2 * inverse_kelvin_2_by_kelvin
    v3_by_kelvin = v3_by_inverse_kelvin_2 * inverse_kelvin_2_by_kelvin
    drop_by_kelvin = drop_by_inverse_kelvin_2 * inverse_kelvin_2_by_kelvin
    drop_by_r0_ohm = drop_by_r0 * scale_2
    v1_by_r1_ohm = v1_by_r1 * scale_2
    v1_by_tau1_s = v1_by_tau1 * tau1_factor
    v2_by_r2_ohm = v2_by_r2 * scale_2
    v2_by_tau2_s = v2_by_tau2 * tau2_factor
    v3_by_r3_ohm = v3_by_r3 * scale_2
    v3_by_tau3_s = v3_by_tau3 * tau3_factor
    v1_by_surface = v1_by_r1_ohm * by_soc.r1_ohm + v1_by_tau1_s * by_soc.tau1_s
    v2_by_surface = v2_by_r2_ohm * by_soc.r2_ohm + v2_by_tau2_s * by_soc.tau2_s
    v3_by_surface = v3_by_r3_ohm * by_soc.r3_ohm + v3_by_tau3_s * by_soc.tau3_s
    drop_by_surface = drop_by_r0_ohm * by_soc.r0_ohm
    v1_by_depth = -(slow * v1_by_surface)
    v2_by_depth = -(slow * v2_by_surface)
    v3_by_depth = -(slow * v3_by_surface)
    drop_by_depth = -(slow * drop_by_surface)
    scale_by_surface_activation_K = scale * inverse_kelvin
    scale_by_inverse_kelvin = scale * cell.surface_activation_K
    v1_by_scale = v1_by_depth * cell.surface_per_A
    v2_by_scale = v2_by_depth * cell.surface_per_A
    v3_by_scale = v3_by_depth * cell.surface_per_A
    drop_by_scale = drop_by_depth * cell.surface_per_A
    inverse_kelvin_by_surface_reference_K = (
        1.0 / cell.surface_reference_K / cell.surface_reference_K
    )
    v1_by_inverse_kelvin = v1_by_scale * scale_by_inverse_kelvin
    v2_by_inverse_kelvin = v2_by_scale * scale_by_inverse_kelvin
    v3_by_inverse_kelvin = v3_by_scale * scale_by_inverse_kelvin
    drop_by_inverse_kelvin = drop_by_scale * scale_by_inverse_kelvin
    slow_by_a = state.slow_A - current_A
    soc_by_charge_used = -(dt_s / cell.charge_As)
    soc_by_charge_As = dt_s / cell.charge_As / cell.charge_As * charge_used
    soc_by_current_A = soc_by_charge_used * (1.0 if current_A > 0.0 else cell.charge_efficiency)
    soc_by_charge_efficiency = soc_by_charge_used * (0.0 if current_A > 0.0 else current_A)
    slow_by_current_A = 1.0 - a
    slow_by_surface_s = -(-dt_s / cell.surface_s / cell.surface_s * a * slow_by_a)
    v1_by_current_A = (
        g1 + v1_by_overvoltage * (cell.asinh_per_V * r1_4) + v1_by_growth * growth_by_current_A
    )
    v1_by_asinh_per_V = v1_by_overvoltage * (r1_4 * current_A)
    v1_by_charge_scale = v1_by_r1_4 * (r1_3 if current_A < 0.0 else 0.0)
    v1_by_rate_per_A = v1_by_growth * growth_by_rate_per_A
    v1_by_tau1_activation_K = v1_by_tau1_factor * (tau1_factor * inverse_kelvin_2)
    v1_by_r1_activation_K = v1_by_r1_factor * (r1_factor * inverse_kelvin_2)
    v1_by_activation_K = v1_by_scale_2 * scale_2_by_activation_K
    v1_by_reference_K = v1_by_inverse_kelvin_2 * inverse_kelvin_2_by_reference_K
    v1_by_old_heat_K = (
        v1_by_kelvin
        + v1_by_r1_ohm * by_kelvin.r1_ohm
        + v1_by_tau1_s * by_kelvin.tau1_s
        + v1_by_inverse_kelvin * inverse_kelvin_by_kelvin
    )
    v1_by_slow = -(depth * v1_by_surface)
    v1_by_surface_per_A = v1_by_depth * scale
    v1_by_surface_activation_K = v1_by_scale * scale_by_surface_activation_K
    v1_by_surface_reference_K = v1_by_inverse_kelvin * inverse_kelvin_by_surface_reference_K
    v2_by_current_A = g2 + v2_by_growth * growth_by_current_A
    v2_by_charge_scale = v2_by_r2_4 * (r2_3 if current_A < 0.0 else 0.0)
    v2_by_rate_per_A = v2_by_growth * growth_by_rate_per_A
    v2_by_tau2_activation_K = v2_by_tau2_factor * (tau2_factor * inverse_kelvin_2)
    v2_by_r2_activation_K = v2_by_r2_factor * (r2_factor * inverse_kelvin_2)
    v2_by_activation_K = v2_by_scale_2 * scale_2_by_activation_K
    v2_by_reference_K = v2_by_inverse_kelvin_2 * inverse_kelvin_2_by_reference_K
    v2_by_old_heat_K = (
        v2_by_kelvin
        + v2_by_r2_ohm * by_kelvin.r2_ohm
        + v2_by_tau2_s * by_kelvin.tau2_s
        + v2_by_inverse_kelvin * inverse_kelvin_by_kelvin
    )
    v2_by_slow = -(depth * v2_by_surface)
    v2_by_surface_per_A = v2_by_depth * scale
    v2_by_surface_activation_K = v2_by_scale * scale_by_surface_activation_K
    v2_by_surface_reference_K = v2_by_inverse_kelvin * inverse_kelvin_by_surface_reference_K
    v3_by_charge_scale = v3_by_r3_3 * (r3_2 if current_A < 0.0 else 0.0)
    v3_by_tau3_activation_K = v3_by_tau3_factor * (tau3_factor * inverse_kelvin_2)
    v3_by_r3_activation_K = v3_by_r3_factor * (r3_factor * inverse_kelvin_2)
    v3_by_activation_K = v3_by_scale_2 * scale_2_by_activation_K
    v3_by_reference_K = v3_by_inverse_kelvin_2 * inverse_kelvin_2_by_reference_K
    v3_by_old_heat_K = (
        v3_by_kelvin
        + v3_by_r3_ohm * by_kelvin.r3_ohm
        + v3_by_tau3_s * by_kelvin.tau3_s
        + v3_by_inverse_kelvin * inverse_kelvin_by_kelvin
    )
    v3_by_slow = -(depth * v3_by_surface)
    v3_by_surface_per_A = v3_by_depth * scale
    v3_by_surface_activation_K = v3_by_scale * scale_by_surface_activation_K
    v3_by_surface_reference_K = v3_by_inverse_kelvin * inverse_kelvin_by_surface_reference_K
    h_by_hysteresis_rate = -(abs(current_A) * per_A * h_by_folds)
    h_by_current_A = -(cell.hysteresis_rate * math.copysign(1.0, current_A) * per_A * h_by_folds)
    h_by_charge_As = -(per_A / cell.charge_As * h_by_per_A)
    drop_by_current_A = r0_4 + drop_by_growth * growth_by_current_A
    drop_by_charge_scale = current_A * (r0_3 if current_A < 0.0 else 0.0)
    drop_by_rate_per_A = drop_by_growth * growth_by_rate_per_A
    drop_by_r0_activation_K = drop_by_r0_factor * (r0_factor * inverse_kelvin_2)
    drop_by_activation_K = drop_by_scale_2 * scale_2_by_activation_K
    drop_by_reference_K = drop_by_inverse_kelvin_2 * inverse_kelvin_2_by_reference_K
    drop_by_old_heat_K = (
        drop_by_kelvin
        + drop_by_r0_ohm * by_kelvin.r0_ohm
        + drop_by_inverse_kelvin * inverse_kelvin_by_kelvin
    )
    drop_by_slow = -(depth * drop_by_surface)
    drop_by_surface_per_A = drop_by_depth * scale
    drop_by_surface_activation_K = drop_by_scale * scale_by_surface_activation_K
    drop_by_surface_reference_K = drop_by_inverse_kelvin * inverse_kelvin_by_surface_reference_K
    heat_by_heating_K_per_W = (1.0 - b) * (current_A * drop)
    heat_by_current_A = cell.heating_K_per_W * (1.0 - b) * drop
    heat_by_drop = cell.heating_K_per_W * (1.0 - b) * current_A
    heat_by_heating_s = -(-dt_s / cell.heating_s / cell.heating_s * b * heat_by_b)
    voltage_by_old_heat_K = (
        table.entropy_V + by_kelvin.ocv_V + h * by_kelvin.m_V + warmer * by_kelvin.entropy_V
    )
    voltage_by_soc = by_soc.ocv_V + h * by_soc.m_V + warmer * by_soc.entropy_V
    return Partials(
        soc_by_charge_As,
        soc_by_charge_used,
        soc_by_current_A,
        soc_by_charge_efficiency,
        a,
        slow_by_current_A,
        slow_by_surface_s,
        a1,
        v1_by_current_A,
        v1_by_asinh_per_V,
        v1_by_charge_scale,
        v1_by_rate_per_A,
        v1_by_tau1_activation_K,
        v1_by_r1_activation_K,
        v1_by_activation_K,
        v1_by_reference_K,
        v1_by_old_heat_K,
        v1_by_r1_ohm,
        v1_by_tau1_s,
        v1_by_surface,
        v1_by_slow,
        v1_by_surface_per_A,
        v1_by_surface_activation_K,
        v1_by_surface_reference_K,
        a2,
        v2_by_current_A,
        v2_by_charge_scale,
        v2_by_rate_per_A,
        v2_by_tau2_activation_K,
        v2_by_r2_activation_K,
        v2_by_activation_K,
        v2_by_reference_K,
        v2_by_old_heat_K,
        v2_by_r2_ohm,
        v2_by_tau2_s,
        v2_by_surface,
        v2_by_slow,
        v2_by_surface_per_A,
        v2_by_surface_activation_K,
        v2_by_surface_reference_K,
        a3,
        g3,
        v3_by_charge_scale,
        v3_by_tau3_activation_K,
        v3_by_r3_activation_K,
        v3_by_activation_K,
        v3_by_reference_K,
        v3_by_old_heat_K,
        v3_by_r3_ohm,
        v3_by_tau3_s,
        v3_by_surface,
        v3_by_slow,
        v3_by_surface_per_A,
        v3_by_surface_activation_K,
        v3_by_surface_reference_K,
        ah,
        h_by_hysteresis_rate,
        h_by_current_A,
        h_by_charge_As,
        drop_by_current_A,
        drop_by_charge_scale,
        drop_by_rate_per_A,
        drop_by_r0_activation_K,
        drop_by_activation_K,
        drop_by_reference_K,
        drop_by_old_heat_K,
        drop_by_r0_ohm,
        drop_by_surface,
        drop_by_slow,
        drop_by_surface_per_A,
        drop_by_surface_activation_K,
        drop_by_surface_reference_K,
        b,
        heat_by_heating_K_per_W,
        heat_by_current_A,
        heat_by_drop,
        heat_by_heating_s,
        table.m_V,
        -table.entropy_V,
        voltage_by_old_heat_K,
        voltage_by_soc,
        h,
        warmer,
    )


@inline
def carried(
    p: Partials, d: CellState, flow_A: float, at: CellPoint, surface_counts: bool
) -> tuple[CellState, float]:
    """Directions after an interval, of those before it, of the current and the tables."""
    soc = d.soc + p.soc_by_current_A * flow_A
    slow = p.slow_by_old_slow_A * d.slow_A + p.slow_by_current_A * flow_A
    v1 = (
        p.v1_by_old_v1_V * d.v1_V
        + p.v1_by_current_A * flow_A
        + p.v1_by_old_heat_K * d.heat_K
        + p.v1_by_r1_ohm * at.r1_ohm
        + p.v1_by_tau1_s * at.tau1_s
        + p.v1_by_soc * soc
    )
    if surface_counts:
        v1 += p.v1_by_slow * slow
    v2 = (
        p.v2_by_old_v2_V * d.v2_V
        + p.v2_by_current_A * flow_A
        + p.v2_by_old_heat_K * d.heat_K
        + p.v2_by_r2_ohm * at.r2_ohm
        + p.v2_by_tau2_s * at.tau2_s
        + p.v2_by_soc * soc
    )
    if surface_counts:
        v2 += p.v2_by_slow * slow
    v3 = (
        p.v3_by_old_v3_V * d.v3_V
        + p.v3_by_current_A * flow_A
        + p.v3_by_old_heat_K * d.heat_K
        + p.v3_by_r3_ohm * at.r3_ohm
        + p.v3_by_tau3_s * at.tau3_s
        + p.v3_by_soc * soc
    )
    if surface_counts:
        v3 += p.v3_by_slow * slow
    h = p.h_by_old_h * d.h + p.h_by_current_A * flow_A
    drop = (
        p.drop_by_current_A * flow_A
        + v1
        + v2
        + v3
        + p.drop_by_old_heat_K * d.heat_K
        + p.drop_by_r0_ohm * at.r0_ohm
        + p.drop_by_soc * soc
    )
    if surface_counts:
        drop += p.drop_by_slow * slow
    heat = p.heat_by_old_heat_K * d.heat_K + p.heat_by_current_A * flow_A + p.heat_by_drop * drop
    voltage = (
        p.voltage_by_h * h
        - drop
        + p.voltage_by_old_heat_K * d.heat_K
        + p.voltage_by_soc * soc
        + at.ocv_V
        + p.voltage_by_m_V * at.m_V
        + p.voltage_by_entropy_V * at.entropy_V
    )
    return CellState(soc, v1, v2, v3, h, heat, slow), voltage


@inline
def driven(p: Partials, d: CellScalars, surface_counts: bool) -> tuple[CellState, float]:
    """What the directions of the scalars add to those after the interval."""
    soc = (
        p.soc_by_charge_As * d.charge_As
        + p.soc_by_leak_A * d.leak_A
        + p.soc_by_charge_efficiency * d.charge_efficiency
    )
    slow = p.slow_by_surface_s * d.surface_s
    v1 = (
        p.v1_by_asinh_per_V * d.asinh_per_V
        + p.v1_by_charge_scale * d.charge_scale
        + p.v1_by_rate_per_A * d.rate_per_A
        + p.v1_by_tau1_activation_K * d.tau1_activation_K
        + p.v1_by_r1_activation_K * d.r1_activation_K
        + p.v1_by_activation_K * d.activation_K
        + p.v1_by_reference_K * d.reference_K
        + p.v1_by_soc * soc
    )
    if surface_counts:
        v1 += (
            p.v1_by_slow * slow
            + p.v1_by_surface_per_A * d.surface_per_A
            + p.v1_by_surface_activation_K * d.surface_activation_K
            + p.v1_by_surface_reference_K * d.surface_reference_K
        )
    v2 = (
        p.v2_by_charge_scale * d.charge_scale
        + p.v2_by_rate_per_A * d.rate_per_A
        + p.v2_by_tau2_activation_K * d.tau2_activation_K
        + p.v2_by_r2_activation_K * d.r2_activation_K
        + p.v2_by_activation_K * d.activation_K
        + p.v2_by_reference_K * d.reference_K
        + p.v2_by_soc * soc
    )
    if surface_counts:
        v2 += (
            p.v2_by_slow * slow
            + p.v2_by_surface_per_A * d.surface_per_A
            + p.v2_by_surface_activation_K * d.surface_activation_K
            + p.v2_by_surface_reference_K * d.surface_reference_K
        )
    v3 = (
        p.v3_by_charge_scale * d.charge_scale
        + p.v3_by_tau3_activation_K * d.tau3_activation_K
        + p.v3_by_r3_activation_K * d.r3_activation_K
        + p.v3_by_activation_K * d.activation_K
        + p.v3_by_reference_K * d.reference_K
        + p.v3_by_soc * soc
    )
    if surface_counts:
        v3 += (
            p.v3_by_slow * slow
            + p.v3_by_surface_per_A * d.surface_per_A
            + p.v3_by_surface_activation_K * d.surface_activation_K
            + p.v3_by_surface_reference_K * d.surface_reference_K
        )
    h = p.h_by_hysteresis_rate * d.hysteresis_rate + p.h_by_charge_As * d.charge_As
    drop = (
        v1
        + v2
        + v3
        + p.drop_by_charge_scale * d.charge_scale
        + p.drop_by_rate_per_A * d.rate_per_A
        + p.drop_by_r0_activation_K * d.r0_activation_K
        + p.drop_by_activation_K * d.activation_K
        + p.drop_by_reference_K * d.reference_K
        + p.drop_by_soc * soc
    )
    if surface_counts:
        drop += (
            p.drop_by_slow * slow
            + p.drop_by_surface_per_A * d.surface_per_A
            + p.drop_by_surface_activation_K * d.surface_activation_K
            + p.drop_by_surface_reference_K * d.surface_reference_K
        )
    heat = (
        p.heat_by_heating_K_per_W * d.heating_K_per_W
        + p.heat_by_drop * drop
        + p.heat_by_heating_s * d.heating_s
    )
    voltage = (
        p.voltage_by_h * h - drop + p.voltage_by_entropy_K * d.entropy_K + p.voltage_by_soc * soc
    )
    return CellState(soc, v1, v2, v3, h, heat, slow), voltage
