"""Adaptive estimator: SOC with current-sensor offset, resistances and capacity (or gain)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.compiled import announce
from cellwise.cell.model import CellModel
from cellwise.estimate.adaptive_settings import AdaptiveSettings, held_bits, reason
from cellwise.estimate.filters import filter_state as layout
from cellwise.estimate.filters.filter_state import TraceArrays
from cellwise.estimate.filters.kalman import (
    FilterOfModel,
    check_state,
    log_arrays,
    reading_from,
    trace_fields,
)
from cellwise.estimate.filters.kalman_kernels import (
    AdaptiveState,
    adaptive_rows,
    adaptive_start,
    adaptive_step,
)
from cellwise.estimate.noise import Noise
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray, IntArray

CHARGE_LOW, CHARGE_HIGH = 0.5, 2.5
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
    multiplies it; ``resistance_scale`` is the factor on R0 and R1. Capacity and gain stand for the
    same change of charge: the one that was not chosen has the model's value.
    """

    offset_A: Estimated
    gain: Estimated
    resistance_scale: Estimated
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

    ``held`` are the bits of :class:`cellwise.estimate.adaptive_settings.Held` for offset,
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


class AdaptiveInfo(NamedTuple):
    """What may be looked at after a step; voltage to status as in ``EkfInfo``.

    ``capacity_Ah`` and ``gain`` stand for one change of charge: the one that was not chosen is the
    model's. ``*_probability`` is the chance that the model's value does not hold. ``held_*`` are
    the bits of :class:`cellwise.estimate.adaptive_settings.Held`, 0 where it is estimated.
    """

    soc: float
    soc_std: float
    voltage_V: float
    innovation_V: float
    innovation_variance_V2: float
    test_ratio: float
    status: int
    offset_A: float
    offset_std_A: float
    offset_probability: float
    capacity_Ah: float
    capacity_std_Ah: float
    gain: float
    gain_std: float
    charge_probability: float
    resistance_scale: float
    held_offset: int
    held_resistance: int
    held_charge: int


class Adaptive(FilterOfModel):
    """The EKF with more that is free: beside the sensor's offset the capacity, and resistances.

    Parameters
    ----------
    model : CellModel
    noise : Noise or None                 None: from the model's own validation error
    settings : AdaptiveSettings or None   which parameters, and what is believed of them

    Examples
    --------
    >>> adaptive = Adaptive(model)                                       # doctest: +SKIP
    >>> state = adaptive.init(soc0=0.5, soc0_std=0.2)                    # doctest: +SKIP
    >>> state, info = adaptive.step(state, 1.2, 3.71, 25.0, dt_s=0.1)    # doctest: +SKIP
    """

    name = "adaptive"

    def __init__(
        self,
        model: CellModel,
        noise: Noise | None = None,
        settings: AdaptiveSettings | None = None,
    ) -> None:
        super().__init__(model, noise)
        self.settings = AdaptiveSettings() if settings is None else settings
        offset = replace(self.noise, offset_share=self.settings.offset_share)
        self._noise = offset.scalars(model)
        self._rules = self.settings.rules()
        self._unknown = self.start(0.5, 0.3)  # for a state that is no longer finite: know nothing

    def init(self, soc0: float, soc0_std: float = 0.15, current_A: float = 0.0) -> AdaptiveState:
        """State at ``soc0`` that is known to ``soc0_std``; as :meth:`KalmanFilter.init`."""
        return adaptive_start(self.start(soc0, soc0_std), self._rules, float(current_A))

    def step(
        self,
        state: AdaptiveState,
        current_A: float,
        voltage_V: float,
        temperature_C: float | None = None,
        *,
        dt_s: float,
        gap: bool = False,
    ) -> tuple[AdaptiveState, AdaptiveInfo]:
        """Take the sample that ends an interval of ``dt_s`` seconds.

        Raises
        ------
        InputError        dt_s negative or not finite; a state or a reading of another type
        """
        check_state(state, AdaptiveState, self.name)
        reading = reading_from(current_A, voltage_V, temperature_C, dt_s, gap)
        announce(adaptive_step, f"the {self.name} step")
        out = self._room(1)
        after = adaptive_step(
            self._tables, self._noise, self._rules, self._unknown, state, reading, out
        )
        known = self._parameters(out)
        numbers = [known[name][0].item() for name in AdaptiveInfo._fields if name in known]
        info = (*out.values[: layout.OUTPUTS, 0].tolist(), int(out.status[0]))
        return after, AdaptiveInfo(*info, *numbers, *known["held"][:, 0].tolist())

    @staticmethod
    def _room(rows: int) -> TraceArrays:
        values = np.empty((layout.ADAPTIVE_OUTPUTS, rows))
        return TraceArrays(values, np.empty(rows, dtype=np.int32))

    def run(self, log: CellLog, soc0: float, soc0_std: float = 0.15) -> AdaptiveTrace:
        """Replay a whole log; the same steps in one compiled loop."""
        rows, start = log_arrays(log), self.start(soc0, soc0_std)
        out = self._room(len(log))
        announce(adaptive_rows, f"the estimator '{self.name}'")
        adaptive_rows(self._tables, self._noise, self._rules, start, self._unknown, rows, out)
        return AdaptiveTrace(
            **trace_fields(log, out),
            **self._parameters(out),
            model_capacity_Ah=self.model.capacity_Ah,
            estimates_gain=self.settings.estimates_gain,
        )

    def _parameters(self, out: TraceArrays) -> dict[str, Any]:
        """Offset, capacity or gain and resistances of some rows, and why they were held."""
        v = out.values
        q = np.clip(1.0 + v[layout.OUT_CHARGE], CHARGE_LOW, CHARGE_HIGH)
        inverse, spread = 1.0 / q, v[layout.OUT_CHARGE_STD] / (q * q)
        one, none = np.ones_like(q), np.zeros_like(q)
        capacity, of_gain = self.model.capacity_Ah, self.settings.estimates_gain
        return {
            "offset_A": v[layout.OUT_OFFSET],
            "offset_std_A": v[layout.OUT_OFFSET_STD],
            "offset_probability": v[layout.OUT_OFFSET_FREE],
            "gain": inverse if of_gain else one,
            "gain_std": spread if of_gain else none,
            "capacity_Ah": capacity * (one if of_gain else inverse),
            "capacity_std_Ah": none if of_gain else capacity * spread,
            "charge_probability": v[layout.OUT_CHARGE_FREE],
            "resistance_scale": v[layout.OUT_RESISTANCE],
            "resistance_std": v[layout.OUT_RESISTANCE_STD],
            "held": held_bits(
                self.settings, out.status, v[layout.OUT_SOC_VARIANCE], v[layout.OUT_MOVES] > 0.0
            ),
        }
