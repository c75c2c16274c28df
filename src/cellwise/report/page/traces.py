"""A log and what a model makes of it over time: no peak lost, close-ups, limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.metrics import error_metrics
from cellwise.logs.cell_log import CellLog
from cellwise.report.page import style
from cellwise.report.page.numerals import millivolt, time_unit
from cellwise.typing import BoolArray, FloatArray

COLUMNS, BAND_COLUMNS = 900, 300  # of pixels: of a line, of a band


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
    columns : int             as of it
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


class CloseUp(NamedTuple):
    """What makes a part of a log worth a closer look."""

    length_s: float = 300.0
    typical_rows: int = 60  # at least so long, where rows are sparse
    rows: int = 20  # it shows at least so many
    motion: float = 0.1  # of the current's range that it changes by, where one does


CLOSE_UP = CloseUp()
OFF_SCALE = 2.2  # times most of the values: an axis leaves out what lies beyond


def close_up_s(time_s: FloatArray) -> float:
    """Length of a close-up [s]: five minutes, more where rows are sparse, at most a fifth."""
    steps = np.diff(time_s)
    typical = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 1.0
    return float(
        min(max(CLOSE_UP.length_s, CLOSE_UP.typical_rows * typical), 0.2 * (time_s[-1] - time_s[0]))
    )


def worst_window(
    time_s: FloatArray,
    error: FloatArray,
    length_s: float,
    allowed: BoolArray | None = None,
    current_A: FloatArray | None = None,
) -> tuple[int, int]:
    """Rows of the window with the largest mean squared error over time.

    Parameters
    ----------
    time_s, error : (n,) float       time never decreasing; NaN errors count as none
    length_s : float                 length of the window
    allowed : (n,) bool or None      rows that may be its start and its middle
    current_A : (n,) float or None   where it is given, a window in which it changes is preferred

    Returns
    -------
    start, stop : int        stop not included
    """
    square = np.nan_to_num(error, nan=0.0) ** 2 * np.diff(time_s, prepend=time_s[0])
    total = np.cumsum(square)
    end = np.minimum(np.searchsorted(time_s, time_s + length_s), time_s.size - 1)
    inside = total[end] - total
    inside[time_s + length_s > time_s[-1]] = -1.0
    if allowed is not None:
        middle = np.minimum(np.searchsorted(time_s, time_s + 0.5 * length_s), time_s.size - 1)
        inside = np.where(allowed[middle] & allowed, inside, -1.0)
    if current_A is not None:
        moved = np.cumsum(np.abs(np.diff(current_A, prepend=current_A[0])))
        rows = np.arange(time_s.size)
        moves = moved[end] - moved > CLOSE_UP.motion * np.ptp(current_A)
        lively = moves & (end - rows >= CLOSE_UP.rows)
        if np.any(lively & (inside > 0.0)):
            inside = np.where(lively, inside, -1.0)
    start = int(np.argmax(inside))
    return _centred(time_s, np.nan_to_num(error, nan=0.0), length_s, start, int(end[start]))


def _centred(
    time_s: FloatArray, error: FloatArray, length_s: float, start: int, end: int
) -> tuple[int, int]:
    """The window moved so that what is wrong in it stands in its middle."""
    end = max(end, start + 1)
    if end >= time_s.size:
        start, end = time_s.size - 2, time_s.size - 1
    weight = error[start : end + 1] ** 2
    if weight.sum() > 0.0:
        middle = float(np.average(time_s[start : end + 1], weights=weight))
        first = min(max(middle - 0.5 * length_s, time_s[0]), time_s[-1] - length_s)
        start = min(int(np.searchsorted(time_s, first)), time_s.size - 2)
        end = int(np.searchsorted(time_s, first + length_s, side="right")) - 1
    return start, max(end + 1, start + 2)


def robust_limit(values: FloatArray, share: float = 99.5) -> tuple[float, bool]:
    """Half range of an axis around zero, and whether some values lie beyond it.

    All values are shown where the largest is not far beyond most of the others.
    """
    size = np.abs(values[np.isfinite(values)])
    if size.size == 0 or size.max() == 0.0:
        return 1.0, False
    most = float(np.percentile(size, share))
    largest = float(size.max())
    if largest <= OFF_SCALE * most or most == 0.0:
        return 1.1 * largest, False
    return 1.6 * most, True


def symmetric_limits(
    axes: style.Axes, values: FloatArray, unit: str, least: float = 0.0, factor: float = 1.0
) -> None:
    """Limits around zero; what lies beyond is stated in the corner rather than hidden."""
    limit, beyond = robust_limit(values)
    limit = max(limit, least)
    axes.set_ylim(-factor * limit, factor * limit)
    if beyond:
        worst = factor * float(values[np.nanargmax(np.abs(values))])
        if abs(worst) > factor * limit:
            text = f"off scale: up to {worst:+.3g} {unit}".replace("-", "−")
            axes.annotate(
                text,
                (0.995, 0.96 if worst > 0 else 0.04),
                xycoords="axes fraction",
                ha="right",
                va="top" if worst > 0 else "bottom",
                fontsize=style.SMALL_PT,
                color=style.MUTED,
                bbox={"facecolor": style.PAPER, "alpha": 0.8, "edgecolor": "none", "pad": 1.5},
                zorder=6,
            )


def mark_window(axes: style.Axes, start: float, stop: float) -> None:
    """Shade the part of a long trace that a close-up shows."""
    axes.axvspan(start, stop, color=style.INK, alpha=0.10, linewidth=0, zorder=0.5)


class Shown(NamedTuple):
    """A simulated voltage as it is drawn: its name, voltage and residual [V], its colour."""

    name: str
    voltage_V: FloatArray
    error_V: FloatArray
    colour: str


class TimeAxis(NamedTuple):
    """Time since a log's first row in the unit that suits its length, and the axis's label."""

    t: FloatArray
    label: str
    scale_s: float


def time_axis(time_s: FloatArray, length_s: float | None = None) -> TimeAxis:
    """Time since the first row; its unit suits ``length_s``, or the whole where none is given."""
    scale, unit = time_unit(float(time_s[-1] - time_s[0]) if length_s is None else length_s)
    return TimeAxis((time_s - time_s[0]) / scale, f"time [{unit}]", scale)


def draw_log(
    axes: Sequence[style.Axes], log: CellLog, shown: Sequence[Shown], part: tuple[int, int]
) -> None:
    """Voltages, current and residuals [mV] of a whole log, one below the other; a part marked."""
    t, time_label, _ = time_axis(log.time_s)
    gaps = log.gap_rows
    top, middle, bottom = axes
    measured = thin(t, log.voltage_V, gaps=gaps)
    top.plot(*measured, color=style.MEASURED, linewidth=1.6, label="measured")
    for one in shown:
        voltage, error = thin(t, one.voltage_V, gaps=gaps), thin(t, 1e3 * one.error_V, gaps=gaps)
        top.plot(*voltage, color=one.colour, linewidth=0.8, label=one.name)
        bottom.plot(*error, color=one.colour, linewidth=0.7, label=one.name)
    middle.plot(*thin(t, log.known_current_A(), gaps=gaps), color=style.MEASURED, linewidth=0.8)
    style.zero_line(bottom)
    style.labels(top, "", "voltage [V]")
    style.labels(middle, "", "current [A]")
    style.labels(bottom, time_label, "residual [mV]")
    style.legend(top, columns=3)
    for place in axes:
        place.set_xlim(t[0], t[-1])
        mark_window(place, t[part[0]], t[part[1] - 1])


def draw_close_up(
    axes: style.Axes, log: CellLog, shown: Sequence[Shown], part: tuple[int, int], length_s: float
) -> str:
    """Voltages of a part of a log; the RMSE in it of what is shown, as text."""
    rows = slice(*part)
    t, time_label, scale = time_axis(log.time_s[rows], length_s)
    axes.plot(*thin(t, log.voltage_V[rows], 300), color=style.MEASURED, linewidth=2.0)
    for one in shown:
        axes.plot(*thin(t, one.voltage_V[rows], 300), color=one.colour, linewidth=1.2)
    axes.set_xlim(0.0, length_s / scale)
    style.labels(axes, time_label, "voltage [V]")
    return " → ".join(millivolt(error_metrics(one.error_V[rows]).rmse_V) for one in shown)


def draw_part_current(
    axes: style.Axes, log: CellLog, part: tuple[int, int], length_s: float
) -> None:
    """The current of a part of a log."""
    rows = slice(*part)
    t, time_label, scale = time_axis(log.time_s[rows], length_s)
    current = thin(t, log.known_current_A()[rows], 300)
    axes.plot(*current, color=style.MEASURED, linewidth=1.1, drawstyle="steps-pre")
    axes.set_xlim(0.0, length_s / scale)
    style.labels(axes, time_label, "current [A]")
