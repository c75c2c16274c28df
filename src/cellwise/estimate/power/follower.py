"""State of power of a filter that is fed sample by sample."""

from __future__ import annotations

from cellwise.cell.equations import CellState, empty_state
from cellwise.estimate.adaptive.adaptive_kernels import AdaptiveState
from cellwise.estimate.filters.filter_state import EkfState
from cellwise.estimate.power.along import column_names
from cellwise.estimate.power.present_kernels import bias_step, no_bias
from cellwise.estimate.power.state_of_power import PowerSettings, StateOfPower, present_of
from cellwise.estimate.sensing_kernels import Reading


class PowerFollower:
    """Follows what the model is off by, and gives the power when asked."""

    def __init__(self, settings: PowerSettings) -> None:
        self.settings = settings
        self._bias = no_bias()
        self.take(Reading(0.0, float("nan"), 25.0, 0.0, False), empty_state(0.5))  # compiles
        settings.of(present_of(empty_state(0.5), 25.0))
        self._bias = no_bias()

    @property
    def bias_V(self) -> float:
        """Measured less modelled voltage of late [V]; 0 before any was seen."""
        return self._bias.voltage_V

    def take(
        self, reading: Reading, state: EkfState | AdaptiveState | CellState, status: int = 0
    ) -> None:
        """Follow one sample; ``state`` is what the filter has made of it."""
        present = present_of(state, reading.temperature_C)
        self._bias = bias_step(
            self.settings.tables, self._bias, present.cell, present.but, reading,
            reading.temperature_C, status,
        )  # fmt: skip

    def now(
        self, state: EkfState | AdaptiveState | None, temperature_C: float
    ) -> tuple[StateOfPower, ...]:
        """State of power at every horizon; empty without a state."""
        if state is None:
            return ()
        return self.settings.of(present_of(state, temperature_C, self.bias_V))

    def columns(
        self, state: EkfState | AdaptiveState | None, temperature_C: float
    ) -> dict[str, float | None]:
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
