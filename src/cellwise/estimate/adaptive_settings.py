"""What the adaptive estimator may estimate, how fast, and why it does not."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntFlag

import numpy as np

from cellwise.errors import InputError
from cellwise.estimate.filters.free_kernels import FreeRules, ResistanceRules
from cellwise.estimate.status import (
    CLAMPED,
    CURRENT_INVALID,
    OUTSIDE,
    VOLTAGE_FROZEN,
    VOLTAGE_INVALID,
)
from cellwise.typing import BoolArray, FloatArray, IntArray

ESTIMABLE = ("current_offset", "resistance", "capacity", "current_gain")


class Held(IntFlag):
    """Why a parameter was held in a step; 0: it was estimated."""

    NOT_CHOSEN = 1
    SOC_UNSURE = 2  # the SOC is not yet known well enough to look for anything else
    NO_EXCITATION = 4  # the load hardly moves: a resistance and an OCV look alike
    MODEL_MISFIT = 8  # beyond the model's data, or at an end of its SOC
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
    """Parameters to estimate, what is believed of them before, and when they are held.

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
    settled_soc : float          beyond this deviation of SOC only an offset is estimated
    swing_V : float              below this RMS of the moving drop resistances are held
    fast_s : float               what moves within it shows R0 and R1
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
        if self.fast_s <= 0.0:
            raise InputError(f"fast_s = {self.fast_s}", "seconds above 0", "Correct it.")

    @property
    def estimates_gain(self) -> bool:
        """Whether a wrong charge is laid to the sensor's gain and not to the capacity."""
        return "current_gain" in self.learn

    @property
    def offset_share(self) -> float:
        """Deviation of the offset before any data, of 1C; 0 where it is not estimated."""
        return self.offset_C if "current_offset" in self.learn else 0.0

    def rules(self) -> FreeRules:
        """What the kernels take."""
        resistance = self.resistance if "resistance" in self.learn else 0.0
        charge = self.charge if "capacity" in self.learn or self.estimates_gain else 0.0
        hour = 3600.0
        return FreeRules(
            capacity=charge,
            capacity_odds=_odds(self.charge_probability) if charge > 0.0 else 0.0,
            offset_odds=_odds(self.fault_probability) if self.offset_share > 0.0 else 0.0,
            capacity_wander=_in_squares(self.charge_per_sqrt_h, charge) / hour,
            offset_wander=_in_squares(self.offset_C_per_sqrt_h, self.offset_share) / hour,
            settled_variance=self.settled_soc**2,
            resistances=ResistanceRules(
                variance=resistance**2,
                wander=self.resistance_per_sqrt_h**2 / hour if resistance > 0.0 else 0.0,
                swing_V2=self.swing_V**2,
                fast_s=self.fast_s,
            ),
        )


def _odds(probability: float) -> float:
    """Of another value than the model's, where that has this chance."""
    return probability / (1.0 - probability)


def _in_squares(wander: float, prior: float) -> float:
    """How fast a number wanders, as a share of what is believed of it, in squares."""
    return (wander / prior) ** 2 if prior > 0.0 else 0.0


def held_bits(
    settings: AdaptiveSettings, status: IntArray, soc_variance: FloatArray, moves: BoolArray
) -> IntArray:
    """Why offset, resistance and capacity or gain were held in some rows, shape (3, rows).

    An offset is asked for from the first voltage on, the others once the SOC is settled.
    """
    seen = np.where(status & (VOLTAGE_INVALID | VOLTAGE_FROZEN), int(Held.NO_VOLTAGE), 0)
    seen |= np.where(status & CURRENT_INVALID, int(Held.NO_CURRENT), 0)
    settled = np.where(soc_variance > settings.settled_soc**2, int(Held.SOC_UNSURE), 0)
    outside = np.where(status & (CLAMPED | OUTSIDE), int(Held.MODEL_MISFIT), 0)
    still = np.where(moves, 0, int(Held.NO_EXCITATION))
    chosen = (
        settings.offset_share > 0.0,
        settings.rules().resistances.variance > 0.0,
        settings.rules().capacity > 0.0,
    )
    held = np.stack([seen, seen | settled | still, seen | settled | outside])
    held |= np.where(chosen, 0, int(Held.NOT_CHOSEN))[:, None]
    return held.astype(np.int32)
