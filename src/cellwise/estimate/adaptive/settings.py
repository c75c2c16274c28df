"""What the adaptive estimator may rules, how fast, and why it does not."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntFlag

from cellwise.errors import InputError
from cellwise.estimate.adaptive.state_kernels import AdaptiveScalars

ESTIMABLE = ("current_offset", "resistance", "capacity", "current_gain")


class Held(IntFlag):
    """Why a parameter was held in a step; 0: it was estimated."""

    NOT_CHOSEN = 1
    SOC_UNSURE = 2  # the SOC is not yet known well enough to look for anything else
    NO_EXCITATION = 4  # the load hardly moves: a resistance and an OCV look alike
    MODEL_MISFIT = 8  # no value of the parameters explains the voltage
    NO_VOLTAGE = 16
    NO_CURRENT = 32


REASONS = {
    Held.NOT_CHOSEN: "not among the parameters to estimate",
    Held.SOC_UNSURE: "SOC not known well enough",
    Held.NO_EXCITATION: "the load hardly moves",
    Held.MODEL_MISFIT: "the model does not explain the voltage",
    Held.NO_VOLTAGE: "no voltage",
    Held.NO_CURRENT: "no current",
}


def reason(held: int) -> str | None:
    """The reasons in words; None where the parameter is estimated."""
    return "; ".join(text for bit, text in REASONS.items() if held & bit) or None


@dataclass(frozen=True)
class AdaptiveSettings:
    """Parameters to rules, what is believed of them before, and when they are held.

    Currents are shares of 1C (the model's capacity over an hour), standard deviations all.

    Parameters
    ----------
    learn : tuple of str         of ``current_offset``, ``resistance``, ``capacity``,
                                 ``current_gain``; capacity and gain move the counted charge alike,
                                 so only one of the two can be chosen
    offset_C : float             sensor offset before any data
    resistance : float           factor on the resistances, about 1
    charge : float               capacity or gain, as a share
    offset_C_per_sqrt_h, resistance_per_sqrt_h, charge_per_sqrt_h : float    how they wander
    fault_probability, charge_probability : float
                                 chance, before any data, that there is an offset, that capacity or
                                 gain is not the model's
    settled_soc : float          beyond this deviation of SOC nothing is estimated
    swing_V : float              below this RMS of the moving drop resistances are held
    fast_s, tail_s : float       what moves within fast_s shows R0 and R1, up to tail_s R2
    misfit : float               mean of innovation squared over variance from which all is held
    rest_s : float               a current that stands still near zero for as long is a rest
    rest_limit_C, rest_band_C : float    what near zero and standing still mean
    rest_C : float               how well a rest shows the offset
    """

    learn: tuple[str, ...] = ("current_offset", "resistance", "capacity")
    offset_C: float = 0.03
    resistance: float = 0.08
    charge: float = 0.08
    offset_C_per_sqrt_h: float = 0.002
    resistance_per_sqrt_h: float = 0.1
    charge_per_sqrt_h: float = 0.002
    fault_probability: float = 0.2
    charge_probability: float = 0.02
    settled_soc: float = 0.02
    swing_V: float = 0.003
    fast_s: float = 20.0
    tail_s: float = 120.0
    misfit: float = 9.0
    rest_s: float = 120.0
    rest_limit_C: float = 0.04
    rest_band_C: float = 0.01
    rest_C: float = 0.003

    def __post_init__(self) -> None:
        unknown = [name for name in self.learn if name not in ESTIMABLE]
        if unknown:
            raise InputError(
                f"a parameter '{unknown[0]}' to estimate",
                f"some of {', '.join(ESTIMABLE)}",
                "Correct its name.",
            )
        if "capacity" in self.learn and "current_gain" in self.learn:
            raise InputError(
                "capacity and current_gain both to be estimated",
                "one of the two",
                "They move the counted charge alike, no data can separate them: drop one.",
            )
        for name, value in vars(self).items():
            if isinstance(value, float) and not (math.isfinite(value) and value >= 0):
                raise InputError(f"{name} = {value}", "a number of at least 0", "Correct it.")
        for name in ("fault_probability", "charge_probability"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise InputError(
                    f"{name} = {getattr(self, name)}",
                    "a probability between 0 and 1",
                    "Leave the parameter out of `learn` where it cannot be wrong.",
                )
        if self.fast_s <= 0.0 or self.tail_s <= 0.0:
            raise InputError(
                f"fast_s = {self.fast_s}, tail_s = {self.tail_s}", "both above 0 s", "Correct them."
            )

    @property
    def estimates_gain(self) -> bool:
        """Whether a wrong charge is laid to the sensor's gain and not to the capacity."""
        return "current_gain" in self.learn

    def scalars(self, capacity_Ah: float) -> AdaptiveScalars:
        """What the kernels take, for a model of the given capacity [Ah]."""
        offset = "current_offset" in self.learn and self.offset_C > 0.0
        resistance = "resistance" in self.learn and self.resistance > 0.0
        charge = ("capacity" in self.learn or self.estimates_gain) and self.charge > 0.0
        hour = 3600.0
        return AdaptiveScalars(
            offset_variance=(self.offset_C * capacity_Ah) ** 2 if offset else 0.0,
            resistance_variance=self.resistance**2 if resistance else 0.0,
            charge_variance=self.charge**2 if charge else 0.0,
            offset_walk=(self.offset_C_per_sqrt_h * capacity_Ah) ** 2 / hour if offset else 0.0,
            resistance_walk=self.resistance_per_sqrt_h**2 / hour if resistance else 0.0,
            charge_walk=self.charge_per_sqrt_h**2 / hour if charge else 0.0,
            estimates_offset=offset,
            estimates_resistance=resistance,
            estimates_charge=charge,
            settled_variance=self.settled_soc**2,
            swing_V2=self.swing_V**2,
            fast_s=self.fast_s,
            tail_s=self.tail_s,
            misfit=self.misfit,
            rest_after_s=self.rest_s,
            rest_band_A=self.rest_band_C * capacity_Ah,
            rest_limit_A=self.rest_limit_C * capacity_Ah,
            rest_variance=(self.rest_C * capacity_Ah) ** 2,
            odds=_odds(self.fault_probability),
            charge_odds=_odds(self.charge_probability),
        )


def _odds(probability: float) -> float:
    """For the model's value, where another has this chance."""
    return (1.0 - probability) / probability
