"""Rows whose value no cell and no load can have had, by what the rest of the log shows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from cellwise.logs.checks.oddities import LATE_ROWS, Run, runs_of, step_resistance
from cellwise.logs.checks.units import IMPOSSIBLE_CELL_CURRENT_A, POSSIBLE_C
from cellwise.logs.measured_log import MeasuredLog
from cellwise.typing import BoolArray, FloatArray

Log = TypeVar("Log", bound=MeasuredLog)

# Of the usual voltage: no chemistry is charged to twice of it, and below so much of it a cell is
# dead, which it does not become from one row to the next.
HIGHEST, LOWEST, FALL = 2.0, 0.4, 0.25
# A current so many times the largest of all others, at whose edge the voltage steps hardly more
# than at others' (a charge transfer makes less than proportion of it).
LARGER, NEARLY_ALL, FOLLOWED = 20.0, 95.0, 3.0
# More rows than this are another unit or another battery, not a fault.
MOST_ROWS = 0.25


def impossible_runs(log: MeasuredLog) -> dict[str, list[Run]]:
    """Rows that are impossible, by channel; none where there are too many to be a fault."""
    found = {"voltage_V": _voltages(log), "current_A": _currents(log)}
    if log.temperature_C is not None:
        low, high = POSSIBLE_C
        found["temperature_C"] = (log.temperature_C < low) | (log.temperature_C > high)
    few = {name: bad for name, bad in found.items() if 0 < bad.sum() <= MOST_ROWS * len(log)}
    return {name: runs_of(bad) for name, bad in few.items()}


def possible_part(log: Log) -> Log:
    """The log with its impossible values missing; the log itself where there are none."""
    return without(log, impossible_runs(log))


def without(log: Log, runs: dict[str, list[Run]]) -> Log:
    """The log with the values of some rows missing."""
    if not runs:
        return log
    channels: dict[str, Any] = {}
    for name, rows in runs.items():
        values = np.array(getattr(log, name))
        for run in rows:
            values[run.first : run.last + 1] = np.nan
        channels[name] = values
    return replace(log, **channels)


def _voltages(log: MeasuredLog) -> BoolArray:
    voltage = log.voltage_V
    known = voltage[np.isfinite(voltage)]
    if known.size == 0 or not (usual := float(np.median(known))) > 0.0:
        return np.zeros(voltage.size, dtype=bool)
    bad = voltage > HIGHEST * usual
    low = voltage < LOWEST * usual
    if low.any():
        loads = step_resistance(_masked(log, bad | low)) * np.abs(_steps(log.known_current_A()))
        fell = -_steps(np.where(np.isnan(voltage), usual, voltage)) > FALL * usual + 2.0 * loads
        for first, last in runs_of(low):
            # From one row to the next, or from the first row of the log on.
            bad[first : last + 1] |= fell[first] or (first == 0 and last < voltage.size - 1)
    return np.asarray(bad)


def _currents(log: MeasuredLog) -> BoolArray:
    size = np.abs(log.current_A)
    finite = size[np.isfinite(size)]
    bad = np.zeros(size.size, dtype=bool)
    if finite.size == 0:
        return bad
    usual = float(np.percentile(finite, NEARLY_ALL))
    others = float(np.max(finite[finite <= LARGER * usual], initial=0.0))
    bad = size > (LARGER * others if others > 0.0 else IMPOSSIBLE_CELL_CURRENT_A)
    runs = runs_of(bad)
    moved = np.abs(np.nan_to_num(_steps(log.voltage_V)))
    apart = np.ones(size.size, dtype=bool)
    for first, last in runs:
        apart[first : last + LATE_ROWS + 1] = False
    largest = float(np.max(moved[apart], initial=0.0))
    for first, last in runs:
        followed = np.max(moved[first : first + LATE_ROWS + 1]) > FOLLOWED * largest
        bad[first : last + 1] = size[first] > IMPOSSIBLE_CELL_CURRENT_A or not followed
    return np.asarray(bad)


def _masked(log: Log, bad: BoolArray) -> Log:
    """The log without a voltage and a current in some rows."""
    return replace(
        log,
        voltage_V=np.where(bad, np.nan, log.voltage_V),
        current_A=np.where(bad, 0.0, log.current_A),
    )


def _steps(values: FloatArray) -> FloatArray:
    return np.diff(values, prepend=values[:1])
