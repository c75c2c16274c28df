"""Derivatives of single equations of :mod:`cellwise.cell.equations`, for the joint fit.

It knows the SOC and has splines for tables, so it goes through the equations one by one and carries
derivatives with respect to its own coefficients.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.point_kernels import CellScalars


class SeenPartials(NamedTuple):
    """Of the current that the voltage has seen."""

    seen_by_skew_s: float


@inline
def seen_partials(
    cell: CellScalars, current_A: float, previous_A: float, dt_s: float
) -> SeenPartials:
    """Of the current that the voltage has seen."""
    # chain rule, from the last line to the first
    seen_by_w = 0.0 if dt_s <= 0.0 else previous_A - current_A
    seen_by_skew_s = seen_by_w * (1.0 / dt_s if cell.skew_s / dt_s < 1.0 else 0.0)
    return SeenPartials(seen_by_skew_s)


class ThermalPartials(NamedTuple):
    """Of an Arrhenius factor."""

    factor_by_activation_K: float


@inline
def thermal_partials(activation_K: float, inverse_K: float) -> ThermalPartials:
    """Of an Arrhenius factor."""
    # thermal_factor
    factor = math.exp(activation_K * inverse_K) if activation_K != 0.0 else 1.0
    # chain rule, from the last line to the first
    factor_by_activation_K = factor * inverse_K
    return ThermalPartials(factor_by_activation_K)


class TransferPartials(NamedTuple):
    """Of the resistance of a charge transfer."""

    new_by_r_ohm: float
    new_by_asinh_per_V: float
    new_by_current_A: float


@inline
def transfer_partials(asinh_per_V: float, r_ohm: float, current_A: float) -> TransferPartials:
    """Of the resistance of a charge transfer."""
    # charge_transfer
    overvoltage = asinh_per_V * r_ohm * current_A
    y = abs(overvoltage)
    above = 0.42143288 + y * 0.01126451
    above_2 = 0.66171232 + y * above
    above_3 = 1.0 + y * above_2
    below = 0.11957555 + y * 0.00170013
    below_2 = 0.59291773 + y * below
    below_3 = 0.66171232 + y * below_2
    below_4 = 1.0 + y * below_3
    charge_transfer = above_3 / below_4
    # chain rule, from the last line to the first
    new_by_below_4 = -(charge_transfer / below_4 * r_ohm)
    new_by_below_3 = new_by_below_4 * y
    new_by_below_2 = new_by_below_3 * y
    new_by_below = new_by_below_2 * y
    new_by_above_3 = r_ohm * (1.0 / below_4)
    new_by_above_2 = new_by_above_3 * y
    new_by_above = new_by_above_2 * y
    new_by_y = (
        new_by_below_4 * below_3
        + new_by_below_3 * below_2
        + new_by_below_2 * below
        + new_by_below * 0.00170013
        + new_by_above_3 * above_2
        + new_by_above_2 * above
        + new_by_above * 0.01126451
    )
    new_by_overvoltage = new_by_y * math.copysign(1.0, overvoltage)
    new_by_r_ohm = charge_transfer + new_by_overvoltage * (asinh_per_V * current_A)
    new_by_asinh_per_V = new_by_overvoltage * (r_ohm * current_A)
    new_by_current_A = new_by_overvoltage * (asinh_per_V * r_ohm)
    return TransferPartials(new_by_r_ohm, new_by_asinh_per_V, new_by_current_A)


class BranchPartials(NamedTuple):
    """Of a branch's voltage after an interval."""

    new_by_v_V: float
    new_by_current_A: float
    new_by_r_ohm: float
    new_by_tau_s: float


@inline
def branch_partials(
    v_V: float, current_A: float, r_ohm: float, tau_s: float, dt_s: float
) -> BranchPartials:
    """Of a branch's voltage after an interval."""
    # rc_step
    a = math.exp(-dt_s / tau_s)
    # branch_gain
    branch_gain = r_ohm * (1.0 - a)
    # chain rule, from the last line to the first
    new_by_a = v_V - r_ohm * current_A
    new_by_r_ohm = current_A * (1.0 - a)
    new_by_tau_s = -(-dt_s / tau_s / tau_s * a * new_by_a)
    return BranchPartials(a, branch_gain, new_by_r_ohm, new_by_tau_s)


class HysteresisPartials(NamedTuple):
    """Of the hysteresis state after an interval."""

    new_by_h: float
    new_by_hysteresis_rate: float
    new_by_current_A: float


@inline
def hysteresis_partials(
    cell: CellScalars, h: float, current_A: float, dt_s: float
) -> HysteresisPartials:
    """Of the hysteresis state after an interval."""
    # hysteresis_decay
    per_A = dt_s / cell.charge_As
    folds = -cell.hysteresis_rate * abs(current_A) * per_A
    ah = math.exp(folds)
    # chain rule, from the last line to the first
    new_by_ah = h + math.copysign(1.0, current_A)
    new_by_folds = new_by_ah * ah
    new_by_hysteresis_rate = -(abs(current_A) * per_A * new_by_folds)
    new_by_current_A = -(
        cell.hysteresis_rate * math.copysign(1.0, current_A) * per_A * new_by_folds
    )
    return HysteresisPartials(ah, new_by_hysteresis_rate, new_by_current_A)


class VoltagePartials(NamedTuple):
    """Of the terminal voltage."""

    voltage_by_ocv_V: float
    voltage_by_m_V: float
    voltage_by_h: float
    voltage_by_r0_ohm: float
    voltage_by_current_A: float
    voltage_by_v1_V: float
    voltage_by_v2_V: float
    voltage_by_v3_V: float


@inline
def voltage_partials(
    ocv_V: float,
    m_V: float,
    h: float,
    r0_ohm: float,
    current_A: float,
    v1_V: float,
    v2_V: float,
    v3_V: float,
) -> VoltagePartials:
    """Of the terminal voltage."""
    return VoltagePartials(1.0, h, m_V, -current_A, -r0_ohm, -1.0, -1.0, -1.0)
