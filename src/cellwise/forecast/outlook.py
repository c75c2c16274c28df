"""Remaining time and energy at the present load, from the present state."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from cellwise.cell.equations import CellState
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import model_temperature_C
from cellwise.estimate.filters.filter_state import EkfInfo, EkfState
from cellwise.estimate.power.fixed_tables import LEAST_LOAD_C
from cellwise.estimate.status import CURRENT_INVALID, INNOVATION_REJECTED, OUT_OF_RANGE
from cellwise.forecast.remaining import WINDOW_S, uncertain_of, warms_unseen
from cellwise.forecast.remaining_kernels import (
    NEVER,
    Going,
    Outcome,
    lump_now,
    ocv_and_error,
    parts_of,
    warming_with,
    with_ends,
)
from cellwise.forecast.warming_kernels import NOTHING_SEEN


class Reading(Protocol):
    """One sample; NaN where nothing was measured."""

    @property
    def current_A(self) -> float:
        """[A], positive on discharge."""
        ...

    @property
    def voltage_V(self) -> float:
        """[V]."""
        ...

    @property
    def temperature_C(self) -> float:
        """[degC]."""
        ...


class Step(Protocol):
    """What one sample has made of a filter's state."""

    @property
    def sample(self) -> Reading:
        """The sample itself."""
        ...

    @property
    def info(self) -> EkfInfo:
        """What the filter says of it."""
        ...

    @property
    def dt_s(self) -> float:
        """Time since the sample before [s]."""
        ...

    @property
    def gap(self) -> bool:
        """Whether what flowed since then is unknown."""
        ...


class ForecastNow(NamedTuple):
    """Time and energy to empty, with the band of two deviations."""

    load_A: float
    remaining_s: float
    remaining_s_band: tuple[float, float]
    remaining_Wh: float


class Outlook:
    """Follows the load of the last minute and goes on with its power to empty, when asked.

    Parameters
    ----------
    model : CellModel
    cutoff_V : float      terminal voltage at which the load stops [V]
    """

    def __init__(self, model: CellModel, cutoff_V: float) -> None:
        self._tables = model.parameters()
        self._charge_As = 3600.0 * model.capacity_Ah
        self._uncertain = uncertain_of(model)
        self._least_A = LEAST_LOAD_C * model.capacity_Ah
        self._cutoff_V = cutoff_V
        self._unseen = warms_unseen(model)
        self._usual_C = model_temperature_C(model)
        self._load_A = self._load_W = self._bias_V = self._held_V = 0.0
        self._seen_s = 0.0
        self._warming = NOTHING_SEEN
        full = CellState(1.0, 0.0, 0.0, 0.0, 0.0)
        self._ends(full, 0.0, self._least_A, float(model.ocv_V.max()), 25.0)  # compiles, or loads

    def take(self, update: Step) -> None:
        """Follow one sample."""
        sample, info = update.sample, update.info
        if update.gap and update.dt_s >= WINDOW_S:
            self._seen_s = 0.0
        if not (math.isfinite(sample.current_A) and math.isfinite(sample.voltage_V)):
            return
        if info.status & (CURRENT_INVALID | OUT_OF_RANGE):
            return  # what no cell carries is no load
        # What flowed in a pause is not known: it has no weight of its own.
        dt_s = 0.0 if update.gap and self._seen_s > 0.0 else update.dt_s
        self._seen_s += dt_s
        # A plain mean until the window is full.
        share = min(dt_s / max(min(self._seen_s, WINDOW_S), 1e-9), 1.0)
        if self._seen_s == 0.0:
            share = 1.0
        self._load_A += share * (sample.current_A - self._load_A)
        self._load_W += share * (sample.current_A * sample.voltage_V - self._load_W)
        warm_C = sample.temperature_C if math.isfinite(sample.temperature_C) else self._usual_C
        ocv_V, _ = ocv_and_error(self._tables, info.soc, warm_C)
        voltage_V = info.voltage_V
        if math.isfinite(info.innovation_V) and info.status & INNOVATION_REJECTED == 0:
            self._bias_V += share * (info.innovation_V - self._bias_V)
            self._held_V += share * ((ocv_V - voltage_V) - self._held_V)
            voltage_V = sample.voltage_V
        lost_W = sample.current_A * (ocv_V - voltage_V)
        self._warming = warming_with(
            self._warming, self._charge_As, lost_W, sample.temperature_C, update.dt_s
        )

    def forecast(self, state: EkfState | None, temperature_C: float) -> ForecastNow | None:
        """Remaining time and energy now; None without a state or a load of at least C/50."""
        if state is None or self._load_A < self._least_A:
            return None
        end = self._ends(
            state.cell, state.soc_std, self._load_A, self._load_W / self._load_A, temperature_C
        )
        usual = end.usual
        never = usual.reason == NEVER
        return ForecastNow(
            self._load_A,
            math.inf if never else usual.time_s,
            (end.time_s[0], math.inf if never else end.time_s[1]),
            usual.energy_J / 3600.0,
        )

    def _ends(
        self, at: CellState, soc_std: float, load_A: float, voltage_V: float, temperature_C: float
    ) -> Outcome:
        _, error_V = ocv_and_error(self._tables, at.soc, temperature_C)
        offset_V, share = parts_of(self._uncertain, error_V, self._bias_V, self._held_V)
        lump = lump_now(self._warming, self._charge_As, temperature_C, self._unseen)
        go = Going(load_A, True, voltage_V, offset_V, share, self._cutoff_V, temperature_C, lump)
        end: Outcome = with_ends(self._tables, at, soc_std, go, self._uncertain)
        return end
