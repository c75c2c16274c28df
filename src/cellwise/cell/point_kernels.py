"""Parameters of a cell as the kernels see them, and a row of its tables.

A parameter of a new effect is a field here, with where it comes from: a field of `CellModel`, or
``effect.parameter``. ``cell/model.py`` packs them by that.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple, get_type_hints

import numpy as np

from cellwise.cell.compiled import inline
from cellwise.typing import FloatArray


class CellScalars(NamedTuple):
    """What a `CellModel` says beside its tables, and of what parameter."""

    charge_As: Annotated[float, "capacity_Ah"]  # charge between SOC 1 and SOC 0
    charge_efficiency: Annotated[float, "charge_efficiency"]  # of what is put in
    activation_K: Annotated[float, "temperature_dependence.activation_K"]  # of every resistance
    reference_K: Annotated[float, "temperature_dependence.reference_C"]  # where the tables hold
    hysteresis_rate: Annotated[float, "hysteresis.gamma"]  # e-folds of h per full charge
    skew_s: Annotated[float, "time_skew.skew_s"]  # sampling delay of the voltage after the current
    rate_per_A: Annotated[float, "rate_dependence.rate_h"]  # fall of R0, R1, R2 with the current
    charge_scale: Annotated[float, "charge_asymmetry.charge_scale"]  # on resistances on charge
    leak_A: Annotated[float, "self_discharge.leak_A"]  # self-discharge current
    heating_K_per_W: Annotated[float, "self_heating.rth_K_per_W"]  # to the surface
    heating_s: Annotated[float, "self_heating.thermal_s"]  # thermal time constant
    branch_activation: Annotated[float, "temperature_dependence.r0_K"]  # 1 where one is not 0
    r0_activation_K: Annotated[float, "temperature_dependence.r0_K"]  # of R0 beside the common one
    r1_activation_K: Annotated[float, "temperature_dependence.r1_K"]  # of R1 beside the common one
    tau1_activation_K: Annotated[float, "temperature_dependence.tau1_K"]  # of tau1
    r2_activation_K: Annotated[float, "temperature_dependence.r2_K"]  # of R2 beside the common one
    tau2_activation_K: Annotated[float, "temperature_dependence.tau2_K"]  # of tau2
    r3_activation_K: Annotated[float, "temperature_dependence.r3_K"]  # of R3 beside the common one
    tau3_activation_K: Annotated[float, "temperature_dependence.tau3_K"]  # of tau3
    asinh_per_V: Annotated[float, "charge_transfer.asinh_per_V"]  # of the fast branch
    surface_per_A: Annotated[float, "surface_soc.depth_h"]  # SOC that the surface is below the mean
    surface_s: Annotated[float, "surface_soc.tau_s"]  # time constant of the current that it follows
    surface_activation_K: Annotated[float, "surface_soc.activation_K"]  # of that depth
    surface_reference_K: Annotated[float, "surface_soc.reference_C"]  # where that depth holds
    entropy_K: Annotated[float, "entropy.reference_C"]  # where the OCV holds; 0: no entropy term


class CellPoint(NamedTuple):
    """The tables at one SOC and temperature, and of what parameter each is; slopes over SOC."""

    ocv_V: Annotated[float, "ocv_V"]  # open-circuit voltage
    ocv_slope_V: float
    r0_ohm: Annotated[float, "r0_ohm"]  # ohmic resistance
    r1_ohm: Annotated[float, "r1_ohm"]  # resistance of the fast branch
    r2_ohm: Annotated[float, "r2_ohm"]  # resistance of the second branch
    r3_ohm: Annotated[float, "slow_diffusion.r3_ohm"]  # resistance of the slow branch
    tau1_s: Annotated[float, "tau1_s"]  # time constant of the fast branch
    tau2_s: Annotated[float, "tau2_s"]  # time constant of the second branch
    tau3_s: Annotated[float, "slow_diffusion.tau3_s"]  # time constant of the slow branch
    m_V: Annotated[float, "hysteresis.m_V"]  # half the gap between charge and discharge branch
    error_V: Annotated[float, "error"]  # the model's slow voltage error
    entropy_V: Annotated[float, "entropy.docv_dT_V_per_K"]  # change of the OCV per kelvin
    entropy_slope_V: float


def _sources(kind: type) -> dict[str, str]:
    """Where the numbers of a record come from, by their names."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: x.__metadata__[0] for name, x in hints.items() if hasattr(x, "__metadata__")}


SCALAR_SOURCES = _sources(CellScalars)
COLUMN_SOURCES = _sources(CellPoint)  # the columns of the packed table
COLUMNS = len(COLUMN_SOURCES)
(OCV, R0, R1, R2, R3, TAU1, TAU2, TAU3, M, ERROR, ENTROPY) = range(COLUMNS)


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
