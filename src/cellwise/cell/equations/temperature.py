"""What temperature does to the tables, and where the cell's own heat goes."""

from __future__ import annotations

from typing import Any

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES
from cellwise.cell.equations.exponential import exponential
from cellwise.cell.equations.records import CellTables
from cellwise.cell.equations.states import decay
from cellwise.cell.point_kernels import CellPoint, CellScalars
from cellwise.cell.unrolled import ByState, unrolled

ZERO_CELSIUS_K = 273.15


@inline
def inverse_kelvin(temperature_C: float, reference_K: float) -> float:
    """How far a temperature is from the reference, 1/T - 1/T_ref [1/K]."""
    kelvin = temperature_C + ZERO_CELSIUS_K
    return 1.0 / kelvin - 1.0 / reference_K


@inline
def thermal_factor(activation_K: float, inverse_K: float) -> float:
    """Arrhenius factor at ``inverse_K`` = 1/T - 1/T_ref."""
    return exponential(activation_K * inverse_K)


@inline
def arrhenius(temperature_C: float, activation_K: float, reference_K: float) -> float:
    r"""Arrhenius factor, 1 at the reference.

    .. math:: e^{E (1/T - 1/T_{ref})}
    """
    return thermal_factor(activation_K, inverse_kelvin(temperature_C, reference_K))


@inline
@unrolled
def at_temperature(cell: ByState, point: ByState, temperature_C: float) -> CellPoint:
    r"""What temperature does to the tables beside their own axis.

    .. math:: OCV(T) = OCV + \frac{dOCV}{dT} (T - T_{ref}), \qquad
       R_j(T) = R_j e^{(E + E_j)(1/T - 1/T_{ref})}, \qquad
       \tau_j(T) = \tau_j e^{E_{\tau j} (1/T - 1/T_{ref})}
    """
    ocv = point.ocv_V
    slope = point.ocv_slope_V
    r0 = point.r0_ohm
    r: dict[Any, float] = {}
    tau: dict[Any, float] = {}
    for i in BRANCHES:
        r[i] = point.r[i]
        tau[i] = point.tau[i]
    if cell.entropy_K != 0.0:
        warmer = (temperature_C + ZERO_CELSIUS_K) - cell.entropy_K
        ocv += point.entropy_V * warmer
        slope += point.entropy_slope_V * warmer
    if cell.activation_K != 0.0:
        scale = arrhenius(temperature_C, cell.activation_K, cell.reference_K)
        r0 *= scale
        for i in BRANCHES:
            r[i] *= scale
    if cell.branch_activation != 0.0:
        r0 *= arrhenius(temperature_C, cell.r0_activation_K, cell.reference_K)
        for i in BRANCHES:
            r[i] *= arrhenius(temperature_C, cell.r_activation[i], cell.reference_K)
            tau[i] *= arrhenius(temperature_C, cell.tau_activation[i], cell.reference_K)
    # fmt: off
    return CellPoint(  # type: ignore[call-arg]
        ocv, slope, r0, *(r[i] for i in BRANCHES), *(tau[i] for i in BRANCHES),
        point.m_V, point.error_V, point.entropy_V, point.entropy_slope_V,
    )


@inline
def needs_temperature(tables: CellTables) -> bool:
    """Whether anything depends on the temperature."""
    cell = tables.cell
    depends = cell.activation_K != 0.0 or cell.branch_activation != 0.0 or cell.entropy_K != 0.0
    depends = depends or (cell.surface_per_A != 0.0 and cell.surface_activation_K != 0.0)
    return tables.table.shape[0] > 1 or depends


@inline
def heat_step(
    cell: CellScalars, heat_K: float, current_A: float, polarisation_V: float, dt_s: float
) -> float:
    r"""Temperature of the cell above what is measured, after an interval.

    .. math:: \vartheta^{+} = b \vartheta + R_{th} P (1 - b), \quad b = e^{-\Delta t/\tau_{th}},
       \quad P = I (R_0 I + V_1 + V_2 + V_3)
    """
    if cell.heating_K_per_W == 0.0:
        return heat_K
    b = decay(dt_s, cell.heating_s)
    return b * heat_K + cell.heating_K_per_W * (1.0 - b) * (current_A * polarisation_V)
