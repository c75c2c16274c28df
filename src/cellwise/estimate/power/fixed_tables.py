"""What the fixed step's state of power and remaining time read beside the step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cellwise.cell.model import CAPACITY_STD, CellModel
from cellwise.errors import InputError
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    from cellwise.estimate.power.state_of_power import PowerSettings

LEAST_LOAD_C = 0.02  # below C/50 nothing flies
LEAST_CUTOFF_V = 0.1
CURRENT_LIMIT_C = 200.0  # no cell gives that; a sensor fault does


def lag(tau_s: FloatArray, over_s: float) -> FloatArray:
    """1 / (1 - exp(-t / tau)): all but linear in tau, so it is interpolated as tau is."""
    return np.asarray(-1.0 / np.expm1(-over_s / tau_s))


def power_constants(model: CellModel, power: PowerSettings, dt_s: float) -> dict[str, Any]:
    """Horizon and limits; a current that nothing limits is as good as endless.

    Raises
    ------
    InputError        several horizons, a power held
    """
    if len(power.horizons_s) != 1 or power.hold != "current":
        raise InputError(
            f"{len(power.horizons_s)} horizons with hold '{power.hold}' for a fixed step",
            "one horizon with hold 'current'",
            "Give one, 10 s, say, and hold='current'.",
        )
    (horizon_s,) = power.horizons_s
    limits = power.known.scalars()
    most_A = CURRENT_LIMIT_C * model.capacity_Ah
    return {
        "power_steps": horizon_s / dt_s,
        "power_low_V": limits.low_V,
        "power_high_V": limits.high_V,
        "power_discharge_A": min(limits.discharge_A, most_A),
        "power_charge_A": min(limits.charge_A, most_A),
        "power_soc_low": limits.low_soc,
        "power_soc_high": limits.high_soc,
    }


def remaining_constants(model: CellModel, cutoff_V: float, dt_s: float) -> dict[str, Any]:
    """What the remaining time reads beside the step's constants.

    Raises
    ------
    InputError        a cutoff that is not below the model's full OCV
    """
    if not LEAST_CUTOFF_V <= cutoff_V < float(np.max(model.ocv_V)):
        raise InputError(
            f"a cutoff of {cutoff_V:g} V",
            f"{LEAST_CUTOFF_V:g} V to the model's full OCV, {float(np.max(model.ocv_V)):.2f} V",
            "Give the voltage of a cell, not of the pack.",
        )
    return {
        "remaining_low_V": cutoff_V,
        "remaining_least_A": LEAST_LOAD_C * model.capacity_Ah,
        "remaining_share": 2.0 * CAPACITY_STD,
        "step_s": dt_s,
    }
