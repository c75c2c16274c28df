"""Half cycles of a log: the stretches from full to empty and from empty to full.

They are the turning points of the counted charge, with a threshold, so a pulse, a dither at the
limit or a rest in between does not end one. Logs that follow one another (discharge in one file,
its last per cent in the next) are joined first: the charge goes on where the last log stopped.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.errors import InputError
from cellwise.identify.hppc.phases import filled
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray


class _HalfCycleLimits(NamedTuple):
    """What a half cycle is; all are shares."""

    turn: float = 0.1  # of the whole movement: less is a pulse, not a new half cycle
    steady: float = 0.1  # of the main current: rows within it are at it
    dither: float = 0.005  # of a half cycle: what a tester moves back at a limit
    run: float = 0.02  # of its charge: a shorter run at the main current is met in passing
    whole: float = 0.5  # of the largest: what moves less is a part


LIMITS = _HalfCycleLimits()


class CapacityTrace(NamedTuple):
    """One log, or several that follow one another, as plain columns.

    charge_Ah : (n,) removed since the first row; intervals between logs move nothing
    current_A, interval_s : (n,) of the interval that ends at each row
    voltage_V : (n,) missing values filled from their neighbours
    temperature_C : (n,) nan where not measured
    log : (n,) number of the log that the row comes from
    """

    charge_Ah: FloatArray
    current_A: FloatArray
    interval_s: FloatArray
    voltage_V: FloatArray
    temperature_C: FloatArray
    log: NDArray[np.intp]


class HalfCycle(NamedTuple):
    """Rows ``start`` to ``stop`` (not included) of a trace that move charge one way on the whole.

    main_current_A : the current at which half of the charge has flowed, from small to large [A]
    steady_start, steady_stop : first row at the main current, row after the last one, moments in
        passing left out; the first may lie before ``start`` by what a coarse counter hides
    end : last row before the next half cycle's current, where a dither at the limit has settled;
        the last row where charge came back by more than a dither would
    charge_Ah : from before the main current to ``end``: removed, or negative for brought back
    """

    start: int
    stop: int
    main_current_A: float
    steady_start: int
    steady_stop: int
    end: int
    charge_Ah: float

    @property
    def begin(self) -> int:
        """Last row before the main current flows."""
        return max(self.steady_start - 1, 0)

    def at_main_current(self, trace: CapacityTrace) -> BoolArray:
        """Rows of the trace at its main current, shape (n,)."""
        near_A = LIMITS.steady * abs(self.main_current_A)
        rows = np.abs(trace.current_A - self.main_current_A) <= near_A
        rows[: self.steady_start] = rows[self.steady_stop :] = False
        return rows


def join_logs(logs: CellLog | Sequence[CellLog]) -> CapacityTrace:
    """Columns of one log, or of several that follow one another on the same cell.

    Between two logs the cell is taken to rest: nothing flows from the last row of one to the first
    row of the next.

    Raises
    ------
    InputError        no log
    """
    parts = [logs] if isinstance(logs, CellLog) else list(logs)
    if not parts:
        raise InputError("no log", "at least one log", "Name the log of the test.")
    charge, before = [], 0.0
    for part in parts:
        charge.append(before + part.counted_charge_Ah())
        before = float(charge[-1][-1])
    warm = [p.temperature_C for p in parts]
    return CapacityTrace(
        charge_Ah=np.concatenate(charge),
        current_A=np.concatenate([part.known_current_A() for part in parts]),
        interval_s=np.concatenate([part.interval_s for part in parts]),
        voltage_V=np.concatenate([filled(part.voltage_V) for part in parts]),
        temperature_C=np.concatenate(
            [np.full(len(p), np.nan) if t is None else t for p, t in zip(parts, warm, strict=True)]
        ),
        log=np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
    )


def find_half_cycles(trace: CapacityTrace) -> tuple[HalfCycle, ...]:
    """Stretches between the turning points of the counted charge."""
    charge = trace.charge_Ah
    turns = _turning_rows(charge, LIMITS.turn * float(np.ptp(charge)))
    found = [h for a, b in pairwise(turns) if (h := _half_cycle(trace, a + 1, b + 1)) is not None]
    halves = []
    for k, half in enumerate(found):
        end = half.end
        later = charge.size - 1 if k + 1 == len(found) else found[k + 1].begin
        if later >= end and abs(charge[end] - charge[later]) <= LIMITS.dither * abs(half.charge_Ah):
            end = later
        moved = float(charge[end] - charge[half.begin])
        halves.append(half._replace(end=end, charge_Ah=moved))
    return tuple(halves)


def discharge_rows(log: CellLog) -> BoolArray:
    """Rows of the first whole discharge of a log, from the row before it to its lowest voltage.

    Whole is one that moves at least half of what the largest does. Shape (n,); all False without.
    """
    trace = join_logs(log)
    down = [h for h in find_half_cycles(trace) if h.charge_Ah > 0.0]
    most = max((h.charge_Ah for h in down), default=0.0)
    rows = np.zeros(len(log), dtype=np.bool_)
    for half in [h for h in down if h.charge_Ah >= LIMITS.whole * most][:1]:
        lowest = int(np.argmin(trace.voltage_V[half.begin : half.steady_stop]))
        rows[half.begin : half.begin + lowest + 1] = True
    return rows


def _half_cycle(trace: CapacityTrace, start: int, stop: int) -> HalfCycle | None:
    moved = float(trace.charge_Ah[stop - 1] - trace.charge_Ah[start - 1])
    current = trace.current_A[start:stop]
    share = np.maximum(current * np.sign(moved), 0.0) * trace.interval_s[start:stop]
    if share.sum() <= 0.0:
        return None
    order = np.argsort(np.abs(current))
    main = float(current[order[np.searchsorted(np.cumsum(share[order]), 0.5 * share.sum())]])
    # Runs at the main current that move a noticeable charge: a dither at the limit passes through
    # it too, for moments.
    near_A = LIMITS.steady * abs(main)
    steady = np.abs(current - main) <= near_A
    runs = np.flatnonzero(np.diff(np.concatenate(([False], steady, [False])))).reshape(-1, 2)
    flow = np.append(0.0, np.cumsum(share))
    large = runs[flow[runs[:, 1]] - flow[runs[:, 0]] >= LIMITS.run * flow[-1]]
    first, last = (large if large.size else runs)[[0, -1], [0, 1]].tolist()
    begin = start + first
    while first == 0 and begin > 0 and abs(trace.current_A[begin - 1] - main) <= near_A:
        begin -= 1
    return HalfCycle(start, stop, main, begin, start + last, stop - 1, moved)


def _turning_rows(charge: FloatArray, threshold: float) -> list[int]:
    """Rows at which the charge turns by more than the threshold, with both ends of the movement."""
    if threshold <= 0.0:
        return []
    turns: list[int] = []
    high = low = 0
    direction = 0
    for k, q in enumerate(charge.tolist()):
        if q > charge[high]:
            high = k
        if q <= charge[low]:
            low = k
        if direction >= 0 and charge[high] - q > threshold:
            turns.append(high)
            direction, low = -1, k
        elif direction <= 0 and q - charge[low] > threshold:
            turns.append(low)
            direction, high = 1, k
    if direction:
        turns.append(high if direction > 0 else low)
    return turns
