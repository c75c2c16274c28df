"""State of power along a replayed log, and of a filter that is fed sample by sample."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellwise.cell.equations import CellState, empty_state
from cellwise.cell.packed import size_of
from cellwise.cell.simulate import known_temperature_C, start_hysteresis
from cellwise.estimate.filters.filter_state import EkfState, LogArrays
from cellwise.estimate.filters.kalman_kernels import AdaptiveState
from cellwise.estimate.power.limits import KnownLimits
from cellwise.estimate.power.load_kernels import Present
from cellwise.estimate.power.memory_kernels import Carried, carried_on, carried_rows, no_memory
from cellwise.estimate.power.state_of_power import Hold, PowerSettings, StateOfPower, present_of
from cellwise.estimate.sensing_kernels import Reading
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray


def column_names(way: str, horizon_s: float) -> tuple[str, str]:
    """Names of a power and of its lower bound in tables and in JSON lines."""
    name = f"{way}_power_{horizon_s:g}s"
    return f"{name}_W", f"{name}_low_W"


@dataclass(frozen=True, eq=False, repr=False)
class PowerTrace:
    """Power limits along a log, without sign; every array has shape (horizons, rows) [W].

    ``discharge_W`` and ``charge_W`` are the values, ``discharge_low_W`` and ``charge_low_W`` the
    bounds that are sustained with 95 %; ``last`` is the state of power at the last row.
    """

    horizons_s: tuple[float, ...]
    hold: Hold
    known: KnownLimits
    discharge_W: FloatArray
    discharge_low_W: FloatArray
    charge_W: FloatArray
    charge_low_W: FloatArray
    last: tuple[StateOfPower, ...]

    def columns(self) -> dict[str, FloatArray]:
        """As columns of a table: ``discharge_power_10s_W``, ``discharge_power_10s_low_W``, ..."""
        found = {}
        for j, horizon in enumerate(self.horizons_s):
            for way in ("discharge", "charge"):
                value, low = column_names(way, horizon)
                found[value] = getattr(self, f"{way}_W")[j]
                found[low] = getattr(self, f"{way}_low_W")[j]
        return found

    def to_dict(self) -> dict[str, Any]:
        """The last row, and within what, as JSON values."""
        return {
            "hold": self.hold,
            "limits": {**vars(self.known.limits)},
            "limits_from": dict(self.known.sources),
            "horizons": [s.to_dict() for s in self.last],
        }

    def __repr__(self) -> str:
        parts = (
            f"{s.horizon_s:g} s {s.discharge.power_W:.1f} / {s.charge.power_W:.1f} W"
            for s in self.last
        )
        return f"PowerTrace(discharge / charge at the end: {', '.join(parts)})"


def power_along(settings: PowerSettings, log: CellLog, trace: Trace) -> PowerTrace:
    """Power limits at every row of a log that an estimator has made ``trace`` of.

    The cell is carried along by the log's current, with the SOC and its deviation of the estimator.
    """
    found = settings.rows(presents_along(settings, log, trace))
    (give, give_low), (take, take_low) = found[..., :2].transpose(2, 3, 1, 0)
    return PowerTrace(
        settings.horizons_s, settings.hold, settings.known, give, give_low, take, take_low,
        settings.states(found[-1]),
    )  # fmt: skip


def presents_along(settings: PowerSettings, log: CellLog, trace: Trace) -> FloatArray:
    """What the power of every row is computed from, shape (rows, numbers of a Present)."""
    present = np.zeros((len(log), size_of(Present)))
    arrays = LogArrays(
        np.ascontiguousarray(log.known_current_A()), np.array(log.voltage_V),
        known_temperature_C(settings.model, log), log.interval_s, log.gap_rows,
    )  # fmt: skip
    carried_rows(
        settings.tables, begun(float(trace.soc[0])), arrays,
        np.ascontiguousarray(trace.soc, dtype=np.float64),
        np.nan_to_num(np.ascontiguousarray(trace.soc_std, dtype=np.float64)),
        np.ascontiguousarray(trace.status, dtype=np.int32), present,
    )  # fmt: skip
    return present


def begun(soc: float) -> Carried:
    """A cell at rest at a SOC, before any sample."""
    return Carried(empty_state(soc, start_hysteresis(soc)), math.nan, no_memory())


class PowerFollower:
    """Follows what the model is off by, and gives the power when asked."""

    def __init__(self, settings: PowerSettings) -> None:
        self.settings = settings
        self._carried: Carried | None = None
        self.take(Reading(0.0, float("nan"), 25.0, 0.0, False), empty_state(0.5))  # compiles
        settings.of(present_of(empty_state(0.5), 25.0))
        self._carried = None

    def take(
        self, reading: Reading, state: EkfState | AdaptiveState | CellState, status: int = 0
    ) -> None:
        """Follow one sample; ``state`` is what the filter has made of it."""
        soc = present_of(state, reading.temperature_C).cell.soc
        was = begun(soc) if self._carried is None else self._carried
        self._carried = carried_on(self.settings.tables, was, reading, soc, status)

    def now(
        self, state: EkfState | AdaptiveState | None, temperature_C: float
    ) -> tuple[StateOfPower, ...]:
        """State of power at every horizon; empty without a state."""
        if state is None or self._carried is None:
            return ()
        cell, _, memory = self._carried
        known = present_of(state, temperature_C, memory.but)
        return self.settings.of(known._replace(cell=cell))

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
