"""Half cycles of a log: the stretches from full to empty and from empty to full.

They are the turning points of the counted charge, with a threshold, so a pulse, a dither at the
limit or a rest in between does not end one. Logs that follow one another (discharge in one file,
its last per cent in the next) are joined first: the charge goes on where the last log stopped.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.errors import InputError
from cellwise.identify.hppc.phases import filled
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray


class _Limits(NamedTuple):
    """What a half cycle is; all are shares."""

    turn: float = 0.1  # of the whole movement: less is a pulse, not a new half cycle
    steady: float = 0.1  # of the main current: rows within it are at it
    dither: float = 0.005  # of a half cycle: what a tester moves back at a limit
    run: float = 0.02  # of its charge: a shorter run at the main current is met in passing


class _End(NamedTuple):
    """What shows the end of a discharge where the limit is not given."""

    knee: float = 1.3  # slope over the last 3 % over that of the middle
    round_V: float = 0.1  # limits are set to a multiple of it ...
    tolerance_V: float = 0.004  # ... and met within it


LIMITS, END = _Limits(), _End()


class Trace(NamedTuple):
    """One log, or several that follow one another, as plain columns.

    charge_Ah : (n,) removed since the first row; intervals between logs move nothing
    current_A, interval_s : (n,) of the interval that ends at each row
    voltage_V : (n,) missing values filled from their neighbours
    temperature_C : (n,) nan where not measured
    log : (n,) number of the log that the row comes from
    row : (n,) row in that log
    """

    charge_Ah: FloatArray
    current_A: FloatArray
    interval_s: FloatArray
    voltage_V: FloatArray
    temperature_C: FloatArray
    log: NDArray[np.intp]
    row: NDArray[np.intp]


class HalfCycle(NamedTuple):
    """Rows ``start`` to ``stop`` (not included) of a trace that move charge one way on the whole.

    charge_Ah : removed (positive) or brought back (negative)
    main_current_A : the current at which half of the charge has flowed, from small to large [A]
    steady_start, steady_stop : first row at the main current, row after the last one, moments in
        passing left out; the first may lie before ``start`` by what a coarse counter hides
    """

    start: int
    stop: int
    charge_Ah: float
    main_current_A: float
    steady_start: int
    steady_stop: int


def join_logs(logs: CellLog | Sequence[CellLog]) -> Trace:
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
    charge, current, interval, before = [], [], [], 0.0
    for part in parts:
        counted = part.counted_charge_Ah()
        charge.append(before + counted)
        before += float(counted[-1])
        interval.append(part.interval_s)
        current.append(part.known_current_A())
    return Trace(
        charge_Ah=np.concatenate(charge),
        current_A=np.concatenate(current),
        interval_s=np.concatenate(interval),
        voltage_V=np.concatenate([filled(part.voltage_V) for part in parts]),
        temperature_C=np.concatenate(
            [
                np.full(len(part), np.nan) if part.temperature_C is None else part.temperature_C
                for part in parts
            ]
        ),
        log=np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
        row=np.concatenate([np.arange(len(part)) for part in parts]),
    )


def find_half_cycles(trace: Trace) -> tuple[HalfCycle, ...]:
    """Stretches between the turning points of the counted charge."""
    turns = _turning_rows(trace.charge_Ah, LIMITS.turn * float(np.ptp(trace.charge_Ah)))
    found = (_half_cycle(trace, a + 1, b + 1) for a, b in itertools.pairwise(turns))
    return tuple(h for h in found if h is not None)


def steady_rows(trace: Trace, half: HalfCycle) -> BoolArray:
    """Rows of a half cycle at its main current, shape (stop - start,)."""
    current = trace.current_A[half.start : half.stop]
    return np.abs(current - half.main_current_A) <= LIMITS.steady * abs(half.main_current_A)


def _steady_span(steady: BoolArray, share: FloatArray) -> tuple[int, int]:
    """First and past-the-last row of the runs at the main current that move a noticeable charge.

    A dither at the limit passes through the main current too, for moments.
    """
    change = np.flatnonzero(np.diff(np.concatenate(([False], steady, [False]))))
    flow = np.append(0.0, np.cumsum(share))
    runs = [(int(a), int(b)) for a, b in change.reshape(-1, 2)]
    large = [(a, b) for a, b in runs if flow[b] - flow[a] >= LIMITS.run * flow[-1]] or runs
    return large[0][0], large[-1][1]


def discharge_rows(log: CellLog) -> BoolArray:
    """Rows of the first whole discharge of a log, from the row before it to its lowest voltage.

    Whole: at least half of what the largest one of the log moves. Shape (n,); all False without
    a discharge.
    """
    trace = join_logs(log)
    down = [h for h in find_half_cycles(trace) if h.charge_Ah > 0.0]
    rows = np.zeros(len(log), dtype=np.bool_)
    if down:
        most = max(h.charge_Ah for h in down)
        half = next(h for h in down if h.charge_Ah >= 0.5 * most)
        first = max(half.steady_start - 1, 0)
        last = first + int(np.argmin(trace.voltage_V[first : half.steady_stop]))
        rows[first : last + 1] = True
    return rows


def settled_end(trace: Trace, halves: tuple[HalfCycle, ...], k: int) -> int:
    """Last row before the next half cycle's current, where a dither at the limit has settled.

    The half cycle's own last row where charge came back by more than a dither would.
    """
    last = halves[k].stop - 1
    end = trace.charge_Ah.size - 1 if k + 1 == len(halves) else halves[k + 1].steady_start - 1
    back = abs(float(trace.charge_Ah[last] - trace.charge_Ah[end]))
    return end if end >= last and back <= LIMITS.dither * abs(halves[k].charge_Ah) else last


def _is(current_A: float, main_A: float) -> bool:
    return abs(current_A - main_A) <= LIMITS.steady * abs(main_A)


def looks_like_end(trace: Trace, start: int, stop: int) -> bool:
    """Whether the discharge in rows start to stop ends as one does: bending down, or at a round V.

    For a lone test without given limits, where it is all there is. Of 49 measured discharges all
    pass; cut off at 80 % of their charge 29 are refused, at 60 % 34.
    """
    q, v = trace.charge_Ah[start:stop], trace.voltage_V[start:stop]
    if q.size < 2 or q[-1] <= q[0]:
        return False
    at_10, at_90, at_97 = np.interp((0.1, 0.9, 0.97), (q - q[0]) / (q[-1] - q[0]), v)
    bends = (at_97 - v[-1]) / 0.03 >= END.knee * (at_10 - at_90) / 0.8
    off_round = abs(float(v[-1]) - END.round_V * round(float(v[-1]) / END.round_V))
    return bool(bends or off_round <= END.tolerance_V)


def _half_cycle(trace: Trace, start: int, stop: int) -> HalfCycle | None:
    rows = slice(start, stop)
    moved = trace.charge_Ah[stop - 1] - trace.charge_Ah[start - 1]
    current, dt = trace.current_A[rows], trace.interval_s[rows]
    share = np.maximum(current * np.sign(moved), 0.0) * dt
    if share.sum() <= 0.0:
        return None
    order = np.argsort(np.abs(current))
    half_way = np.searchsorted(np.cumsum(share[order]), 0.5 * share.sum())
    main = float(current[order[half_way]])
    first, last = _steady_span(np.abs(current - main) <= LIMITS.steady * abs(main), share)
    earlier = 0
    while first == 0 and start > earlier and _is(trace.current_A[start - earlier - 1], main):
        earlier += 1
    return HalfCycle(
        start=start,
        stop=stop,
        charge_Ah=float(moved),
        main_current_A=main,
        steady_start=start + first - earlier,
        steady_stop=start + last,
    )


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
