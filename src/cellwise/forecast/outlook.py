"""Remaining time and energy at the present load, from the present state."""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.equations import CellState, empty_state
from cellwise.cell.model import CellModel
from cellwise.estimate.filters.filter_state import EkfState
from cellwise.estimate.power.limits import LEAST_LOAD_C
from cellwise.estimate.status import CURRENT_INVALID, INNOVATION_REJECTED, OUT_OF_RANGE
from cellwise.forecast.charging import BOTH_FACTOR, ChargerSeen, limit_of, taper_of
from cellwise.forecast.forecast_kernels import NEVER, LoadScenario, with_ends
from cellwise.forecast.log_kernels import WINDOW_S, ocv_and_error, parts_of
from cellwise.forecast.remaining import check_load, uncertain_of, warms_unseen
from cellwise.forecast.warming_kernels import NOTHING_SEEN, observed, thermal_of

LOAD_EVERY_S = 10.0  # of a mean over a minute
MOST_LOADS = 4096  # those of the last eleven hours under load


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
        self._loads_A: deque[float] = deque(maxlen=MOST_LOADS)
        self._since_load_s = math.inf
        self._tables = model.parameters()
        self._charge_As = 3600.0 * model.capacity_Ah
        self._uncertain = uncertain_of(model)
        self._least_A = LEAST_LOAD_C * model.capacity_Ah
        self._cutoff_V = cutoff_V
        limit, taper = limit_of(model, limit_V), taper_of(model, taper_A)
        self._charger = ChargerSeen(limit, taper, self._least_A)
        self._unseen = warms_unseen(model)
        self._usual_C, self._usual_V = model.usual_temperature_C, float(np.median(model.ocv_V))
        self._load_A = self._bias_V = self._held_V = self._seen_s = 0.0
        self._warming = NOTHING_SEEN
        self._at(empty_state(1.0), 0.0, self._least_A, 25.0)  # compiles

    def take(self, update: Any) -> None:
        """Follow one sample: an `Update` of a `LiveFilter`."""
        sample, info, dt_s = update.sample, update.info, update.dt_s
        if update.gap and dt_s >= WINDOW_S:
            self._seen_s = 0.0
        if not (math.isfinite(sample.current_A) and math.isfinite(sample.voltage_V)):
            return
        if info.status & (CURRENT_INVALID | OUT_OF_RANGE):
            return  # what no cell carries is no load
        self._charger.take(sample.current_A, sample.voltage_V, dt_s)
        # What flowed in a pause is not known: it has no weight of its own.
        seen_s = 0.0 if update.gap and self._seen_s > 0.0 else dt_s
        self._seen_s += seen_s
        # A plain mean until the window is full.
        share = min(seen_s / min(self._seen_s, WINDOW_S), 1.0) if self._seen_s else 1.0
        self._load_A += share * (sample.current_A - self._load_A)
        self._since_load_s += seen_s
        if self._since_load_s >= LOAD_EVERY_S and self._load_A >= self._least_A:
            self._since_load_s = 0.0
            self._loads_A.append(self._load_A)
        warm_C = sample.temperature_C if math.isfinite(sample.temperature_C) else self._usual_C
        ocv_V, _ = ocv_and_error(self._tables, info.soc, warm_C)
        voltage_V = info.voltage_V
        if math.isfinite(info.innovation_V) and info.status & INNOVATION_REJECTED == 0:
            self._bias_V += share * (info.innovation_V - self._bias_V)
            self._held_V += share * ((ocv_V - voltage_V) - self._held_V)
            voltage_V = sample.voltage_V
        lost_W = sample.current_A * (ocv_V - voltage_V)
        self._warming = observed(
            self._warming, self._charge_As, lost_W, sample.temperature_C, dt_s
        )  # fmt: skip

    def forecast(self, state: EkfState | None, temperature_C: float) -> ForecastNow | None:
        """Remaining time and energy now; None without a state or a load of at least C/50."""
        load_A = self._load_A if self._load_A >= self._least_A else None
        return self._forecast(state, temperature_C, load_A)

    def at_median(self, state: EkfState | None, temperature_C: float) -> ForecastNow | None:
        """The same at the median of the loads so far; None before the first."""
        load_A = float(np.median(self._loads_A)) if self._loads_A else None
        return self._forecast(state, temperature_C, load_A)

    def to_full(self, state: EkfState | None, temperature_C: float) -> ForecastNow | None:
        """Time and energy to full; None without a state or a charger."""
        now = self._on_charger(state, temperature_C)
        both_s = None if now is None else self._charger.with_decay(now.remaining_s)
        if now is None or both_s is None:
            return now
        return now._replace(
            remaining_s=both_s,
            remaining_s_band=(both_s / BOTH_FACTOR, both_s * BOTH_FACTOR),
            remaining_Wh=now.remaining_Wh * both_s / max(now.remaining_s, 1.0),
        )

    def end_socs(
        self, state: EkfState | None, temperature_C: float
    ) -> tuple[float | None, float | None]:
        """SOC at which the present load ends, and a charger; None where there is none."""
        empty = self.forecast(state, temperature_C)
        full = self._on_charger(state, temperature_C)
        return empty and empty.end_soc, full and full.end_soc

    def columns(self, state: EkfState | None, temperature_C: float) -> dict[str, Any]:
        """Forecasts at the present, the median, the given load and to full as JSON values."""
        loads = {
            "remaining": self.forecast(state, temperature_C),
            "median_load_remaining": self.at_median(state, temperature_C),
        }
        if self.given_W is not None:
            given_W, near_A = self.given_W, self.given_W / self._usual_V
            loads["given_load_remaining"] = self._forecast(state, temperature_C, near_A, given_W)
        loads["full"] = self.to_full(state, temperature_C)
        row: dict[str, Any] = {}
        for name, now in loads.items():
            row[f"{name}_s"] = now and now.remaining_s
            row[f"{name}_s_band"] = now and list(now.remaining_s_band)
            row[f"{name}_Wh"] = now and now.remaining_Wh
        return row

    def _on_charger(self, state: EkfState | None, temperature_C: float) -> ForecastNow | None:
        charge_A = self._charger.charge_A
        return self._forecast(state, temperature_C, None if charge_A is None else -charge_A)

    def _forecast(
        self,
        state: EkfState | None,
        temperature_C: float,
        load_A: float | None,
        power_W: float = math.nan,
    ) -> ForecastNow | None:
        if state is None or load_A is None:
            return None
        return self._at(state.cell, state.soc_std, load_A, temperature_C, power_W)

    def _at(
        self,
        at: CellState,
        soc_std: float,
        load_A: float,
        temperature_C: float,
        power_W: float = math.nan,
    ) -> ForecastNow:
        """To empty, or on a charger to full."""
        _, error_V = ocv_and_error(self._tables, at.soc, temperature_C)
        offset_V, share = parts_of(self._uncertain, error_V, self._bias_V, self._held_V)
        lump = thermal_of(self._warming, self._charge_As, temperature_C, self._unseen)
        end_V, taper_A = self._cutoff_V, 0.0
        if load_A < 0.0:
            end_V, taper_A = self._charger.limit_V, self._charger.taper_A
        go = LoadScenario(
            load_A, True, power_W, offset_V, share, end_V, temperature_C, lump, taper_A
        )
        end = with_ends(self._tables, at, soc_std, go, self._uncertain)
        never = end.usual.reason == NEVER
        return ForecastNow(
            end.load_A,
            math.inf if never else end.usual.time_s,
            (end.time_s[0], math.inf if never else end.time_s[1]),
            end.usual.energy_J / 3600.0,
            end.usual.soc,
        )
