"""How far a model can be off where its data never were: what widens every filter there.

Beyond a range the error grows with the distance from it. By its causes:

- **temperature**: a resistance follows Arrhenius, with an activation that the data do not show;
  the OCV moves by its temperature coefficient;
- **current**: what a reaction takes off the voltage is no straight line over the current;
- **SOC**: the OCV goes on with a slope that nobody measured.

The numbers are those of lithium-ion cells at large, not of one model.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cellwise.cell.compiled import inline
from cellwise.cell.effects import TemperatureDependence
from cellwise.cell.equations.scalar import distance_beyond, exponential_rise
from cellwise.cell.equations.temperature import ZERO_CELSIUS_K
from cellwise.cell.packed import changed
from cellwise.cell.plausibility.validity import SHARE_AT_TWICE
from cellwise.cell.point_kernels import CellPoint

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel

ROOM_K = 298.15
# Activation of the resistances of lithium-ion cells: 20 to 60 kJ/mol, 30 in the middle.
ACTIVATION_K = 3600.0
# Its error where the model has one of its own, known from few kelvin of warming.
ACTIVATION_STD_K = 1000.0
ENTROPY_V_PER_K = 3e-4  # OCV of lithium-ion cells: up to 0.5 mV/K, either way
# A single cell taken into the cold loses 20 K in about a quarter of an hour.
DRIFT_K_PER_S = 0.02
LARGEST_DRIFT_K = 20.0


class ValidityScalars(NamedTuple):
    """Where a model is valid, tolerance included, and how its error grows beyond."""

    soc_low: float
    soc_high: float
    cold_C: float
    warm_C: float
    charge_A: float
    discharge_A: float
    share_per_K: float
    voltage_per_K: float
    share_per_A: float
    voltage_per_soc: float


EVERYWHERE = ValidityScalars(-np.inf, np.inf, -np.inf, np.inf, -np.inf, np.inf, 0.0, 0.0, 0.0, 0.0)


def validity_scalars(model: CellModel) -> ValidityScalars:
    """What the kernels take of a model's validity; of a model that states none, everywhere."""
    valid = model.validity
    if not valid.known:
        return EVERYWHERE
    bounds = valid.bounds()
    thermal = model.effect(TemperatureDependence)
    activation_K = ACTIVATION_STD_K if thermal.activation_K != 0.0 else ACTIVATION_K
    activation_K = model.error.activation_std_K or activation_K
    coldest_K = ROOM_K if valid.temperature_C is None else valid.temperature_C[0] + ZERO_CELSIUS_K
    # Where nobody measures, the model takes a temperature of its own, which is no news.
    usual_C = model.usual_temperature_C
    return ValidityScalars(
        soc_low=bounds.soc_low,
        soc_high=bounds.soc_high,
        cold_C=min(bounds.cold_C, usual_C),
        warm_C=max(bounds.warm_C, usual_C),
        charge_A=bounds.charge_A,
        discharge_A=bounds.discharge_A,
        share_per_K=activation_K / coldest_K**2,
        voltage_per_K=ENTROPY_V_PER_K,
        share_per_A=SHARE_AT_TWICE / valid.largest_A if valid.largest_A > 0.0 else 0.0,
        voltage_per_soc=model.unknown_slope_V,
    )


@inline
def is_outside(valid: ValidityScalars, soc: float, temperature_C: float, current_A: float) -> bool:
    """Whether SOC, temperature or current is beyond the data."""
    inside = (soc >= valid.soc_low) & (soc <= valid.soc_high)
    inside &= (temperature_C >= valid.cold_C) & (temperature_C <= valid.warm_C)
    inside &= (current_A >= valid.charge_A) & (current_A <= valid.discharge_A)
    return not inside


@inline
def extrapolation_V(
    valid: ValidityScalars, temperature_C: float, current_A: float, held_V: float
) -> float:
    r"""What a model can be off by because of temperature and current, one deviation [V].

    .. math:: \sigma = \left(x + \tfrac{1}{2} x^2 + \tfrac{1}{6} x^3 + s_I \, \Delta I\right) v_p
       + s_{OCV} \, \Delta T, \qquad x = s_T \, \Delta T

    with the distances from the data and the polarisation v_p: what an exponential adds to 1, to
    its third order, because an embedded target has no exponential.

    Parameters
    ----------
    held_V : float      what ohmic drop and branches take off the OCV, in absolute values [V]
    """
    far_K = distance_beyond(temperature_C, valid.cold_C, valid.warm_C)
    far_A = distance_beyond(current_A, valid.charge_A, valid.discharge_A)
    share = exponential_rise(valid.share_per_K * far_K) + valid.share_per_A * far_A
    return share * held_V + valid.voltage_per_K * far_K


@inline
def lost_temperature_V(lost_s: float, held_V: float) -> float:
    """What a model can be off by after ``lost_s`` without a temperature, one deviation [V].

    The cell may have cooled or warmed as fast as a small one does, until it is where it is used.
    """
    away_K = min(DRIFT_K_PER_S * lost_s, LARGEST_DRIFT_K)
    rise = exponential_rise(ACTIVATION_K / ROOM_K**2 * away_K)
    return rise * held_V + ENTROPY_V_PER_K * away_K


@inline
def soc_extrapolation_V(valid: ValidityScalars, soc: float) -> float:
    """What the OCV can be off by beyond the data's SOC, one deviation [V]."""
    return valid.voltage_per_soc * distance_beyond(soc, valid.soc_low, valid.soc_high)


@inline
def widened(point: CellPoint, extrapolation_V: float) -> CellPoint:
    """A point with more of the slow error."""
    slow = point.error_V
    error = (slow * slow + extrapolation_V * extrapolation_V) ** 0.5
    return changed(point, "error_V", error)
