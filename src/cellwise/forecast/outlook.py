"""Remaining time and energy at the present load, from the present state."""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple, Protocol

import numpy as np

from cellwise.cell.equations import CellState
from cellwise.cell.model import CellModel
from cellwise.estimate.filters.filter_state import EkfInfo, EkfState
from cellwise.estimate.power.fixed_tables import LEAST_LOAD_C
from cellwise.estimate.status import CURRENT_INVALID, INNOVATION_REJECTED, OUT_OF_RANGE
from cellwise.forecast.charging import BOTH_FACTOR, ChargerSeen, limit_of, taper_of
from cellwise.forecast.records import NEVER, Going, Outcome
from cellwise.forecast.remaining import WINDOW_S, check_load, uncertain_of, warms_unseen
from cellwise.forecast.remaining_kernels import (
    ends_now,
    lump_now,
    ocv_and_error,
    parts_of,
    power_now,
    warming_with,
)
from cellwise.forecast.warming_kernels import NOTHING_SEEN

LOAD_EVERY_S = 10.0  # of a mean over a minute
MOST_LOADS = 4096  # those of the last eleven hours under load


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
    end_soc: float


class Outlook:
    """Follows the load of the last minute and goes on with its power to empty, when asked.

    Parameters
    ----------
    model : CellModel
    cutoff_V : float          terminal voltage at which the load stops [V]
    given_W : float or None   a load to go on with, too, of one cell [W]
    limit_V, taper_A : float or None    of a charger, as `limit_of` and `taper_of`

    Raises
    ------
    InputError                a given load that is not above zero, a charger that cannot be
    """

    def __init__(
        self,
        model: CellModel,
        cutoff_V: float,
        given_W: float | None = None,
        limit_V: float | None = None,
        taper_A: float | None = None,
    ) -> None:
        if given_W is not None:
            check_load(given_W, "power")
        self.given_W = given_W
        self._loads: deque[tuple[float, float]] = deque(maxlen=MOST_LOADS)
        self._since_load_s = math.inf
        self._tables = model.parameters()
        self._charge_As = 3600.0 * model.capacity_Ah
        self._uncertain = uncertain_of(model)
        self._least_A = LEAST_LOAD_C * model.capacity_Ah
        self._cutoff_V = cutoff_V
        limit, taper = limit_of(model, limit_V), taper_of(model, taper_A)
        self._charger = ChargerSeen(limit, taper, self._least_A)
        self._unseen = warms_unseen(model)
        self._usual_C = model.usual_temperature_C
        self._load_A = self._load_W = self._bias_V = self._held_V = 0.0
        self._seen_s = 0.0
        self._warming = NOTHING_SEEN
        full = CellState(1.0, 0.0, 0.0, 0.0, 0.0)
        # Compiles, or loads.
        self._ends(full, 0.0, self._least_A, self._least_A * float(model.ocv_V.max()), 25.0)
        if given_W is not None:
            self._ends(full, 0.0, self._least_A, None, 25.0)

    def take(self, update: Step) -> None:
        """Follow one sample."""
        sample, info = update.sample, update.info
        if update.gap and update.dt_s >= WINDOW_S:
            self._seen_s = 0.0
        if not (math.isfinite(sample.current_A) and math.isfinite(sample.voltage_V)):
            return
        if info.status & (CURRENT_INVALID | OUT_OF_RANGE):
            return  # what no cell carries is no load
        self._charger.take(sample.current_A, sample.voltage_V, update.dt_s)
        # What flowed in a pause is not known: it has no weight of its own.
        dt_s = 0.0 if update.gap and self._seen_s > 0.0 else update.dt_s
        self._seen_s += dt_s
        # A plain mean until the window is full.
        share = min(dt_s / max(min(self._seen_s, WINDOW_S), 1e-9), 1.0)
        if self._seen_s == 0.0:
            share = 1.0
        self._load_A += share * (sample.current_A - self._load_A)
        self._load_W += share * (sample.current_A * sample.voltage_V - self._load_W)
        self._since_load_s += dt_s
        if self._since_load_s >= LOAD_EVERY_S and self._load_A >= self._least_A:
            self._since_load_s = 0.0
            self._loads.append((self._load_A, self._load_W))
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
        if self._load_A < self._least_A:
            return None
        return self._forecast(state, temperature_C, self._load_A, self._load_W)

    def at_median(self, state: EkfState | None, temperature_C: float) -> ForecastNow | None:
        """The same at the median of the loads so far; None before the first."""
        if not self._loads:
            return None
        load_A, load_W = np.median(np.array(self._loads), axis=0)
        return self._forecast(state, temperature_C, float(load_A), float(load_W))

    def at_given(self, state: EkfState | None, temperature_C: float) -> ForecastNow | None:
        """The same at the load that was given; None where none was."""
        if state is None or self.given_W is None:
            return None
        ocv_V, _ = ocv_and_error(self._tables, state.cell.soc, temperature_C)
        return self._forecast(state, temperature_C, self.given_W / ocv_V, None)

    def to_full(self, state: EkfState | None, temperature_C: float) -> ForecastNow | None:
        """Time and energy to full; None without a state or a charger."""
        charge_A = self._charger.charge_A
        if charge_A is None:
            return None
        now = self._forecast(state, temperature_C, -charge_A, None)
        both_s = None if now is None else self._charger.with_decay(now.remaining_s)
        if now is None or both_s is None:
            return now
        energy_Wh = now.remaining_Wh * both_s / max(now.remaining_s, 1.0)
        return ForecastNow(
            now.load_A, both_s, (both_s / BOTH_FACTOR, both_s * BOTH_FACTOR), energy_Wh, now.end_soc
        )

    def end_socs(
        self, state: EkfState | None, temperature_C: float
    ) -> tuple[float | None, float | None]:
        """SOC at which the present load ends, and a charger; None where there is none."""
        empty = self.forecast(state, temperature_C)
        charge_A = self._charger.charge_A
        full = None if charge_A is None else self._forecast(state, temperature_C, -charge_A, None)
        return empty and empty.end_soc, full and full.end_soc

    def columns(self, state: EkfState | None, temperature_C: float) -> dict[str, Any]:
        """Forecasts at the present, the median, the given load and to full as JSON values."""
        loads = {
            "remaining": self.forecast(state, temperature_C),
            "median_load_remaining": self.at_median(state, temperature_C),
        }
        if self.given_W is not None:
            loads["given_load_remaining"] = self.at_given(state, temperature_C)
        loads["full"] = self.to_full(state, temperature_C)
        row: dict[str, Any] = {}
        for name, now in loads.items():
            row[f"{name}_s"] = None if now is None else now.remaining_s
            row[f"{name}_s_band"] = None if now is None else list(now.remaining_s_band)
            row[f"{name}_Wh"] = None if now is None else now.remaining_Wh
        return row

    def _forecast(
        self, state: EkfState | None, temperature_C: float, load_A: float, load_W: float | None
    ) -> ForecastNow | None:
        if state is None:
            return None
        end, begun = self._ends(state.cell, state.soc_std, load_A, load_W, temperature_C)
        usual = end.usual
        never = usual.reason == NEVER
        return ForecastNow(
            begun.load_A,
            math.inf if never else usual.time_s,
            (end.time_s[0], math.inf if never else end.time_s[1]),
            usual.energy_J / 3600.0,
            usual.soc,
        )

    def _ends(
        self,
        at: CellState,
        soc_std: float,
        load_A: float,
        load_W: float | None,
        temperature_C: float,
    ) -> tuple[Outcome, Going]:
        """To empty, and what it begins with; without ``load_W`` the power is the given one."""
        _, error_V = ocv_and_error(self._tables, at.soc, temperature_C)
        offset_V, share = parts_of(self._uncertain, error_V, self._bias_V, self._held_V)
        lump = lump_now(self._warming, self._charge_As, temperature_C, self._unseen)
        voltage_V = math.nan if load_W is None else load_W / load_A
        charging = load_A < 0.0
        end_V, taper_A = self._cutoff_V, 0.0
        if charging:
            end_V, taper_A = self._charger.limit_V, self._charger.taper_A
        go = Going(load_A, True, voltage_V, offset_V, share, end_V, temperature_C, lump, taper_A)
        if load_W is None and self.given_W is not None and not charging:
            go = power_now(self._tables, at, go, self.given_W)
        end: Outcome = ends_now(self._tables, at, soc_std, go, self._uncertain)
        return end, go
