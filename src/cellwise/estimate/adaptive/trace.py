"""What the adaptive estimator made of a log: SOC, and the parameters with standard deviations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from cellwise.estimate.adaptive.settings import reason
from cellwise.estimate.trace import Trace
from cellwise.typing import FloatArray, IntArray

# The share of rows in which a parameter has to be held for the reason to be reported at the end.
MOSTLY = 0.5
SHOWN = 0.5


class Estimated(NamedTuple):
    """One parameter: value, standard deviation, and what is to be said of it.

    ``probability`` is the chance that it differs from the model's value (None: not asked);
    ``held`` says why it was held over most of the log, None where it was estimated.
    """

    value: float
    std: float
    probability: float | None
    held: str | None

    @property
    def shown(self) -> bool:
        """Whether the data speak for a value other than the model's."""
        return self.held is None and (self.probability is None or self.probability > SHOWN)

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {**self._asdict(), "shown": self.shown}


class Parameters(NamedTuple):
    """What is wrong with sensor and cell, at one time.

    ``offset_A`` is what the sensor adds to the true current, ``gain`` the factor by which it
    multiplies it; ``resistance_scale`` is the factor on R0 and R1, ``polarisation_scale`` that on
    the slow branches. Capacity and gain stand for the same change of charge: the one that was not
    chosen has the model's value.
    """

    offset_A: Estimated
    gain: Estimated
    resistance_scale: Estimated
    polarisation_scale: Estimated
    capacity_Ah: Estimated
    soh_capacity: float
    soh_resistance: float

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            name: value.to_dict() if isinstance(value, Estimated) else value
            for name, value in self._asdict().items()
        }


@dataclass(frozen=True, eq=False, repr=False)
class AdaptiveTrace(Trace):
    """A trace with the parameters, every array of shape (rows,); ``held`` is (3, rows).

    ``held`` are the bits of :class:`cellwise.estimate.adaptive.settings.Held` for offset,
    resistance and capacity or gain.
    """

    offset_A: FloatArray
    offset_std_A: FloatArray
    offset_probability: FloatArray
    gain: FloatArray
    gain_std: FloatArray
    capacity_Ah: FloatArray
    capacity_std_Ah: FloatArray
    charge_probability: FloatArray
    resistance_scale: FloatArray
    resistance_std: FloatArray
    polarisation_scale: FloatArray
    polarisation_std: FloatArray
    held: IntArray
    model_capacity_Ah: float
    estimates_gain: bool

    def parameters(self, row: int = -1) -> Parameters:
        """Values at one row, the last by default; reasons are those of most rows up to there."""
        stop = len(self) if row == -1 else row + 1
        offset, resistance, charge = (_mostly(bits[:stop]) for bits in self.held)
        chance = float(self.charge_probability[row])
        # Held and its chance, of the one that a change of charge is laid to and of the other.
        laid, other = (charge, chance), ("the charge is laid to the other", None)

        def at(
            value: FloatArray, std: FloatArray, held: str | None, probability: float | None = None
        ) -> Estimated:
            return Estimated(float(value[row]), float(std[row]), probability, held)

        scale = at(self.resistance_scale, self.resistance_std, resistance)
        gain = at(self.gain, self.gain_std, *(laid if self.estimates_gain else other))
        capacity = at(
            self.capacity_Ah, self.capacity_std_Ah, *(other if self.estimates_gain else laid)
        )
        probability = float(self.offset_probability[row])
        return Parameters(
            offset_A=at(self.offset_A, self.offset_std_A, offset, probability),
            gain=gain,
            resistance_scale=scale,
            polarisation_scale=at(self.polarisation_scale, self.polarisation_std, resistance),
            capacity_Ah=capacity,
            soh_capacity=capacity.value / self.model_capacity_Ah,
            soh_resistance=scale.value,
        )


def _mostly(bits: IntArray) -> str | None:
    """Words for the reasons of most rows, if most rows were held."""
    if bits.size == 0 or np.mean(bits != 0) <= MOSTLY:
        return None
    common = [1 << k for k in range(6) if np.mean(bits >> k & 1) > MOSTLY]
    return reason(sum(common)) if common else reason(int(np.bitwise_or.reduce(bits)))
