"""State of power along a replayed log, and of a filter that is fed sample by sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cellwise.cell.equations import CellState, empty_state
from cellwise.cell.simulate import known_temperature_C, start_hysteresis
from cellwise.estimate.adaptive.adaptive_kernels import AdaptiveState
from cellwise.estimate.estimators import Estimator
from cellwise.estimate.filters.filter_state import EkfState
from cellwise.estimate.filters.kalman import KalmanFilter
from cellwise.estimate.power.limits import KnownLimits
from cellwise.estimate.power.load_kernels import Correction
from cellwise.estimate.power.memory_kernels import no_memory, remembered
from cellwise.estimate.power.present_kernels import (
    PRESENT,
    TEMPERATURE_AT,
    carried_states,
    kalman_states,
)
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


def power_along(
    settings: PowerSettings,
    estimator: Estimator,
    log: CellLog,
    trace: Trace,
    soc0: float,
    soc0_std: float,
) -> PowerTrace:
    """Power limits at every row of a log that an estimator has made ``trace`` of.

    EKF and UKF take every step once more, so that branch voltages, hysteresis and covariance are
    the filter's own. Of every other estimator only the SOC and its deviation are known: the log's
    current gives the rest.

    Parameters
    ----------
    soc0, soc0_std : float      where the estimator began
    """
    found = settings.rows(presents_along(settings, estimator, log, trace, soc0, soc0_std))
    (give, give_low), (take, take_low) = found[..., :2].transpose(2, 3, 1, 0)
    return PowerTrace(
        settings.horizons_s, settings.hold, settings.known, give, give_low, take, take_low,
        settings.states(found[-1]),
    )  # fmt: skip


def presents_along(
    settings: PowerSettings,
    estimator: Estimator,
    log: CellLog,
    trace: Trace,
    soc0: float,
    soc0_std: float,
) -> FloatArray:
    """What the power of every row is computed from, shape (rows, PRESENT)."""
    tables = settings.tables
    warm = known_temperature_C(settings.model, log)
    present = np.zeros((len(log), PRESENT))
    if isinstance(estimator, KalmanFilter):
        estimator.take_rows(kalman_states, log, soc0, soc0_std, present)
        present[:, TEMPERATURE_AT] = warm
    else:
        carried_states(
            tables, empty_state(float(trace.soc[0]), start_hysteresis(float(trace.soc[0]))),
            log.interval_s, log.known_current_A(), warm,
            np.ascontiguousarray(trace.soc, dtype=np.float64),
            np.nan_to_num(np.ascontiguousarray(trace.soc_std, dtype=np.float64)),
            np.array(log.voltage_V), np.ascontiguousarray(trace.status, dtype=np.int32), present,
        )  # fmt: skip
    return present


class PowerFollower:
    """Follows what the model is off by, and gives the power when asked."""

    def __init__(self, settings: PowerSettings) -> None:
        self.settings = settings
        self._memory = no_memory()
        self.take(Reading(0.0, float("nan"), 25.0, 0.0, False), empty_state(0.5))  # compiles
        settings.of(present_of(empty_state(0.5), 25.0))
        self._memory = no_memory()

    @property
    def seen(self) -> Correction:
        """What the cell differs by from its model; as the model before any voltage was seen."""
        return self._memory.but

    def take(
        self, reading: Reading, state: EkfState | AdaptiveState | CellState, status: int = 0
    ) -> None:
        """Follow one sample; ``state`` is what the filter has made of it."""
        cell = present_of(state, reading.temperature_C).cell
        self._memory = remembered(
            self.settings.tables, self._memory, cell, reading, reading.temperature_C, status
        )

    def now(
        self, state: EkfState | AdaptiveState | None, temperature_C: float
    ) -> tuple[StateOfPower, ...]:
        """State of power at every horizon; empty without a state."""
        if state is None:
            return ()
        return self.settings.of(present_of(state, temperature_C, self.seen))

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
