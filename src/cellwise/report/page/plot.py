"""Plots over time that zoom: every sample stands in the page; as a file they are drawn once."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.simulate import Simulation
from cellwise.logs.cell_log import CellLog
from cellwise.plotting import Line, Panel, draw_panels
from cellwise.report.page import style
from cellwise.report.page.markup import Markup, clock_of, escape
from cellwise.report.page.numerals import time_unit
from cellwise.typing import BoolArray, FloatArray

MISSING = np.iinfo(np.uint16).max
UNEVEN = 1e-3  # of a step
NEARLY_ALL = 99.5  # per cent of the values, which an axis shows in any case
OFF_SCALE = 2.2  # times most of the values: an axis leaves out what lies beyond
CLOSE_UP_S, CLOSE_UP_ROWS = 300.0, 60  # a close-up shows so much of a log at least


class Plot(NamedTuple):
    """Panels over one time axis, one below the other, with a title that says what was found.

    ``x_label`` carries its unit. ``clock`` names the log whose time since its first row is shown:
    plots of one clock have one cursor. ``key`` is the name of its file without suffix.
    """

    key: str
    title: str
    x_label: str
    panels: tuple[Panel, ...]
    caption: str = ""
    clock: str = ""

    @property
    def samples(self) -> int:
        """Rows of the log."""
        return int(self.panels[0].lines[0].x.size)

    @property
    def figure(self) -> style.Figure:
        """The same for a file."""
        with style.drawing():
            figure = style.new_figure(0.8 + 1.7 * len(self.panels), style.WIDE_IN)
            axes = draw_panels(figure, self.x_label, self.panels)
            style.finding(axes[0], self.title)
        return figure


class TimeAxis(NamedTuple):
    """A log's own time in the unit that suits its length, and the axis's label."""

    t: FloatArray
    label: str


def time_axis(log: CellLog) -> TimeAxis:
    """The time axis of a log."""
    scale, unit = time_unit(float(log.duration_s))
    return TimeAxis(log.time_s / scale, f"time [{unit}]")


def simulation_plot(
    key: str,
    title: str,
    log: CellLog,
    models: Sequence[tuple[str, FloatArray, FloatArray]],
    soc: FloatArray | None = None,
    caption: str = "",
) -> Plot:
    """Measured voltage and what models make of it, the residuals, the current, the SOC.

    Parameters
    ----------
    models : of (name, voltage [V], residual [V])    each of shape (n,)
    """
    t, label = time_axis(log)
    measured = Line("measured", t, log.voltage_V)
    residuals = tuple(Line(name, t, 1e3 * error) for name, _, error in models)
    panels = [
        Panel("voltage [V]", (measured, *(Line(name, t, v) for name, v, _ in models))),
        Panel("residual [mV]", residuals, robust_limits(residuals[0].y)),
        Panel("current [A]", (Line("current", t, log.current_A),)),
    ]
    if soc is not None:
        panels.append(Panel("SOC [%]", (Line("SOC", t, 100.0 * soc),)))
    return Plot(key, title, label, tuple(panels), caption, clock_of(log))


def as_model(simulation: Simulation, name: str = "simulated") -> tuple[str, FloatArray, FloatArray]:
    """A simulation as `simulation_plot` takes it."""
    return name, simulation.voltage_V, simulation.residual_V


def robust_limits(values: FloatArray) -> tuple[float, float] | None:
    """Limits of an axis around zero where a few values lie far beyond most; None: all are shown."""
    size = np.abs(values[np.isfinite(values)])
    most = float(np.percentile(size, NEARLY_ALL)) if size.size else 0.0
    if most == 0.0 or size.max() <= OFF_SCALE * most:
        return None
    return -1.6 * most, 1.6 * most


def worst_part(log: CellLog, error: FloatArray, allowed: BoolArray | None = None) -> slice:
    """Rows of the minutes with the largest mean squared error, which stands in their middle.

    Parameters
    ----------
    error : (n,) float            NaN counts as none
    allowed : (n,) bool or None   rows that may be their middle
    """
    time_s = log.time_s
    steps = np.diff(time_s, prepend=time_s[0])
    typical = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 1.0
    length_s = min(max(CLOSE_UP_S, CLOSE_UP_ROWS * typical), 0.2 * log.duration_s)
    weight = np.where(log.gap_rows, 0.0, steps)  # nobody knows what was in a gap
    total = np.concatenate(([0.0], np.cumsum(np.nan_to_num(error) ** 2 * weight)))
    first = np.searchsorted(time_s, time_s - 0.5 * length_s)
    last = np.searchsorted(time_s, time_s + 0.5 * length_s, side="right")
    inside = total[last] - total[first]
    if allowed is not None and allowed.any():
        inside = np.where(allowed, inside, -1.0)
    middle = int(np.argmax(inside))
    return slice(int(first[middle]), int(last[middle]))


def trace(plot: Plot) -> Markup:
    """The plot as HTML; its samples stand beside it, packed.

    Values are kept in 65,534 steps between the lowest and the highest: finer than a screen shows.
    """
    key = escape(plot.key)
    samples = {
        "n": plot.samples,
        "xLabel": plot.x_label,
        "x": _axis(plot.panels[0].lines[0].x),
        "panels": [
            {"label": panel.y_label, "most": panel.limits, "lines": [*map(_line, panel.lines)]}
            for panel in plot.panels
        ],
    }
    text = json.dumps(samples, allow_nan=False).replace("<", "\\u003c")
    title = f"<h3>{escape(plot.title)}</h3>" if plot.title else ""
    caption = f"<figcaption>{escape(plot.caption)}</figcaption>" if plot.caption else ""
    return Markup(
        f'<figure id="figure-{key}">{title}<div class="trace" id="{key}" '
        f'data-clock="{escape(plot.clock)}" data-source="{key}-data"></div>{caption}</figure>\n'
        f'<script type="application/vnd.cellwise.trace" id="{key}-data">{text}</script>'
    )


def _axis(x: FloatArray) -> dict[str, Any]:
    if x.size > 1:
        step = float(x[-1] - x[0]) / (x.size - 1)
        if step > 0 and np.max(np.abs(x - x[0] - step * np.arange(x.size))) < UNEVEN * step:
            return {"start": float(x[0]), "step": step}
    return {"data": _packed(np.ascontiguousarray(x, dtype="<f4").tobytes())}


def _line(line: Line) -> dict[str, Any]:
    series: dict[str, Any] = {"label": line.label, **_series(line.y)}
    if line.band is not None:
        series["band"] = [_series(edge) for edge in line.edges]
    return series


def _series(values: FloatArray) -> dict[str, Any]:
    """Values as differences of 16-bit steps, low bytes first: they pack best so."""
    known = np.isfinite(values)
    low, high = (float(f(values[known])) for f in (np.min, np.max)) if known.any() else (0.0, 1.0)
    span = high - low or 1.0
    levels = np.full(values.size, MISSING, dtype=np.uint16)
    levels[known] = np.round((values[known] - low) / span * (MISSING - 1)).astype(np.uint16)
    steps = np.diff(levels, prepend=np.uint16(0)).astype("<u2")
    halves = steps.view(np.uint8).reshape(-1, 2).T
    return {"low": low, "high": low + span, "data": _packed(halves.tobytes())}


def _packed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 6)).decode("ascii")
