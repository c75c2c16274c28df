"""State of power of a filter that is fed sample by sample."""

from __future__ import annotations

from typing import Protocol

from cellwise.cell.equations import empty_state
from cellwise.estimate.filters.filter_state import EkfInfo, EkfState
from cellwise.estimate.power.along import column_names
from cellwise.estimate.power.present_kernels import Bias, bias_step
from cellwise.estimate.power.state_of_power import PowerSettings, StateOfPower, present_of


class Step(Protocol):
    """What one sample has made of a filter's state."""

    @property
    def info(self) -> EkfInfo:
        """What the filter says of it."""
        ...

    @property
    def dt_s(self) -> float:
        """Time since the sample before [s]."""
        ...


class PowerFollower:
    """Follows what the model is off by, and gives the power when asked."""

    def __init__(self, settings: PowerSettings) -> None:
        self.settings = settings
        self._bias = bias_step(Bias(0.0, 0.0), 0.0, 0, 0.0)  # compiles, or loads
        settings.of(present_of(empty_state(0.5), 25.0))

    def take(self, update: Step) -> None:
        """Follow one sample."""
        info = update.info
        self._bias = bias_step(self._bias, info.innovation_V, info.status, update.dt_s)

    def now(self, state: EkfState | None, temperature_C: float) -> tuple[StateOfPower, ...]:
        """State of power at every horizon; empty without a state."""
        if state is None:
            return ()
        return self.settings.of(present_of(state, temperature_C, self._bias.voltage_V))

    def columns(self, state: EkfState | None, temperature_C: float) -> dict[str, float | None]:
        """The same by the names of the columns of `replay`; None without a state."""
        found = self.now(state, temperature_C)
        named: dict[str, float | None] = {}
        for j, horizon_s in enumerate(self.settings.horizons_s):
            for way in ("discharge", "charge"):
                value, low = column_names(way, horizon_s)
                limit = getattr(found[j], way) if found else None
                named[value] = None if limit is None else limit.power_W
                named[low] = None if limit is None else limit.power_low_W
        return named
