"""Adaptive estimator: SOC with current-sensor offset, resistances and capacity (or gain)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import announce
from cellwise.cell.model import CellModel
from cellwise.estimate.adaptive import step_kernels as kernel
from cellwise.estimate.adaptive.mixture_kernels import soc_deviation
from cellwise.estimate.adaptive.settings import AdaptiveSettings
from cellwise.estimate.adaptive.state_kernels import AdaptiveState, adaptive_start
from cellwise.estimate.adaptive.trace import AdaptiveTrace
from cellwise.estimate.filters.kalman import (
    FilterOfModel,
    check_state,
    log_arrays,
    reading_from,
)
from cellwise.estimate.noise import Noise
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray


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
    """Kalman filter over SOC, branch voltages, hysteresis, sensor offset, capacity, resistances.

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
        self._noise = self.noise.scalars(model)
        self._rules = self.settings.scalars(model.capacity_Ah)
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
        after, step, mixed = kernel.adaptive_step(
            self._tables, self._noise, self._rules, self._unknown, state, reading
        )
        charge, charge_std = 1.0 + mixed.charge, math.sqrt(max(mixed.charge_variance, 0.0))
        capacity, capacity_std, gain, gain_std = self._charge(charge, charge_std)
        return after, AdaptiveInfo(
            soc=min(max(mixed.soc, 0.0), 1.0),
            soc_std=soc_deviation(mixed, after.mismatch),
            voltage_V=step.voltage_V,
            innovation_V=step.innovation_V,
            innovation_variance_V2=step.innovation_variance_V2,
            test_ratio=step.test_ratio,
            status=step.status,
            offset_A=mixed.offset_A,
            offset_std_A=math.sqrt(max(mixed.offset_variance, 0.0)),
            offset_probability=mixed.offset_probability,
            capacity_Ah=float(capacity),
            capacity_std_Ah=float(capacity_std),
            gain=float(gain),
            gain_std=float(gain_std),
            charge_probability=mixed.charge_probability,
            resistance_scale=after.resistances.fast,
            polarisation_scale=after.resistances.tail,
            held_offset=step.held.offset,
            held_resistance=step.held.resistance,
            held_charge=step.held.charge,
        )

    def run(self, log: CellLog, soc0: float, soc0_std: float = 0.15) -> AdaptiveTrace:
        """Replay a whole log; the same steps in one compiled loop."""
        rows = log_arrays(log)
        state = self.init(soc0, soc0_std)
        out = np.empty((kernel.OUTPUTS, len(log)))
        status = np.empty(len(log), dtype=np.int32)
        held = np.empty((3, len(log)), dtype=np.int32)
        announce(kernel.adaptive_rows, f"the estimator '{self.name}'")
        kernel.adaptive_rows(
            self._tables,
            self._noise,
            self._rules,
            self._unknown,
            state,
            rows,
            out,
            status,
            held,
        )
        capacity, capacity_std, gain, gain_std = self._charge(
            out[kernel.OUT_CHARGE], out[kernel.OUT_CHARGE_STD]
        )
        return AdaptiveTrace(
            time_s=log.time_s,
            soc=out[kernel.OUT_SOC],
            soc_std=out[kernel.OUT_STD],
            voltage_V=out[kernel.OUT_VOLTAGE],
            innovation_V=out[kernel.OUT_INNOVATION],
            innovation_variance_V2=out[kernel.OUT_VARIANCE],
            test_ratio=out[kernel.OUT_RATIO],
            status=status,
            offset_A=out[kernel.OUT_OFFSET],
            offset_std_A=out[kernel.OUT_OFFSET_STD],
            offset_probability=out[kernel.OUT_OFFSET_FREE],
            gain=np.asarray(gain),
            gain_std=np.asarray(gain_std),
            capacity_Ah=np.asarray(capacity),
            capacity_std_Ah=np.asarray(capacity_std),
            charge_probability=out[kernel.OUT_CHARGE_FREE],
            resistance_scale=out[kernel.OUT_FAST],
            resistance_std=out[kernel.OUT_FAST_STD],
            polarisation_scale=out[kernel.OUT_TAIL],
            polarisation_std=out[kernel.OUT_TAIL_STD],
            held=held,
            model_capacity_Ah=self.model.capacity_Ah,
            estimates_gain=self.settings.estimates_gain,
        )

    def _charge(
        self, q: FloatArray | float, q_std: FloatArray | float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Capacity [Ah] and gain, each with its deviation, out of the one factor on the charge."""
        q, q_std = np.asarray(q), np.asarray(q_std)
        inverse, spread = 1.0 / q, q_std / (q * q)
        one, none = np.ones_like(q), np.zeros_like(q)
        capacity = self.model.capacity_Ah
        if self.settings.estimates_gain:
            return capacity * one, none, inverse, spread
        return capacity * inverse, capacity * spread, one, none
