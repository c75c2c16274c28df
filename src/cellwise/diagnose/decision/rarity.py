"""How rare causes are before any row is read: the odds against each set of them."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

# One diagnosis in fifty finds a cause where nobody expected one, and it may be any of twenty.
ONE_CAUSE_NATS = math.log(50.0 * 20.0)
# A cell ages as a whole: what else age does is no second coincidence, only one of a few ways.
FURTHER_AGE_NATS = math.log(10.0)
# What has lost charge has grown in resistance as often as not.
BOTH_NATS = math.log(2.0)
# Charge and material are lost over years: of ten cells that lost as much as logs show, one lost it
# between two logs of which the first is known to be good.
SINCE_BASELINE_NATS = math.log(10.0)
RESISTANCE = frozenset({"resistance_scale", "ohmic_resistance", "charge_transfer"})
AGE = frozenset(
    {
        "capacity",
        "resistance_scale",
        "ohmic_resistance",
        "charge_transfer",
        "lithium_inventory",
        "active_material_negative",
        "active_material_positive",
        "ocv_shift",
    }
)
# Outside the temperatures that the model was measured at these are expected: one of a few ways.
TEMPERATURE = frozenset({"entropy", "surface_soc", "slow_diffusion", "self_heating"})
# There a law that was found at another temperature holds as rarely as a cause comes elsewhere.
LAW = "temperature_dependence"
LAW_HOLDS_NATS = math.log(50.0)


@dataclass(frozen=True)
class Rarity:
    """How rare sets are in one diagnosis.

    ``extrapolated``: the logs' temperature lies outside the model's; ``same_age``: a good log of
    the same cell is known, so that age is no more than one of many ways.
    """

    extrapolated: bool = False
    same_age: bool = False

    def hides(self, name: str) -> bool:
        """Whether a cause cannot be said to be there, however well it explains the logs.

        At a temperature that the model was not measured at, a cell that has aged and a law that
        does not hold there look alike: diffusion that the cold slows empties a cell early, too.
        """
        return self.extrapolated and name in AGE

    def nats(self, names: Collection[str]) -> float:
        """Ln of the odds against a set."""
        left = set(names)
        total = 0.0
        if self.extrapolated:
            total += FURTHER_AGE_NATS * len(left & TEMPERATURE)
            total += 0.0 if LAW in left else LAW_HOLDS_NATS
            left -= TEMPERATURE | {LAW}
        age = left & AGE
        if age:
            kinds = int(bool(age & RESISTANCE)) + int(bool(age - RESISTANCE))
            both = FURTHER_AGE_NATS if self.same_age else BOTH_NATS
            total += ONE_CAUSE_NATS + both * (kinds - 1)
            total += FURTHER_AGE_NATS * (len(age) - kinds)
            if self.same_age and age - RESISTANCE:
                total += SINCE_BASELINE_NATS
        return total + ONE_CAUSE_NATS * len(left - age)
