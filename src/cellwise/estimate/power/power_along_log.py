"""State of power along a replayed log, and of a filter that is fed sample by sample.

With it what the model has been off by of late: a voltage, and how resistances follow the current. A
load that begins after a rest meets more resistance at small currents than the same load in the
midst of a drive, by up to a fifth. A model of all logs is right in the mean of both; which of the
two a cell does now is seen in the log, at the currents that flow there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.compiled import inline, kernel, rows
from cellwise.cell.equations import (
    CellState,
    CellTables,
    advance,
    delayed_current,
    empty_state,
    with_soc,
)
from cellwise.cell.packed import changed, put_record, size_of
from cellwise.cell.simulate import known_temperature_C, start_hysteresis
from cellwise.estimate.filters.filter_state import EkfState, LogArrays
from cellwise.estimate.filters.kalman_kernels import AdaptiveState, sample_of
from cellwise.estimate.power.limits import KnownLimits
from cellwise.estimate.power.load_kernels import (
    AS_MODEL,
    BIAS_S,
    FACTOR_VARIANCE,
    Correction,
    CorrectionCovariance,
    OperatingPoint,
    falling_share,
    moment_of,
)
from cellwise.estimate.power.state_of_power import Hold, PowerSettings, StateOfPower, present_of
from cellwise.estimate.sensing_kernels import MeasuredSample
from cellwise.estimate.status import INNOVATION_REJECTED, VOLTAGE_FROZEN, VOLTAGE_INVALID
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog
from cellwise.plotting import Tabular
from cellwise.typing import FloatArray, IntArray

# A factor is judged by what moves between the shortest and the longest usual horizon.
NEAR_S, FAR_S = 2.0, BIAS_S
FORGOTTEN_PER_S = FACTOR_VARIANCE / 40_000.0  # half a day: SOC and temperature are others then
LEAST_SWING_V2 = 0.003**2  # of R0 I + V1: below, sensors and OCV move as much
LEAST_MISS_V2 = 0.002**2  # no voltage is measured and modelled better
LONGER = 10.0  # mean squares are taken over this many times the means
UNUSED = INNOVATION_REJECTED | VOLTAGE_INVALID | VOLTAGE_FROZEN


class Smoothed(NamedTuple):
    """One quantity, its mean over ``NEAR_S``, and that one's over ``FAR_S``."""

    near: float
    far: float


class CorrectionMemory(NamedTuple):
    """A correction, and the means it is estimated from.

    ``fast`` is R0 I + V1, ``fallen`` the same times the share that falls with the current, ``tail``
    V2, ``miss`` measured less modelled voltage; the last two are mean squares of what moves.
    """

    but: Correction
    fast: Smoothed
    fallen: Smoothed
    tail: Smoothed
    miss: Smoothed
    swing_V2: float
    miss_V2: float


@kernel
def no_memory() -> CorrectionMemory:
    """Before any sample."""
    none = Smoothed(0.0, 0.0)
    return CorrectionMemory(AS_MODEL, none, none, none, none, 0.0, 0.0)


@inline
def smoothed(was: Smoothed, value: float, near: float, far: float) -> Smoothed:
    """A quantity followed, by shares of the way to it."""
    mean = was.near + near * (value - was.near)
    return Smoothed(mean, was.far + far * (mean - was.far))


@inline
def forgetting(s: CorrectionCovariance, dt_s: float) -> CorrectionCovariance:
    """Variances grow towards what they were before anything was seen."""
    more, most = FORGOTTEN_PER_S * dt_s, FACTOR_VARIANCE
    return CorrectionCovariance(
        min(s.cc + more, most), s.cf, s.ct, min(s.ff + more, most), s.ft, min(s.tt + more, most)
    )


@inline
def taken_off(but: Correction, fast_V: float, fallen_V: float, tail_V: float) -> float:
    """By how much more the corrected cell's voltage falls than the model's [V]."""
    return but.common * fast_V + (but.falling * fallen_V + but.tail * tail_V)


@inline
def least_squares(
    but: Correction, fast_V: float, fallen_V: float, tail_V: float, left_V: float, noise_V2: float
) -> Correction:
    """One step of recursive least squares of the three numbers; ``left_V`` is what they miss."""
    s = but.spread
    c = s.cc * fast_V + (s.cf * fallen_V + s.ct * tail_V)
    f = s.cf * fast_V + (s.ff * fallen_V + s.ft * tail_V)
    t = s.ct * fast_V + (s.ft * fallen_V + s.tt * tail_V)
    k = 1.0 / (noise_V2 + (fast_V * c + (fallen_V * f + tail_V * t)))
    spread = CorrectionCovariance(
        max(s.cc - k * c * c, 0.0), s.cf - k * c * f, s.ct - k * c * t,
        max(s.ff - k * f * f, 0.0), s.ft - k * f * t, max(s.tt - k * t * t, 0.0),
    )  # fmt: skip
    k *= left_V
    return Correction(
        but.common - k * c, but.falling - k * f, but.tail - k * t, but.bias_V, but.seen_s, spread
    )  # fmt: skip


@kernel
def remembered(
    tables: CellTables,
    was: CorrectionMemory,
    x: CellState,
    reading: MeasuredSample,
    delayed_current_A: float,
    status: int,
) -> CorrectionMemory:
    """One sample on; ``delayed_current_A`` is the current that the voltage has seen.

    The bias is the mean over ``BIAS_S`` of measured less corrected voltage, a plain one until that
    has gone by. A sample that was rejected, or is the sensor's fault, is left out.
    """
    dt_s = reading.dt_s
    now = moment_of(tables, x, delayed_current_A, False, reading.temperature_C + x.heat_K, AS_MODEL)
    miss_V = reading.voltage_V - now.voltage_V
    if not math.isfinite(miss_V) or status & UNUSED:
        return was
    near, far = min(dt_s / NEAR_S, 1.0), min(dt_s / FAR_S, 1.0)
    if was.but.seen_s <= 0.0:
        near = far = 1.0
    fast_V, old = now.point.r0_ohm * delayed_current_A + x.v1_V, was.but
    fallen_V = fast_V * falling_share(tables.cell, delayed_current_A)
    fast = smoothed(was.fast, fast_V, near, far)
    fallen = smoothed(was.fallen, fallen_V, near, far)
    tail = smoothed(was.tail, x.v2_V, near, far)
    miss = smoothed(was.miss, miss_V, near, far)
    a, b, c = fast.near - fast.far, fallen.near - fallen.far, tail.near - tail.far
    left_V = (miss.near - miss.far) + taken_off(old, a, b, c)
    share = far / LONGER
    swing_V2 = was.swing_V2 + share * (a * a - was.swing_V2)
    miss_V2 = was.miss_V2 + share * (left_V * left_V - was.miss_V2)
    but = changed(old, "spread", forgetting(old.spread, dt_s))
    if swing_V2 >= LEAST_SWING_V2 and dt_s > 0.0:
        # One piece of evidence in twice the time of the band.
        noise_V2 = max(miss_V2, LEAST_MISS_V2) * max(2.0 * FAR_S / dt_s, 1.0)
        but = least_squares(but, a, b, c, left_V, noise_V2)
    seen_s = min(old.seen_s + dt_s, BIAS_S)
    off_V = miss_V + taken_off(but, fast_V, fallen_V, x.v2_V)
    share = min(dt_s / seen_s, 1.0) if seen_s > 0.0 else 1.0
    but = changed(but, "bias_V", but.bias_V + share * (off_V - but.bias_V))
    but = changed(but, "seen_s", seen_s)
    return CorrectionMemory(but, fast, fallen, tail, miss, swing_V2, miss_V2)


class Carried(NamedTuple):
    """A cell carried through a log by its current, with the SOC of a filter, and its memory."""

    cell: CellState
    previous_A: float
    memory: CorrectionMemory


@kernel
def carried_on(
    tables: CellTables, was: Carried, reading: MeasuredSample, soc: float, status: int
) -> Carried:
    """One sample on, at a known temperature: a missing current is the last, over a gap none."""
    last_A = was.previous_A if math.isfinite(was.previous_A) else 0.0
    now_A = reading.current_A if math.isfinite(reading.current_A) else last_A
    before = was.previous_A if math.isfinite(was.previous_A) else now_A
    delayed_current_A = delayed_current(tables.cell, now_A, before, reading.dt_s)
    counted_current_A = 0.0 if reading.gap else delayed_current_A
    cell, _ = advance(tables, was.cell, counted_current_A, reading.dt_s, reading.temperature_C)
    cell = with_soc(cell, soc)
    memory = remembered(tables, was.memory, cell, reading, delayed_current_A, status)
    return Carried(cell, now_A, memory)


@rows
def carried_rows(
    tables: CellTables,
    start: Carried,
    log: LogArrays,
    soc: FloatArray,
    soc_std: FloatArray,
    status: IntArray,
    out: FloatArray,
) -> None:
    """What is known at every row of a log, shape (rows, numbers of an OperatingPoint)."""
    now = start
    for k in range(log.dt_s.size):
        now = carried_on(tables, now, sample_of(log, k), soc[k], status[k])
        variance = soc_std[k] * soc_std[k]
        known = OperatingPoint(now.cell, variance, log.temperature_C[k], now.memory.but)
        put_record(out[k], 0, 1, known, True)


def column_names(way: str, horizon_s: float) -> tuple[str, str]:
    """Names of a power and of its lower bound in tables and in JSON lines."""
    name = f"{way}_power_{horizon_s:g}s"
    return f"{name}_W", f"{name}_low_W"


@dataclass(frozen=True, eq=False, repr=False)
class PowerTrace(Tabular):
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
    """What the power of every row is computed from, shape (rows, numbers of an OperatingPoint)."""
    present = np.zeros((len(log), size_of(OperatingPoint)))
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
        self.take(MeasuredSample(0.0, float("nan"), 25.0, 0.0, False), empty_state(0.5))  # compiles
        settings.of(present_of(empty_state(0.5), 25.0))
        self._carried = None

    def take(
        self, reading: MeasuredSample, state: EkfState | AdaptiveState | CellState, status: int = 0
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
