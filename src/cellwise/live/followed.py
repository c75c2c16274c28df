"""A filter on a stream, and what follows it: time and energy left, power, a percentage."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from cellwise.cell.plausibility.notice import FarOffStream, outside_moment, withheld
from cellwise.estimate.power.power_along_log import PowerFollower
from cellwise.estimate.sensing_kernels import MeasuredSample
from cellwise.estimate.status import Status
from cellwise.forecast.display import Displayed
from cellwise.forecast.outlook import Outlook
from cellwise.live.live_filter import LiveFilter, Update
from cellwise.notices import Notice

FORECAST_EVERY_S = 1.0


@dataclass
class FollowedFilter:
    """A filter on a stream, and what follows it: time and energy left, power, a percentage."""

    live: LiveFilter
    outlook: Outlook
    power: PowerFollower | None = None
    displayed: Displayed | None = None
    far: FarOffStream | None = None
    percent: float = math.nan
    since_expected_s: float = math.inf

    def take(self, update: Update) -> None:
        """Hand a sample on to what follows the filter."""
        self.outlook.take(update)
        sample, info, state = update.sample, update.info, self.live.state
        if self.far is not None:
            known_C = self.live.known_temperature_C(sample)
            seen = update.dt_s, sample.current_A, info.innovation_V, info.soc, info.voltage_V
            self.far.look(*seen, known_C)
        temperature_C = self._temperature_C(update)
        if self.displayed is not None:
            self.since_expected_s += update.dt_s
            if self.since_expected_s >= FORECAST_EVERY_S:
                self.since_expected_s = 0.0
                self.displayed.expect(*self.outlook.end_socs(state, temperature_C))
            dt_s = 0.0 if update.gap else update.dt_s
            self.percent = self.displayed.take(info.soc, sample.current_A, sample.voltage_V, dt_s)
        if self.power is not None and state is not None:
            reading = MeasuredSample(
                sample.current_A, sample.voltage_V, temperature_C, update.dt_s, update.gap
            )
            self.power.take(reading, state, info.status)

    @property
    def model_mismatch(self) -> Notice | None:
        """What is said of a stream that is far off its model; then nothing is foreseen."""
        found = None if self.far is None else self.far.notice
        return None if found is None else withheld(found)

    def columns(self, update: Update) -> dict[str, Any]:
        """Time and energy to empty, power if it is asked for, the cells of a pack: for JSON."""
        state, temperature_C = self.live.state, self._temperature_C(update)
        foreseen = self.outlook.columns(state, temperature_C)
        foreseen |= {} if self.power is None else self.power.columns(state, temperature_C)
        cells = {} if self.live.pack is None else self.live.pack.columns()
        if self.model_mismatch is not None:
            foreseen = dict.fromkeys(foreseen)
            cells = {k: {n: c[n] for n in ("soc", "soc_std")} for k, c in cells.items()}
        shown = {} if self.displayed is None else {"displayed_percent": self.percent}
        return foreseen | shown | cells

    def row(self, update: Update) -> dict[str, Any]:
        """All that is known after a sample, for whoever is sent it."""
        temperature_C = self.live.known_temperature_C(update.sample)
        return state_row(update) | {"temperature_C": temperature_C} | self.columns(update)

    def outside(self, update: Update) -> str | None:
        """That a sample lies outside what the model's data covered, and where; else None."""
        sample, info, model = update.sample, update.info, self.live.model
        if not info.status & Status.OUTSIDE:
            return None
        temperature_C = self.live.known_temperature_C(sample)
        where = outside_moment(model.validity, info.soc, temperature_C, sample.current_A)
        if where is None:
            return None
        grows = "not validated there, the standard deviation grows"
        return f"at {sample.time_s:.1f} s {where}: {grows}"

    def _temperature_C(self, update: Update) -> float:
        """The sample's temperature, else the model's."""
        measured = self.live.known_temperature_C(update.sample)
        return measured if math.isfinite(measured) else self.live.model.usual_temperature_C


def state_row(update: Update) -> dict[str, Any]:
    """An update as values for JSON; what the filter predicts beside what was measured."""
    sample, info = update.sample, update.info
    return {
        "time_s": sample.time_s,
        "soc": info.soc,
        "soc_std": info.soc_std,
        "current_A": sample.current_A,
        "measured_voltage_V": sample.voltage_V,
        "voltage_V": info.voltage_V,
        "innovation_V": info.innovation_V,
        "test_ratio": info.test_ratio,
        "status": info.status,
        "flags": [bit.name for bit in Status(info.status)] if info.status else [],
    }
