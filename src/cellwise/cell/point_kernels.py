"""Parameters of a cell as the kernels see them, and a row of its tables.

A parameter of a new effect is a field here, with where it comes from: a field of `CellModel`, or
``effect.parameter``. ``cell/model.py`` packs them by that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import inline
from cellwise.typing import FloatArray

# Columns of the packed table.
(OCV, R0, R1, TAU1, R2, TAU2, R3, TAU3, M, ERROR, ENTROPY) = range(11)
COLUMN_SOURCES = {
    "ocv_V": "ocv_V",
    "r0_ohm": "r0_ohm",
    "r1_ohm": "r1_ohm",
    "tau1_s": "tau1_s",
    "r2_ohm": "r2_ohm",
    "tau2_s": "tau2_s",
    "r3_ohm": "slow_diffusion.r3_ohm",
    "tau3_s": "slow_diffusion.tau3_s",
    "m_V": "hysteresis.m_V",
    "error_V": "error",
    "entropy_V": "entropy.docv_dT_V_per_K",
}
COLUMNS = len(COLUMN_SOURCES)
SCALAR_SOURCES = {
    "charge_As": "capacity_Ah",
    "charge_efficiency": "charge_efficiency",
    "activation_K": "temperature_dependence.activation_K",
    "reference_K": "temperature_dependence.reference_C",
    "hysteresis_rate": "hysteresis.gamma",
    "skew_s": "time_skew.skew_s",
    "rate_per_A": "rate_dependence.rate_h",
    "charge_scale": "charge_asymmetry.charge_scale",
    "leak_A": "self_discharge.leak_A",
    "heating_K_per_W": "self_heating.rth_K_per_W",
    "heating_s": "self_heating.thermal_s",
    "branch_activation": "temperature_dependence.r0_K",
    "r0_activation_K": "temperature_dependence.r0_K",
    "r1_activation_K": "temperature_dependence.r1_K",
    "tau1_activation_K": "temperature_dependence.tau1_K",
    "r2_activation_K": "temperature_dependence.r2_K",
    "tau2_activation_K": "temperature_dependence.tau2_K",
    "r3_activation_K": "temperature_dependence.r3_K",
    "tau3_activation_K": "temperature_dependence.tau3_K",
    "asinh_per_V": "charge_transfer.asinh_per_V",
    "surface_per_A": "surface_soc.depth_h",
    "surface_s": "surface_soc.tau_s",
    "surface_activation_K": "surface_soc.activation_K",
    "surface_reference_K": "surface_soc.reference_C",
    "entropy_K": "entropy.reference_C",
}


class CellScalars(NamedTuple):
    """What a `CellModel` says beside its tables."""

    charge_As: float  # charge between SOC 1 and SOC 0
    charge_efficiency: float  # share of the charge put in that stays
    activation_K: float  # of every resistance
    reference_K: float  # where the tables hold
    hysteresis_rate: float  # e-folds of h per full charge
    skew_s: float  # sampling delay of the voltage after the current
    rate_per_A: float  # fall of R0, R1, R2 with the current
    charge_scale: float  # factor on resistances on charge
    leak_A: float  # self-discharge current
    heating_K_per_W: float  # thermal resistance to the surface
    heating_s: float  # thermal time constant
    branch_activation: float  # 1 where one is not 0
    r0_activation_K: float  # of R0 beside the common one
    r1_activation_K: float  # of R1 beside the common one
    tau1_activation_K: float  # of tau1
    r2_activation_K: float  # of R2 beside the common one
    tau2_activation_K: float  # of tau2
    r3_activation_K: float  # of R3 beside the common one
    tau3_activation_K: float  # of tau3
    asinh_per_V: float  # of the fast branch's charge transfer
    surface_per_A: float  # SOC that the surface is below the mean
    surface_s: float  # time constant of the current that it follows
    surface_activation_K: float  # of that depth
    surface_reference_K: float  # where that depth holds
    entropy_K: float  # where the OCV holds; 0: no entropy term


class CellPoint(NamedTuple):
    """The tables at one SOC and temperature, as the branches come; slopes over SOC."""

    ocv_V: float  # open-circuit voltage
    ocv_slope_V: float
    r0_ohm: float  # ohmic resistance
    r1_ohm: float  # resistance of the fast branch
    r2_ohm: float  # resistance of the second branch
    r3_ohm: float  # resistance of the slow branch
    tau1_s: float  # time constant of the fast branch
    tau2_s: float  # time constant of the second branch
    tau3_s: float  # time constant of the slow branch
    m_V: float  # half the gap between charge and discharge branch
    error_V: float  # the model's slow voltage error
    entropy_V: float  # change of the OCV per kelvin
    entropy_slope_V: float


@inline
def point_of(table: FloatArray, at: np.uint64, k: np.uint64, f: float, g: float) -> CellPoint:
    """Tables of one temperature, at share f (sloped columns) or g of interval k."""
    n = table.shape[1]
    k1 = k + np.uint64(1)
    ocv = table[at, k, OCV] + f * (table[at, k1, OCV] - table[at, k, OCV])
    ocv_slope = (table[at, k1, OCV] - table[at, k, OCV]) * (n - 1)
    r0 = table[at, k, R0] + g * (table[at, k1, R0] - table[at, k, R0])
    r1 = table[at, k, R1] + g * (table[at, k1, R1] - table[at, k, R1])
    tau1 = table[at, k, TAU1] + g * (table[at, k1, TAU1] - table[at, k, TAU1])
    r2 = table[at, k, R2] + g * (table[at, k1, R2] - table[at, k, R2])
    tau2 = table[at, k, TAU2] + g * (table[at, k1, TAU2] - table[at, k, TAU2])
    r3 = table[at, k, R3] + g * (table[at, k1, R3] - table[at, k, R3])
    tau3 = table[at, k, TAU3] + g * (table[at, k1, TAU3] - table[at, k, TAU3])
    m = table[at, k, M] + g * (table[at, k1, M] - table[at, k, M])
    error = table[at, k, ERROR] + g * (table[at, k1, ERROR] - table[at, k, ERROR])
    entropy = table[at, k, ENTROPY] + f * (table[at, k1, ENTROPY] - table[at, k, ENTROPY])
    entropy_slope = (table[at, k1, ENTROPY] - table[at, k, ENTROPY]) * (n - 1)
    return CellPoint(
        ocv, ocv_slope, r0, r1, r2, r3, tau1, tau2, tau3, m, error, entropy, entropy_slope
    )


@inline
def between(low: CellPoint, high: CellPoint, w: float) -> CellPoint:
    """From one temperature's point at w = 0 to the next one's at w = 1."""
    return CellPoint(
        low.ocv_V + w * (high.ocv_V - low.ocv_V),
        low.ocv_slope_V + w * (high.ocv_slope_V - low.ocv_slope_V),
        low.r0_ohm + w * (high.r0_ohm - low.r0_ohm),
        low.r1_ohm + w * (high.r1_ohm - low.r1_ohm),
        low.r2_ohm + w * (high.r2_ohm - low.r2_ohm),
        low.r3_ohm + w * (high.r3_ohm - low.r3_ohm),
        low.tau1_s + w * (high.tau1_s - low.tau1_s),
        low.tau2_s + w * (high.tau2_s - low.tau2_s),
        low.tau3_s + w * (high.tau3_s - low.tau3_s),
        low.m_V + w * (high.m_V - low.m_V),
        low.error_V + w * (high.error_V - low.error_V),
        low.entropy_V + w * (high.entropy_V - low.entropy_V),
        low.entropy_slope_V + w * (high.entropy_slope_V - low.entropy_slope_V),
    )
