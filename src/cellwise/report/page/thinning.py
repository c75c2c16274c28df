"""Long traces made short without losing a peak: extremes per pixel column."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellwise.typing import BoolArray, FloatArray

COLUMNS = 900
BAND_COLUMNS = 300


def thin_rows(x: FloatArray, y: FloatArray, columns: int = COLUMNS) -> NDArray[np.intp]:
    """Rows to draw of a long trace: of every pixel column its first, lowest, highest, last row.

    Parameters
    ----------
    x : (n,) float        never decreasing
    y : (n,) float        NaN where nothing was measured
    columns : int         pixel columns over the range of x

    Returns
    -------
    (m,) int              ascending; all rows when there are not many more than columns

    Notes
    -----
    What is drawn through these rows covers the same pixels as all rows would.
    """
    n = x.size
    if n <= 4 * columns or x[-1] <= x[0]:
        return np.arange(n)
    column = np.minimum((x - x[0]) * (columns / (x[-1] - x[0])), columns - 1).astype(np.int64)
    first = np.concatenate(([0], np.flatnonzero(np.diff(column)) + 1))
    last = np.concatenate((first[1:], [n])) - 1
    group = np.repeat(np.arange(first.size), last - first + 1)
    kept = [first, last]
    for extreme in (np.fmin, np.fmax):
        at = np.flatnonzero(y == extreme.reduceat(y, first)[group])
        kept.append(at[np.concatenate(([True], np.diff(group[at]) > 0))] if at.size else at)
    # A missing value breaks the line, whatever stands around it in its column.
    missing = np.isnan(y)
    kept.append(np.flatnonzero(missing & ~np.concatenate(([False], missing[:-1]))))
    return np.unique(np.concatenate(kept))


def thin(
    x: FloatArray, y: FloatArray, columns: int = COLUMNS, gaps: BoolArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """A trace to draw: extremes kept, broken where the log has a gap.

    Parameters
    ----------
    x, y : (n,) float         see :func:`thin_rows`
    gaps : (n,) bool or None  rows that end a gap

    Returns
    -------
    x, y : (m,) float
    """
    rows = thin_rows(x, y, columns)
    if gaps is None or not gaps.any():
        return x[rows], y[rows]
    passed = np.cumsum(gaps)
    after = np.flatnonzero(np.diff(passed[rows]) > 0) + 1
    return (
        np.insert(x[rows], after, x[rows][after]),
        np.insert(y[rows], after, np.nan),
    )


def thin_band(
    x: FloatArray, low: FloatArray, high: FloatArray, columns: int = BAND_COLUMNS
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A band to fill: lowest and highest value of every pixel column.

    Parameters
    ----------
    x, low, high : (n,) float     x never decreasing

    Returns
    -------
    x, low, high : (m,) float
    """
    n = x.size
    if n <= 2 * columns or x[-1] <= x[0]:
        return x, low, high
    column = np.minimum((x - x[0]) * (columns / (x[-1] - x[0])), columns - 1).astype(np.int64)
    first = np.concatenate(([0], np.flatnonzero(np.diff(column)) + 1))
    shown = x[first].copy()
    shown[-1] = x[-1]  # the band ends where the trace does
    return shown, np.fmin.reduceat(low, first), np.fmax.reduceat(high, first)
