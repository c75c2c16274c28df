"""Rests of a log, and the step of a channel's last digit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.logs.measured_log import MeasuredLog
from cellwise.typing import BoolArray, FloatArray


class Quiet(NamedTuple):
    """Which share of the log's largest current is none: of a fine channel, of a coarse one.

    ``digits`` are those of the channel that a resting sensor may show; after ``least_s`` a voltage
    may be an open-circuit voltage.
    """

    fine: float = 0.005
    coarse: float = 0.02
    digits: float = 1.5
    least_s: float = 60.0


class Grid(NamedTuple):
    """Values on a grid: so many, this share of their differences multiples; rows that show it."""

    values: int = 20
    share: float = 0.95
    off: float = 0.05
    rows: int = 200_000


QUIET, GRID = Quiet(), Grid()


class Rest(NamedTuple):
    """A time without current: where it starts, its length, the voltage at its end."""

    start_s: float
    duration_s: float
    voltage_V: float


class Run(NamedTuple):
    """Rows from ``first`` to ``last``, both included."""

    first: int
    last: int


def is_quiet(log: MeasuredLog) -> BoolArray:
    """Rows whose interval is without current, shape (n,).

    Current counts as none up to 0.5 % of the log's largest; where it is read no finer than that,
    up to its last digit, but never above 2 %.
    """
    current = np.abs(log.known_current_A())
    largest = float(np.max(current))
    digit = min(QUIET.digits * (resolution(log.current_A) or 0.0), QUIET.coarse * largest)
    quiet: BoolArray = current <= max(QUIET.fine * largest, digit)
    return quiet


def find_rests(log: MeasuredLog) -> list[Rest]:
    """Times of at least a minute without current; a gap ends a rest."""
    first, last = run_edges(is_quiet(log) & ~log.gap_rows)
    begins = np.maximum(first - 1, 0)  # the interval that ends at the first quiet row is at rest
    duration_s = log.time_s[last] - log.time_s[begins]
    return [
        Rest(float(log.time_s[a]), float(seconds), float(log.voltage_V[b]))
        for a, b, seconds in zip(begins, last, duration_s, strict=True)
        if seconds >= QUIET.least_s
    ]


def resolution(values: FloatArray) -> float | None:
    """Step between values that a channel can show; None where they are on no grid.

    The smallest difference between values that occur, if there are many and nearly all differences
    are its multiples; else the last decimal place in which values were written.
    """
    finite = values[np.isfinite(values)]
    distinct = np.unique(finite[:: -(-finite.size // GRID.rows) or 1])
    if distinct.size < 3:
        return None
    steps = np.diff(distinct)
    smallest = float(np.min(steps[steps > 1e-9 * np.max(np.abs(distinct))], initial=np.inf))
    multiples = steps / smallest
    whole = np.mean(np.abs(multiples - np.round(multiples)) < GRID.off) >= GRID.share
    if whole and distinct.size >= GRID.values:
        return float(f"{smallest:.4g}")
    for place in range(9):
        scaled = distinct * 10.0**place
        if np.max(np.abs(scaled - np.round(scaled))) < 1e-4:
            return float(10.0**-place)
    return None


def runs_of(flags: BoolArray) -> list[Run]:
    """Every run of True."""
    return [Run(int(a), int(b)) for a, b in zip(*run_edges(flags), strict=True)]


def run_edges(flags: BoolArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last row of every run of True."""
    edges = np.diff(np.concatenate(([False], flags, [False])).astype(np.int8))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
