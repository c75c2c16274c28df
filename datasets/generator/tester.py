"""A virtual battery tester: the steps a laboratory programs, and the rows its recorder keeps.

The tester knows nothing about electrochemistry. It asks the cell for the response to a constant
current or a constant voltage, watches limits, and keeps true values at the rows' instants. What
an instrument makes of them (noise, resolution) is the business of `instrument.py`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .physics import (
    FAR_ABOVE_V,
    FAR_BELOW_V,
    REGULATOR_DELAY_S,
    FloatArray,
    PhysicsCell,
    Stretch,
)

RowPlan = tuple[tuple[float, float], ...]
"""Pairs (until_s, period_s): rows every `period_s` until `until_s` from the step's start."""

# Rows nearer to each other than this would add nothing: the recorder drops the earlier one
# of a row at a limit and a row of the plan.
MIN_ROW_GAP_S = 0.02


@dataclass(frozen=True)
class Rest:
    """No current for `seconds` [s]."""

    seconds: float
    rows: RowPlan


@dataclass(frozen=True)
class ConstantCurrent:
    """Hold `current_A` [A] for at most `seconds` [s].

    Where the voltage limit is reached, the step ends (`hold_at_limit` false), or goes on at the
    limit's voltage until its time is over (true): that is a trimmed pulse.
    """

    current_A: float
    rows: RowPlan
    seconds: float = 400_000.0
    hold_at_limit: bool = False


@dataclass(frozen=True)
class ConstantVoltage:
    """Hold the limit that lies in the direction of `sign` until `cutoff_A` [A] is reached."""

    sign: float
    cutoff_A: float
    rows: RowPlan
    seconds: float = 100_000.0


@dataclass(frozen=True)
class Profile:
    """Play `current_A` (n,) [A], each value for `period_s` [s], limits held as in a pulse."""

    current_A: FloatArray
    period_s: float = 1.0


Step = Rest | ConstantCurrent | ConstantVoltage | Profile


class TrueLog(NamedTuple):
    """What really happened, shape (n,) each; `current_A` [A] is the mean over the row's interval.

    The mean over the interval that ends at the row makes the charge of the rows exact whatever
    the current did inside it; in constant-current steps it is the current itself.
    """

    time_s: FloatArray
    current_A: FloatArray
    voltage_V: FloatArray
    temperature_C: FloatArray
    charge_Ah: FloatArray
    step: FloatArray


def row_instants(plan: RowPlan, seconds: float) -> FloatArray:
    """Instants of the rows of a step of known length, the end always among them [s]."""
    parts: list[FloatArray] = []
    start = 0.0
    for until, period in plan:
        stop = min(until, seconds)
        count = int(np.floor((stop - start) / period + 1e-9))
        parts.append(start + period * np.arange(1, count + 1, dtype=np.float64))
        start += period * count
    instants = np.concatenate(parts)
    instants = instants[instants < seconds - MIN_ROW_GAP_S]
    return np.append(instants, seconds)


def _rows_after(rows_s: FloatArray, spent_s: float) -> FloatArray:
    """Rows still to come, counted from `spent_s`; the last one is kept however near it is."""
    later = rows_s[rows_s > spent_s + MIN_ROW_GAP_S] - spent_s
    left = rows_s[-1] - spent_s
    if later.size or left < 1e-6:
        return later
    return np.array([left])


class VirtualTester:
    """Runs steps on a cell within a voltage window and records rows.

    Parameters
    ----------
    cell : PhysicsCell
    lower_V, upper_V : float    window; no step leaves it except for the regulator's first ms [V]
    """

    def __init__(self, cell: PhysicsCell, lower_V: float, upper_V: float) -> None:
        self._cell = cell
        self._lower_V = lower_V
        self._upper_V = upper_V
        self._clock_s = 0.0
        self._step = 0
        self._rows: list[tuple[float, float, float, float, int]] = []

    def start_recording(self) -> None:
        """Forget what was recorded, zero clock and step counter, record the present state."""
        self._clock_s = 0.0
        cell = self._cell
        self._rows = [(0.0, cell.voltage_V, cell.temperature_C, cell.charge_Ah, 1)]
        self._step = 0

    def run(self, steps: Iterable[Step]) -> None:
        """Carry out steps one after the other."""
        for step in steps:
            self._step += 1
            match step:
                case Rest(seconds, rows):
                    self._current(0.0, row_instants(rows, seconds), hold=False)
                case ConstantCurrent(current_A, rows, seconds, hold):
                    self._current(current_A, row_instants(rows, seconds), hold)
                case ConstantVoltage(sign, cutoff_A, rows, seconds):
                    self._voltage(sign, cutoff_A, row_instants(rows, seconds))
                case Profile(currents, period_s):
                    for value in currents:
                        self._current(float(value), np.array([period_s]), hold=True)

    def true_log(self) -> TrueLog:
        """Give the rows recorded since `start_recording`."""
        time, voltage, temperature, charge, step = np.array(self._rows, dtype=np.float64).T
        current = np.zeros_like(time)
        current[1:] = np.diff(charge) * 3600.0 / np.diff(time)
        return TrueLog(time, current, voltage, temperature, charge - charge[0], step)

    def _current(self, current_A: float, rows_s: FloatArray, hold: bool) -> None:
        """Constant current; at the limit either stop or hold the limit's voltage."""
        cell = self._cell
        stretch = cell.constant_current(current_A, rows_s, self._lower_V, self._upper_V)
        self._keep(stretch)
        if stretch.ended_by == "time" or not hold:
            return
        spent = float(stretch.time_s[-1]) if stretch.time_s.size else 0.0
        if not stretch.time_s.size:
            within = cell.current_within(current_A, self._lower_V, self._upper_V)
            self._unlogged(within)
            spent = REGULATOR_DELAY_S
        self._hold_limit(float(np.sign(current_A)), rows_s, spent)

    def _hold_limit(self, sign: float, rows_s: FloatArray, spent: float) -> None:
        """Hold the limit for the rest of a pulse; never let the current change its direction."""
        remaining = _rows_after(rows_s, spent)
        if remaining.size:
            held = self._voltage(sign, 0.0, remaining)
            remaining = _rows_after(remaining, held)
        if remaining.size:
            self._keep(self._cell.constant_current(0.0, remaining, self._lower_V, self._upper_V))

    def _voltage(self, sign: float, cutoff_A: float, rows_s: FloatArray) -> float:
        """Constant voltage at the limit; returns how long it lasted [s]."""
        limit = self._lower_V if sign > 0 else self._upper_V
        stretch = self._cell.constant_voltage(limit, rows_s, sign, cutoff_A)
        self._keep(stretch)
        return float(stretch.time_s[-1]) if stretch.time_s.size else 0.0

    def _unlogged(self, current_A: float) -> None:
        """Let a current flow until the regulator has settled; too short for a row."""
        rows = np.array([REGULATOR_DELAY_S])
        self._cell.constant_current(current_A, rows, FAR_BELOW_V, FAR_ABOVE_V)
        self._clock_s += REGULATOR_DELAY_S

    def _keep(self, stretch: Stretch) -> None:
        """Append rows; a row that follows its forerunner within the minimum gap replaces it."""
        for time, voltage, temperature, charge in zip(*stretch[:4], strict=True):
            row = (self._clock_s + time, voltage, temperature, charge, self._step)
            if self._rows and len(self._rows) > 1 and row[0] - self._rows[-1][0] < MIN_ROW_GAP_S:
                self._rows[-1] = row
            else:
                self._rows.append(row)
        if stretch.time_s.size:
            self._clock_s += float(stretch.time_s[-1])
