"""A log and what a model makes of it, over time: voltages, current, residual, a close-up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from cellwise.cell.metrics import error_metrics
from cellwise.logs.cell_log import CellLog
from cellwise.report.page import style
from cellwise.report.page.numerals import millivolt, time_unit
from cellwise.report.page.traces import mark_window, thin
from cellwise.typing import FloatArray


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
