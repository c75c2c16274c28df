"""Rests, stuck channels, resolution and saturation of a log."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.logs.measured_log import MeasuredLog
from cellwise.typing import BoolArray, FloatArray

REST_OF_LARGEST = 0.005
COARSE_REST_OF_LARGEST = 0.02
LEAST_REST_S = 60.0
STUCK_ROWS = 20
STUCK_MOVES = 10
STUCK_MOVE_OF_RANGE = 0.1
SATURATED_RUN = 3
SATURATED_VISITS = 3
RESOLUTION_SAMPLE = 200_000
WHOLE_STEPS = 0.95
LEAST_DISTINCT = 20
DECIMAL_PLACES = 9


class Rest(NamedTuple):
    """A time without current: where it starts, its length, the voltage at its end."""

    start_s: float
    duration_s: float
    voltage_V: float


class Stretch(NamedTuple):
    """A part of the log during which a channel did something."""

    start_s: float
    duration_s: float


class Saturation(NamedTuple):
    """A channel held at its largest or smallest value again and again."""

    value: float
    share: float
    visits: int


def is_quiet(log: MeasuredLog) -> BoolArray:
    """Rows whose interval is without current, shape (n,).

    Current counts as none up to 0.5 % of the log's largest; where it is read no finer than that,
    up to its last digit, but never above 2 %.
    """
    current = np.abs(log.known_current_A())
    largest = float(np.max(current))
    digit = min(1.5 * (resolution(log.current_A) or 0.0), COARSE_REST_OF_LARGEST * largest)
    quiet: BoolArray = current <= max(REST_OF_LARGEST * largest, digit)
    return quiet


def find_rests(log: MeasuredLog) -> list[Rest]:
    """Times of at least a minute without current; a gap ends a rest."""
    first, last = _runs(is_quiet(log) & ~log.gap_rows)
    begins = np.maximum(first - 1, 0)  # the interval that ends at the first quiet row is at rest
    duration_s = log.time_s[last] - log.time_s[begins]
    return [
        Rest(float(log.time_s[a]), float(seconds), float(log.voltage_V[b]))
        for a, b, seconds in zip(begins, last, duration_s, strict=True)
        if seconds >= LEAST_REST_S
    ]


def resolution(values: FloatArray) -> float | None:
    """Step between values that a channel can show; None where they are on no grid.

    The smallest difference between values that occur, if there are many and nearly all differences
    are its multiples; else the last decimal place in which values were written.
    """
    finite = values[np.isfinite(values)]
    if finite.size > RESOLUTION_SAMPLE:
        finite = finite[:: -(-finite.size // RESOLUTION_SAMPLE)]
    distinct = np.unique(finite)
    if distinct.size < 3:
        return None
    steps = np.diff(distinct)
    smallest = float(np.min(steps[steps > 1e-9 * np.max(np.abs(distinct))], initial=np.inf))
    multiples = steps / smallest
    whole = np.mean(np.abs(multiples - np.round(multiples)) < 0.05) >= WHOLE_STEPS
    if whole and distinct.size >= LEAST_DISTINCT:
        return float(f"{smallest:.4g}")
    for place in range(DECIMAL_PLACES):
        scaled = distinct * 10.0**place
        if np.max(np.abs(scaled - np.round(scaled))) < 1e-4:
            return float(10.0**-place)
    return None


def find_stuck(log: MeasuredLog) -> dict[str, Stretch]:
    """Channels that stood still while the other one moved to and fro.

    A voltage held by the tester stands still too, but the current then only dies away; a constant
    current stands still, but the voltage under it only drifts.
    """
    found = {}
    for name, held, other in (
        ("voltage_V", log.voltage_V, log.current_A),
        ("current_A", log.current_A, log.voltage_V),
    ):
        stretch = _longest_standstill(log.time_s, held, other)
        if stretch is not None:
            found[name] = stretch
    return found


def stuck_voltage(log: MeasuredLog) -> Stretch | None:
    """The longest time for which the voltage stood still while the current moved; None: never.

    Of a voltage that never moves, any current that does is enough.
    """
    voltage = log.voltage_V
    lowest, highest = np.fmin.reduce(voltage), np.fmax.reduce(voltage)
    if lowest == highest and len(log) > STUCK_ROWS:
        moves = np.fmax.reduce(log.current_A) > np.fmin.reduce(log.current_A)
        return Stretch(float(log.time_s[0]), log.duration_s) if moves else None
    return _longest_standstill(log.time_s, voltage, log.current_A)


def _longest_standstill(time_s: FloatArray, held: FloatArray, other: FloatArray) -> Stretch | None:
    jump = STUCK_MOVE_OF_RANGE * float(np.fmax.reduce(other) - np.fmin.reduce(other))
    if jump == 0.0:
        return None
    first, last = _runs(np.diff(held, prepend=np.nan) == 0.0)
    long = last - first + 1 >= STUCK_ROWS
    if not long.any():
        return None
    first, last = first[long], last[long]
    change = np.diff(other, prepend=other[0])
    moves = np.minimum(
        _count_within(change > jump, first, last), _count_within(change < -jump, first, last)
    )
    stuck = moves >= STUCK_MOVES
    if not stuck.any():
        return None
    begins = time_s[np.maximum(first - 1, 0)][stuck]
    duration_s = time_s[last][stuck] - begins
    longest = int(np.argmax(duration_s))
    return Stretch(float(begins[longest]), float(duration_s[longest]))


def find_saturations(log: MeasuredLog) -> dict[str, Saturation]:
    """Channels that come to exactly their largest or smallest value for several rows, repeatedly.

    A sensor at the end of its range does this, and a tester at its limit.
    """
    found = {}
    for name, values in (("current_A", log.current_A), ("voltage_V", log.voltage_V)):
        for end, extreme in (("max", np.nanmax(values)), ("min", np.nanmin(values))):
            at_end = values == extreme
            first, last = _runs(at_end)
            visits = int(np.count_nonzero(last - first + 1 >= SATURATED_RUN))
            if visits >= SATURATED_VISITS and extreme != 0.0:
                share = float(np.count_nonzero(at_end)) / len(log)
                found[f"{name}_{end}"] = Saturation(float(extreme), share, visits)
    return found


def _count_within(
    flags: BoolArray, first: NDArray[np.intp], last: NDArray[np.intp]
) -> NDArray[np.intp]:
    """How often a flag is set in each of some runs of rows."""
    edges = np.column_stack((first, last + 1)).ravel()
    counted = np.add.reduceat(np.append(flags, False), edges, dtype=np.intp)
    return counted[::2]


def _runs(flags: BoolArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last row of every run of True."""
    edges = np.diff(np.concatenate(([False], flags, [False])).astype(np.int8))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
