"""The current sensor's offset in a low-rate test: what no cell can do says how far it is off.

A low-rate discharge and the charge that follows lead from full to empty and back to full. Where the
cell rests at the same voltage after as before, what it took it has given back, whatever the counter
says: the rest is offset times time. At C/20 ten milliamperes are a fifteenth of the current, and
a cell of 3.0 Ah seems to give 3.3 Ah and to take 2.8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.capacity.capacity_test import measure_capacities
from cellwise.identify.capacity.half_cycles import HalfCycle, Trace, find_half_cycles, join_logs
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray

# Coulombic losses, counters of unlike gain for the two directions and a charge without CV leave
# some per cent; an offset worth the name leaves more than this share of what was moved.
WORTH_NAMING = 0.04
# The two states must be one: the charge between their voltages, as a share of what was moved.
SAME_STATE = 0.05
# Slower than this a usual offset counts [1/h].
SLOW_RATE = 1.0 / 9.0
RESTED_S = 600.0
IDLE_OF_LOAD = 0.4
# A test at this rate [1/h] or slower takes nearly all out that a low rate does: it speaks for the
# offset where it says the corrected capacity within this share, and the counted one not.
SLOW_ENOUGH_RATE = 0.55
CONFIRMED = 0.05
# Part of the charge whose slope turns a missing voltage into charge.
END_OF_BRANCH = (0.95, 0.99)
# A sensor that reads this share of the offset at rest has it there too; a relay reads zero.
SEEN_AT_REST = 0.5


class CurrentOffset(NamedTuple):
    """What a low-rate test says of its current sensor.

    offset_A : what the sensor adds to the true current [A]
    out_Ah, back_Ah : counted charge of discharge and charge, both positive [Ah]
    capacity_Ah : of the discharge with the offset taken out [Ah]
    main_current_A : of the discharge or charge [A]
    at_rest : whether the sensor shows the offset without a load too
    """

    offset_A: float
    out_Ah: float
    back_Ah: float
    capacity_Ah: float
    main_current_A: float
    at_rest: bool


def find_current_offset(logs: Sequence[CellLog]) -> CurrentOffset | None:
    """Offset of the current sensor in a low-rate test, None where it shows none.

    Parameters
    ----------
    logs : sequence of CellLog        one low-rate test, or its parts in order

    Notes
    -----
    Between a rest and the rest after discharge and charge (or charge and discharge) the true
    net charge is what their difference of voltage says; what was counted beyond is offset times
    time.
    """
    if not logs:
        return None
    trace = join_logs(logs)
    pair = _slow_pair(trace)
    if pair is None:
        return None
    first, second = pair
    sign = 1.0 if first.charge_Ah > 0.0 else -1.0
    before, turn, after = max(first.steady_start - 1, 0), first.stop - 1, _settled(trace, second)
    charge = trace.charge_Ah
    missing = _missing_Ah(trace, first, second, before, after)
    moved = (abs(float(charge[turn] - charge[before])), abs(float(charge[after] - charge[turn])))
    if abs(missing) > SAME_STATE * max(moved):
        return None
    surplus = float(charge[after] - charge[before]) - sign * missing
    inside = np.zeros(charge.size, dtype=np.bool_)
    inside[before + 1 : after + 1] = True
    idle = _idle(trace.current_A, first.main_current_A)
    whole_h = float(np.sum(trace.interval_s[inside])) / 3600.0
    at_rest = whole_h > 0.0 and _reads_at_rest(trace.current_A[idle], surplus / whole_h)
    counted = inside if at_rest else inside & ~idle
    hours = float(np.sum(trace.interval_s[counted])) / 3600.0
    if hours <= 0.0 or abs(surplus) < WORTH_NAMING * 0.5 * sum(moved):
        return None
    offset = surplus / hours
    out, back = moved if sign > 0.0 else moved[::-1]
    rows = np.arange(charge.size)
    discharging = counted & ((rows <= turn) if sign > 0.0 else (rows > turn))
    capacity = out - offset * float(np.sum(trace.interval_s[discharging])) / 3600.0
    return CurrentOffset(offset, out, back, capacity, first.main_current_A, at_rest)


def without_current_offset(
    logs: Sequence[CellLog],
    capacity_logs: Sequence[CellLog] = (),
    *,
    nominal_Ah: float | None = None,
) -> tuple[tuple[CellLog, ...], tuple[str, ...]]:
    """Low-rate logs with their sensor's offset taken out, and what was found.

    Taken out only where something else says so too: the sensor's own reading at rest, or a capacity
    test at C/2 or slower. A faster test gets less out of the cell anyway.

    Parameters
    ----------
    logs : sequence of CellLog             one low-rate test, or its parts in order
    capacity_logs : sequence of CellLog    capacity tests of the same cell
    nominal_Ah : float or None

    Returns
    -------
    logs : tuple of CellLog       as given where nothing is taken out
    notices : tuple of str
    """
    found = find_current_offset(logs)
    if found is None:
        return tuple(logs), ()
    name = " + ".join(log.name or "a log" for log in logs)
    said = (
        f"the current sensor of '{name}' reads {1e3 * found.offset_A:+.1f} mA too much, it seems: "
        f"{found.out_Ah:.3f} Ah out and {found.back_Ah:.3f} Ah back between one state and the same "
        "again"
    )
    other = _confirming_Ah(capacity_logs, nominal_Ah)
    left = f"{found.capacity_Ah:.3f} Ah"
    if other is not None and abs(other / found.capacity_Ah - 1.0) <= CONFIRMED:
        why = f"a capacity test says {other:.3f} Ah"
    elif found.at_rest:
        why = "it reads as much at rest"
    else:
        seen = "" if other is None else f" (the test given says {other:.3f} Ah)"
        return tuple(logs), (
            f"{said}. Left as it is: without it {left} would be the capacity; confirm by a "
            f"capacity test at C/2 or slower{seen}",
        )
    return tuple(_corrected(log, found) for log in logs), (f"{said}. Taken out: {left}, and {why}",)


def _slow_pair(trace: Trace) -> tuple[HalfCycle, HalfCycle] | None:
    """The first slow half cycle that begins at rest, and the slow one back right after it."""
    halves = find_half_cycles(trace)
    for first, second in pairwise(halves):
        slow = all(abs(h.main_current_A) <= SLOW_RATE * abs(h.charge_Ah) for h in (first, second))
        if slow and first.charge_Ah * second.charge_Ah < 0.0 and first.steady_start > 0:
            return first, second
    return None


def _settled(trace: Trace, second: HalfCycle) -> int:
    """Last row of the rest after a half cycle; its last row under load where none follows."""
    busy = ~_idle(trace.current_A, second.main_current_A)
    later = np.flatnonzero(busy[second.stop :])
    return second.stop + int(later[0]) - 1 if later.size else trace.charge_Ah.size - 1


def _missing_Ah(
    trace: Trace, first: HalfCycle, second: HalfCycle, before: int, after: int
) -> float:
    """Charge by which the way back fell short of where the way out began [Ah].

    By the slope of the second branch at its end, where its polarisation no longer grows. Where no
    rest follows it, half the gap of the branches is taken off its last voltage.
    """
    steady = slice(second.steady_start, second.steady_stop)
    q = np.abs(trace.charge_Ah[steady] - trace.charge_Ah[second.steady_start])
    low, high = np.interp(q[-1] * np.array(END_OF_BRANCH), q, trace.voltage_V[steady])
    rested_s = float(np.sum(trace.interval_s[second.steady_stop : after + 1]))
    drop = 0.0 if rested_s >= RESTED_S else _half_gap(trace, first, second)
    sign = 1.0 if first.charge_Ah > 0.0 else -1.0
    short_V = sign * float(trace.voltage_V[before] - trace.voltage_V[after]) + drop
    width = (END_OF_BRANCH[1] - END_OF_BRANCH[0]) * float(q[-1])
    slope = max(sign * float(high - low), 1e-4) / max(width, 1e-9)
    return short_V / slope


def _half_gap(trace: Trace, first: HalfCycle, second: HalfCycle) -> float:
    """Half the gap between the branches at the middle of their own charge [V]."""
    middle = []
    for half in (first, second):
        rows = slice(half.steady_start, half.steady_stop)
        q = np.abs(trace.charge_Ah[rows] - trace.charge_Ah[half.steady_start])
        at = q[-1] * np.array([0.4, 0.5, 0.6])
        middle.append(float(np.median(np.interp(at, q, trace.voltage_V[rows]))))
    return 0.5 * abs(middle[1] - middle[0])


def _idle(current_A: FloatArray, main_A: float) -> BoolArray:
    """Rows without a load, whatever the sensor's zero reads."""
    return np.asarray(np.abs(current_A) < IDLE_OF_LOAD * abs(main_A))


def _reads_at_rest(reading_A: FloatArray, expected_A: float) -> bool:
    """Whether the sensor's zero shows the offset."""
    if reading_A.size == 0 or expected_A == 0.0:
        return False
    return bool(float(np.median(reading_A)) / expected_A > SEEN_AT_REST)


def _confirming_Ah(logs: Sequence[CellLog], nominal_Ah: float | None) -> float | None:
    """Capacity by the slowest complete test at C/2 or slower [Ah]."""
    if not logs:
        return None
    try:
        tests = measure_capacities(logs, nominal_Ah=nominal_Ah)
    except InputError:
        return None
    whole = [
        t
        for t in tests
        if t.complete and not t.cooled and t.current_A <= SLOW_ENOUGH_RATE * t.total_Ah
    ]
    return min(whole, key=lambda t: t.rate_C).total_Ah if whole else None


def _corrected(log: CellLog, found: CurrentOffset) -> CellLog:
    """The log without the offset, in its current and in its counter."""
    current = log.interval_current_A
    where = np.isfinite(current) & (found.at_rest | ~_idle(current, found.main_current_A))
    shift = np.where(where, found.offset_A, 0.0)
    charge = log.charge_Ah
    if charge is not None:
        charge = charge - np.cumsum(shift * log.interval_s) / 3600.0
    return replace(log, current_A=current - shift, charge_Ah=charge, current_meaning="interval_end")
