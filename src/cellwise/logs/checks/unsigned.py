"""A current without a sign, and a time in another unit: by what the voltage does under one load."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.units import TYPICAL_V
from cellwise.logs.gaps import run_edges
from cellwise.notices import Code, Notice
from cellwise.typing import FloatArray
from cellwise.wording import Option

# What a stretch of one load is, and what it says.
UNDER_LOAD = 0.05  # of the largest current
LARGEST_STEP = 0.2  # of it, from row to row
LARGEST_JUMP_V = 0.05  # of the voltage at once
FEWEST_ROWS = 10
ONSET_V = 0.004  # by which the voltage moves where a stretch begins or ends
SLOPE_V = 0.01  # by which it moves while the current stays within DRIFT
DRIFT = 0.05
LARGE = 0.03  # share of the charge that a stretch moves
BOTH_WAYS = 0.05  # share of the charge, at least, where there is no sign
MOST_UNKNOWN = 0.02  # share of the charge that is not clear where the voltage can give the sign
EMPTIED = 0.15  # of its voltage that a cell loses under one load too fast: another unit of time
PART_OF_LOG = 0.1  # at least, in which it does
SHORTEST_S = 60.0  # in which a cell is emptied
LONGEST_S = 1000.0  # of such a log


def loads_of(log: CellLog) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last rows of the stretches of one load of a log."""
    current, voltage = _size(log), log.voltage_V
    under = (current > UNDER_LOAD * np.max(current)) & np.isfinite(voltage) & ~log.gap_rows
    jump = np.abs(np.diff(voltage, prepend=voltage[0]))
    usual = float(np.nanmedian(jump[1:]))
    new = np.abs(np.diff(current, prepend=current[0])) > LARGEST_STEP * np.max(current)
    new |= jump > max(LARGEST_JUMP_V * _scale(log), 20.0 * usual)
    first, last = run_edges(under & ~new)
    first = np.maximum(first - (under & new)[np.maximum(first - 1, 0)], 0)
    long = last - first + 1 >= FEWEST_ROWS
    return first[long], last[long]


def _size(log: CellLog) -> FloatArray:
    return np.abs(np.nan_to_num(log.known_current_A()))


def _scale(log: CellLog) -> float:
    """Cells that the voltage is of, one at least."""
    return max(log.typical_voltage_V / TYPICAL_V, 1.0)


def _direction(log: CellLog, current: FloatArray, first: int, last: int) -> float:
    """1 discharge, -1 charge by two of three: where a load begins, goes on, and ends; else 0."""
    voltage, rows, scale = log.voltage_V, len(log), _scale(log)
    near = DRIFT * float(np.max(current))
    inner = first + 1
    other = np.flatnonzero(np.abs(current[inner : last + 1] - current[inner]) > near)
    end = last if other.size == 0 else inner + int(other[0]) - 1  # while it stays the same

    def says(change: float, least: float) -> float:
        return -float(np.sign(change)) if abs(change) > least * scale else 0.0

    total = says(voltage[end] - voltage[inner], SLOPE_V) if end > inner + 2 else 0.0
    if first > 0 and current[first - 1] < current[inner] + near:
        total += says(voltage[inner] - voltage[first - 1], ONSET_V)
    after = min(last + 2, rows - 1)
    if last < after and current[after] < current[last] - near:
        total += says(voltage[last] - voltage[after], ONSET_V)
    return float(np.sign(total)) if abs(total) >= 2.0 else 0.0


def signed_by_loads(log: CellLog) -> tuple[FloatArray | None, Notice | None]:
    """A current that has no sign with the one that the voltage gives it, and a notice.

    The voltage rises under some loads and falls under others, and all have one sign: None and
    no notice where this is not so. None with a notice where some loads are not clear.
    """
    current = log.current_A
    loaded = np.abs(current) > UNDER_LOAD * np.nanmax(np.abs(current), initial=0.0)
    ways = [np.count_nonzero(loaded & (current > 0)), np.count_nonzero(loaded & (current < 0))]
    if min(ways) > 0.001 * sum(ways) or sum(ways) < FEWEST_ROWS:
        return None, None
    size = _size(log)
    counted = np.cumsum(size * log.interval_s) / 3600.0
    moved = float(counted[-1])
    firsts, lasts = loads_of(log)
    charge = counted[lasts] - counted[np.maximum(firsts - 1, 0)]
    long = charge > LARGE * moved
    firsts, lasts, charge = firsts[long], lasts[long], charge[long]
    ways_of = np.array([_direction(log, size, a, b) for a, b in zip(firsts, lasts, strict=True)])
    out, back = (float(charge[ways_of == way].sum()) for way in (1.0, -1.0))
    if min(out, back) < BOTH_WAYS * moved:
        return None, None
    flows = (
        f"{out:.3g} Ah flow while the voltage falls and {back:.3g} Ah while it rises, all of one "
        "sign"
    )
    if moved - out - back > MOST_UNKNOWN * moved:
        way_out = "Export it with its sign, or with a column of the tester's states"
        text = f"the current LOOKS WRONG: it has no sign: {flows}. {way_out}"
        return None, Notice(Code.NO_SIGN, text)
    edges = np.append(firsts[1:], len(log))
    sign = np.full(len(log), ways_of[0] or 1.0)
    for way, first, end in zip(ways_of, firsts, edges, strict=True):
        sign[first:end] = way or 1.0
    text = f"the current has no sign, the voltage gave it one ({flows})"
    return sign * np.abs(current), Notice(Code.SIGN_BY_VOLTAGE, text)


def emptied_too_fast(log: CellLog) -> list[Notice]:
    """A notice of a cell that one load empties within seconds: the time is in another unit."""
    if log.duration_s > LONGEST_S or len(log) < 2 * FEWEST_ROWS:
        return []
    voltage, current = log.voltage_V, np.abs(log.current_A)
    for first, last in zip(*loads_of(log), strict=True):
        seconds = float(log.time_s[last] - log.time_s[first])
        moved = abs(float(voltage[last] - voltage[first + 1]))
        part = current[first : last + 1]
        if (
            PART_OF_LOG * log.duration_s < seconds < SHORTEST_S
            and moved > EMPTIED * log.typical_voltage_V
            and np.ptp(part) <= 2.0 * DRIFT * np.mean(part)
        ):
            text = (
                f"the time LOOKS WRONG: the voltage goes from {voltage[first + 1]:.2f} to "
                f"{voltage[last]:.2f} V within {seconds:.3g} s of one load, as of a cell that is "
                "empty so soon; is it in hours or minutes ("
            )
            said = (text, Option("channels", ("time_h", "COLUMN")), ")?")
            return [Notice(Code.TIME_UNIT, said, rows=range(int(first), int(last) + 1))]
    return []
