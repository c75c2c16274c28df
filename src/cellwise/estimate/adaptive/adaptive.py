"""Adaptive estimator: SOC with current-sensor offset, resistances and capacity (or gain)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.compiled import announce
from cellwise.cell.model import CellModel
from cellwise.estimate.adaptive import adaptive_kernels as kernel
from cellwise.estimate.adaptive.adaptive_kernels import AdaptiveState, adaptive_start
from cellwise.estimate.adaptive.settings import AdaptiveSettings, held_bits
from cellwise.estimate.adaptive.trace import AdaptiveTrace
from cellwise.estimate.filters.filter_state import EkfInfo, TraceArrays
from cellwise.estimate.filters.kalman import (
    FilterOfModel,
    check_state,
    log_arrays,
    reading_from,
    trace_fields,
)
from cellwise.estimate.noise import Noise
from cellwise.logs.cell_log import CellLog

CHARGE_LOW, CHARGE_HIGH = 0.5, 2.5


class AdaptiveInfo(NamedTuple):
    """What may be looked at after a step; voltage to status as in ``EkfInfo``.

    ``capacity_Ah`` and ``gain`` stand for one change of charge: the one that was not chosen is the
    model's. ``*_probability`` is the chance that the model's value does not hold. ``held_*`` are
    the bits of :class:`cellwise.estimate.adaptive.settings.Held`, 0 where it is estimated.
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
    polarisation_scale: float
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
        announce(kernel.adaptive_step, f"the {self.name} step")
        after, info = kernel.adaptive_step(
            self._tables, self._noise, self._rules, self._unknown, state, reading
        )
        return after, self._info(after, info)

    def _info(self, state: AdaptiveState, info: EkfInfo) -> AdaptiveInfo:
        """What a replay's row says of a state."""
        out = TraceArrays(np.empty((kernel.ADAPTIVE_OUTPUTS, 1)), np.array([info.status], np.int32))
        offset_A = self._noise.offset_soc_per_s * self._tables.cell.charge_As
        kernel.put_free(self._rules, offset_A, out, 0, state.filter, state.free)
        known = self._parameters(out)
        numbers = [known[name][0].item() for name in AdaptiveInfo._fields if name in known]
        return AdaptiveInfo(*info, *numbers, *known["held"][:, 0].tolist())

    def run(self, log: CellLog, soc0: float, soc0_std: float = 0.15) -> AdaptiveTrace:
        """Replay a whole log; the same steps in one compiled loop."""
        rows, start = log_arrays(log), self.start(soc0, soc0_std)
        n = len(log)
        out = TraceArrays(np.empty((kernel.ADAPTIVE_OUTPUTS, n)), np.empty(n, dtype=np.int32))
        announce(kernel.adaptive_rows, f"the estimator '{self.name}'")
        kernel.adaptive_rows(
            self._tables, self._noise, self._rules, start, self._unknown, rows, out
        )
        return AdaptiveTrace(
            **trace_fields(log, out),
            **self._parameters(out),
            model_capacity_Ah=self.model.capacity_Ah,
            estimates_gain=self.settings.estimates_gain,
        )

    def _parameters(self, out: TraceArrays) -> dict[str, Any]:
        """Offset, capacity or gain and resistances of some rows, and why they were held."""
        v = out.values
        q = np.clip(1.0 + v[kernel.OUT_CHARGE], CHARGE_LOW, CHARGE_HIGH)
        inverse, spread = 1.0 / q, v[kernel.OUT_CHARGE_STD] / (q * q)
        one, none = np.ones_like(q), np.zeros_like(q)
        capacity, of_gain = self.model.capacity_Ah, self.settings.estimates_gain
        return {
            "offset_A": v[kernel.OUT_OFFSET],
            "offset_std_A": v[kernel.OUT_OFFSET_STD],
            "offset_probability": v[kernel.OUT_OFFSET_FREE],
            "gain": inverse if of_gain else one,
            "gain_std": spread if of_gain else none,
            "capacity_Ah": capacity * (one if of_gain else inverse),
            "capacity_std_Ah": none if of_gain else capacity * spread,
            "charge_probability": v[kernel.OUT_CHARGE_FREE],
            "resistance_scale": v[kernel.OUT_FAST],
            "resistance_std": v[kernel.OUT_FAST_STD],
            "polarisation_scale": v[kernel.OUT_TAIL],
            "polarisation_std": v[kernel.OUT_TAIL_STD],
            "held": held_bits(
                self.settings, out.status, v[kernel.OUT_SOC_VARIANCE], v[kernel.OUT_MOVES] > 0.0
            ),
        }
