"""Runs of rows, and pauses: rows that were not written, as against rows written slowly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.typing import BoolArray, FloatArray

if TYPE_CHECKING:
    from cellwise.logs.cell_log import CellLog


# A gap: rows that were not written, as against written slowly. Testers slow down from 0.1 s to
# 300 s rows at rest, and speed up again, without losing anything; they hiccup for two seconds
# between two repetitions of a profile. Neither is a gap.
GAP_TIMES = 10.0  # what is usual among its neighbours
LEAST_GAP_S = 5.0
NEIGHBOURS = 5  # intervals on either side
GAP_BESIDE = 4.0  # times each interval next to it


@dataclass(frozen=True)
class Gap:
    """A pause in the log, never bridged in silence.

    It begins at ``start_s`` and lasts ``duration_s``; ``row`` is the row that ends it.
    ``charge_Ah`` is what the tester's own counter says flowed meanwhile (positive = discharge),
    None without a counter.
    """

    row: int
    start_s: float
    duration_s: float
    charge_Ah: float | None


def find_gaps(time_s: FloatArray) -> BoolArray:
    """Rows that end a pause far longer than the logging interval around it.

    What counts as one says `GapRule`; usual on a side is the second longest of the intervals there
    (one neighbouring gap does not hide another).

    Parameters
    ----------
    time_s : (n,) float       never decreasing [s]

    Returns
    -------
    (n,) bool                 never True for the first row
    """
    found = np.zeros(time_s.size, dtype=np.bool_)
    interval = np.diff(time_s)
    if interval.size < 2 or np.max(interval) <= LEAST_GAP_S:
        return found
    ends = np.arange(1, time_s.size)
    if np.min(interval) == 0.0:  # rows that share a stamp have no interval of their own
        ends = ends[interval > 0]
        interval = interval[interval > 0]
    at = np.flatnonzero(interval > LEAST_GAP_S)
    at = at[interval[at] > GAP_BESIDE * _beside(interval, at)]
    usual = np.maximum(_usual(interval, at, -1), _usual(interval, at, +1))
    found[ends[at[interval[at] > GAP_TIMES * usual]]] = True
    return found


def _beside(interval: FloatArray, at: NDArray[np.intp]) -> FloatArray:
    """The longer of the two intervals next to each place."""
    before = np.where(at > 0, interval[np.maximum(at - 1, 0)], 0.0)
    last = interval.size - 1
    after = np.where(at < last, interval[np.minimum(at + 1, last)], 0.0)
    return np.maximum(before, after)


def _usual(interval: FloatArray, at: NDArray[np.intp], side: int) -> FloatArray:
    """Second longest of the intervals on one side of each place (of one or two: the longest)."""
    index = at[:, None] + side * np.arange(1, NEIGHBOURS + 1)
    inside = (index >= 0) & (index < interval.size)
    around = np.where(inside, interval[np.clip(index, 0, interval.size - 1)], -np.inf)
    around.sort(axis=1)
    count = inside.sum(axis=1)
    usual = np.where(count >= 3, around[:, -2], around[:, -1])
    return np.where(count > 0, usual, 0.0)


class RowRange(NamedTuple):
    """Rows from ``first`` to ``last``, both included."""

    first: int
    last: int


def rows_between(time_s: FloatArray, low_s: float, high_s: float) -> range:
    """Rows of a log from one of its times to another, both among them."""
    first = int(np.searchsorted(time_s, low_s, side="left"))
    stop = int(np.searchsorted(time_s, high_s, side="right"))
    return range(min(first, time_s.size - 1), max(stop, min(first + 1, time_s.size)))


def runs_of(flags: BoolArray) -> list[RowRange]:
    """Every run of True."""
    return [RowRange(int(a), int(b)) for a, b in zip(*run_edges(flags), strict=True)]


def run_edges(flags: BoolArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last row of every run of True."""
    edges = np.diff(np.concatenate(([False], flags, [False])).astype(np.int8))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1


# When a pause cuts a log.
UNCOUNTED_S = 300.0  # what flows unseen for less hardly moves the SOC
FEWEST_VOLTAGES = 30  # of a stretch: fewer say less than it costs to find where it begins


def uncounted_pauses(log: CellLog) -> tuple[int, ...]:
    """Rows that end a pause of minutes over which no counter went on.

    A car that is switched off may be charged meanwhile: where its SOC is then, nobody knows.
    """
    long = np.flatnonzero(log.gap_rows & (log.interval_s > UNCOUNTED_S))
    if log.charge_Ah is None:
        return tuple(map(int, long))
    return tuple(int(k) for k in long if not np.isfinite(log.charge_Ah[k - 1 : k + 1]).all())


def cut_at_pauses(log: CellLog) -> tuple[CellLog, ...]:
    """The stretches between such pauses, as logs with their time in the name; the log without one.

    What is too short to say anything is left away; a stated start and the notices of reading
    stay with the first stretch.
    """
    rows = uncounted_pauses(log)
    if not rows:
        return (log,)
    found: list[CellLog] = []
    for first, stop in pairwise((0, *rows, len(log))):
        measured = np.isfinite(log.voltage_V[first:stop])
        if np.count_nonzero(measured) < FEWEST_VOLTAGES or not np.any(
            np.isfinite(log.current_A[first:stop])
        ):
            continue
        part = log.part(first, stop)
        name = f"{log.name}, {log.time_s[first]:.0f} s" if first else log.name
        found.append(replace(part, name=name, notices=() if found else log.notices))
    return tuple(found) or (log,)
