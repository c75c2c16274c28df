"""Faults of a channel: values that no cell has, channels that stand still, stick, jump or are lost.

Each is separated from a cell, a load or a tester by what the other channel does meanwhile.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.units import IMPOSSIBLE_A, POSSIBLE_C
from cellwise.logs.gaps import RowRange, rows_between, run_edges, runs_of
from cellwise.typing import BoolArray, FloatArray

# What no cell and no load can have had, by what the rest of the log shows.
ABOVE = 2.0  # of the usual voltage: no chemistry is charged to twice of it
BELOW = 0.4  # of the usual voltage: a cell is dead
FALL = 0.25  # of the usual voltage from row to row, by which a cell does not become so
CURRENT_TIMES = 20.0  # the largest of nearly all other currents
NEARLY_ALL = 95.0  # per cent of them
FOLLOWED = 3.0  # times: how far the voltage steps at the edge of such a current, over elsewhere
MOST_IMPOSSIBLE = 0.25  # share of the rows: more are another unit or another battery, not a fault

# When a channel that repeats its value has stopped measuring, or is at the end of its range: while
# the other channel moves up and down.
REPEATS = 19
MOVES = 2  # of the other channel, each way
MOVED_SHARE = 0.1  # of what the other channel does in this log
LATE_S = 3.0  # what one channel shows of the other may come so much later, or earlier
LOST_ROWS = 20  # without a value: fewer are samples that were missed

# When a channel is at the end of its range.
HELD = 3  # rows in a row, and so often

# When a single row is a spike.
LEAST_SPIKE_V = 0.05
SPIKE_BENDS = 20.0  # usual ones
SPIKE_DROPS = 2.0  # of what the current did around


class FaultSegment(NamedTuple):
    """A part of the log during which a channel did something."""

    start_s: float
    duration_s: float

    def rows_of(self, log: CellLog) -> range:
        """Its rows."""
        return rows_between(log.time_s, self.start_s, self.start_s + self.duration_s)


def impossible_runs(log: CellLog) -> dict[str, list[RowRange]]:
    """Rows that are impossible, by channel; none where there are too many to be a fault."""
    found = {"voltage_V": _impossible_voltages(log), "current_A": _impossible_currents(log)}
    if log.temperature_C is not None:
        low, high = POSSIBLE_C
        found["temperature_C"] = (log.temperature_C < low) | (log.temperature_C > high)
    few = {name: bad for name, bad in found.items() if 0 < bad.sum() <= MOST_IMPOSSIBLE * len(log)}
    return {name: runs_of(bad) for name, bad in few.items()}


def possible_part(log: CellLog) -> CellLog:
    """The log with its impossible values missing; the log itself where there are none."""
    return without(log, impossible_runs(log))


def without(log: CellLog, runs: dict[str, list[RowRange]]) -> CellLog:
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


def _impossible_voltages(log: CellLog) -> BoolArray:
    voltage = log.voltage_V
    known = voltage[np.isfinite(voltage)]
    if known.size == 0 or not (usual := float(np.median(known))) > 0.0:
        return np.zeros(voltage.size, dtype=bool)
    bad = voltage > ABOVE * usual
    low = voltage < BELOW * usual
    if low.any():
        wrong = bad | low
        rest = replace(
            log,
            voltage_V=np.where(wrong, np.nan, voltage),
            current_A=np.where(wrong, 0.0, log.current_A),
        )
        loads = step_resistance(rest) * np.abs(_steps(log.known_current_A()))
        fell = -_steps(np.where(np.isnan(voltage), usual, voltage)) > FALL * usual + 2.0 * loads
        for first, last in runs_of(low):
            # From one row to the next, or from the first row of the log on.
            bad[first : last + 1] |= fell[first] or (first == 0 and last < voltage.size - 1)
    return np.asarray(bad)


def _impossible_currents(log: CellLog) -> BoolArray:
    size = np.abs(log.current_A)
    finite = size[np.isfinite(size)]
    bad = np.zeros(size.size, dtype=bool)
    if finite.size == 0:
        return bad
    usual = float(np.percentile(finite, NEARLY_ALL))
    others = float(np.max(finite[finite <= CURRENT_TIMES * usual], initial=0.0))
    bad = size > (CURRENT_TIMES * others if others > 0.0 else IMPOSSIBLE_A)
    if not bad.any():
        return bad
    runs, late = runs_of(bad), _late_rows(log)
    moved = np.abs(np.nan_to_num(_steps(log.voltage_V)))
    elsewhere = np.ones(size.size, dtype=bool)
    for first, last in runs:
        elsewhere[first : last + late + 1] = False
    largest = float(np.max(moved[elsewhere], initial=0.0))
    for first, last in runs:
        followed = np.max(moved[first : first + late + 1]) > FOLLOWED * largest
        bad[first : last + 1] = size[first] > IMPOSSIBLE_A or not followed
    return np.asarray(bad)


def stuck_runs(log: CellLog) -> dict[str, list[RowRange]]:
    """Rows in which a channel stood still while the other one moved to and fro, by channel.

    A voltage held by the tester stands still too, but the current then only dies away; a constant
    current stands still, but the voltage under it only drifts.
    """
    found = {"voltage_V": stuck_voltage(log), "current_A": _stuck_current(log)}
    return {name: runs for name, runs in found.items() if runs}


def longest(log: CellLog, runs: list[RowRange]) -> FaultSegment | None:
    """The longest time of some runs of rows; None of none."""
    times = [(float(log.time_s[max(r.first - 1, 0)]), float(log.time_s[r.last])) for r in runs]
    stretches = [FaultSegment(begins, ends - begins) for begins, ends in times]
    return max(stretches, key=lambda s: s.duration_s, default=None)


def stuck_voltage(log: CellLog) -> list[RowRange]:
    """Rows in which the voltage stood still while the current moved to and fro."""
    still = _standstills(log.voltage_V)
    return _moved(still, log.current_A, MOVED_SHARE * _swing(log.current_A)) if still else []


def _stuck_current(log: CellLog) -> list[RowRange]:
    """Rows in which the current stood still while the voltage moved to and fro.

    The load before or after a rest is still in a voltage, or already, that is logged late or early.
    """
    still = _standstills(log.current_A)
    if not still:
        return []
    voltage = np.array(log.voltage_V)
    voltage[find_spikes(log)] = np.nan  # no current makes those
    return _moved(still, voltage, _current_jump(log), _late_rows(log))


def _standstills(values: FloatArray) -> list[RowRange]:
    """Rows that repeat the value before them, many of them."""
    first, last = run_edges(np.diff(values, prepend=np.nan) == 0.0)
    long = last - first + 1 >= REPEATS
    return [RowRange(int(a), int(b)) for a, b in zip(first[long], last[long], strict=True)]


def _moved(runs: list[RowRange], other: FloatArray, jump: float, late: int = 0) -> list[RowRange]:
    """The runs in which the other channel moves both ways by more than ``jump`` so often.

    So often also without what ``late`` rows show at one end, whichever: they may be the load there.
    """
    if not runs or jump == 0.0:
        return []
    change = _steps(other)
    counts = [np.cumsum(change > jump), np.cumsum(change < -jump)]
    first, last = np.array(runs).T
    ends = (np.minimum(first - 1 + late, last), last), (first - 1, np.maximum(last - late, first))
    moves = np.min([c[b] - c[a] for a, b in ends for c in counts], axis=0)
    return [run for run, enough in zip(runs, moves >= MOVES, strict=True) if enough]


def clipped_runs(log: CellLog) -> dict[str, list[RowRange]]:
    """Rows at which a sensor is at its end while the other one shows that the truth moves on.

    A tester at its limit stands there, too, but then the voltage only drifts, or the current dies
    away.
    """
    others = {
        "current_A": (log.voltage_V, _current_jump(log)),
        "voltage_V": (log.current_A, MOVED_SHARE * _swing(log.current_A)),
    }
    runs: dict[str, list[RowRange]] = {}
    for channel, (other, jump) in others.items():
        values = getattr(log, channel)
        change = np.diff(other, prepend=np.nan)
        for extreme in (np.nanmax(values), np.nanmin(values)):
            at_end = values == extreme
            first, last = run_edges(at_end)
            visits = np.count_nonzero(last - first + 1 >= HELD)
            inside = at_end & np.concatenate(([False], at_end[:-1]))
            moves = min(np.sum(change[inside] > jump), np.sum(change[inside] < -jump))
            held = visits >= HELD and extreme != 0.0
            if held and moves >= MOVES and jump > 0.0:
                runs[channel] = sorted([*runs.get(channel, []), *runs_of(at_end)])
    return runs


def find_spikes(log: CellLog) -> NDArray[np.intp]:
    """Single rows whose voltage is far from both neighbours', further than the current explains.

    The current of some rows around counts, since a channel may be logged late.
    """
    v, i = log.voltage_V, log.known_current_A()
    late = _late_rows(log)
    if v.size < 2 * late + 3:
        return np.zeros(0, dtype=np.intp)
    before, after = np.zeros(v.size), np.zeros(v.size)
    before[1:-1], after[1:-1] = v[1:-1] - v[:-2], v[1:-1] - v[2:]
    bend = np.nan_to_num(0.5 * np.abs(before + after))
    # At a step, however late, a row is far from one neighbour only.
    nearer = np.minimum(np.abs(before), np.abs(after))
    away = np.nan_to_num(np.where(before * after > 0.0, nearer, 0.0))
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # slow to import

    moved = maximum_filter1d(i, 2 * late + 1) - minimum_filter1d(i, 2 * late + 1)
    usual = 1.48 * float(np.median(bend))
    least = max(LEAST_SPIKE_V, SPIKE_BENDS * usual)
    far = away > least + SPIKE_DROPS * step_resistance(log) * moved
    # Between two spikes the other way a row is far from both, too: the larger is one.
    alone = far[1:-1] & (away[1:-1] >= away[:-2]) & (away[1:-1] >= away[2:])
    return np.flatnonzero(alone) + 1


def lost_runs(log: CellLog) -> dict[str, list[RowRange]]:
    """Stretches of many rows without a value, by channel; of a temperature that most rows have."""
    missing = {"voltage_V": np.isnan(log.voltage_V), "current_A": np.isnan(log.current_A)}
    if log.temperature_C is not None:
        cold = np.isnan(log.temperature_C)
        if np.mean(cold) <= MOST_IMPOSSIBLE:
            missing["temperature_C"] = cold
    found = {}
    for name, rows in missing.items():
        many = [r for r in runs_of(rows) if r.last - r.first + 1 >= LOST_ROWS]
        if many:
            found[name] = many
    return found


def step_resistance(log: CellLog) -> float:
    """Size of the voltage's larger steps over that of the current's, at whatever delay [ohm]."""
    by_current, by_voltage = np.abs(np.diff(log.known_current_A())), np.abs(np.diff(log.voltage_V))
    known = by_voltage[np.isfinite(by_voltage)]
    if known.size == 0:
        return 0.0
    step_A = float(np.quantile(by_current, 0.98))
    if step_A < 1e-12:  # below it is no current
        return 0.0
    return float(np.quantile(known, 0.98)) / step_A


def _current_jump(log: CellLog) -> float:
    """A step of the voltage that only a current makes [V].

    The way from full to empty is no part of it.
    """
    swing = _swing(log.voltage_V)
    moved = min(swing, step_resistance(log) * _swing(log.current_A)) or swing
    return MOVED_SHARE * moved


def _swing(values: FloatArray) -> float:
    return float(np.fmax.reduce(values) - np.fmin.reduce(values))


def _late_rows(log: CellLog) -> int:
    """Rows that one channel may be late by."""
    steps = np.diff(log.time_s)
    usual = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else LATE_S
    return math.ceil(LATE_S / usual)


def _steps(values: FloatArray) -> FloatArray:
    return np.diff(values, prepend=values[:1])
