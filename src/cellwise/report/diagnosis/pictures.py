"""Pictures of a diagnosis: a log before and after, all candidates, where the residual lies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from cellwise.diagnose.applied import LogRun
from cellwise.report.diagnosis.statements import change, corrected_mV, named_log
from cellwise.report.page import style
from cellwise.report.page.markup import paragraph
from cellwise.report.page.numerals import counted, duration, millivolt, percent
from cellwise.report.page.picture import pictured
from cellwise.report.page.section import Section
from cellwise.report.page.traces import (
    Shown,
    close_up_s,
    draw_close_up,
    draw_log,
    symmetric_limits,
    worst_window,
)

BEFORE_AFTER_CAPTION = (
    "Measured voltage (grey), the model as it was (vermillion), and with the causes known (blue). "
    "Below, the residual, measured minus simulated, before and after. Then the minutes where "
    "the model was worst, and RMSE by tenth of SOC."
)


@pictured(
    "before-after",
    "Measured voltage (grey) and the model's (vermillion); below, the residual. "
    "Then the minutes where the model is worst, and RMSE by tenth of SOC.",
)
def before_after_picture(run: LogRun, explained: bool) -> style.Figure:
    """Voltage and residual of a log before and after, the worst minutes, error by SOC."""
    figure = style.new_figure(6.0)
    left, right = style.two_columns(figure, (2.3, 0.8, 1.9), (2.3, 1.9))
    log = run.log
    length_s = close_up_s(log.time_s)
    part = worst_window(log.time_s, run.before.error_V, length_s, None, log.known_current_A())
    runs = drawn_runs(run, explained)
    draw_log(left, log, runs, part)
    size = millivolt(run.before.metrics.rmse_V)
    text = f"error {change(run)}" if explained else f"{size} RMSE"
    style.finding(left[0], f"{named_log(run)}: {text}", style.WIDE)
    symmetric_limits(left[2], run.before.error_V, "mV", factor=1e3)
    sizes = draw_close_up(right[0], log, runs, part, length_s)
    style.finding(right[0], f"Worst {duration(length_s)}: {sizes} RMSE", style.NARROW)
    _draw_by_soc(right[1], run, explained)
    return figure


def drawn_runs(run: LogRun, explained: bool) -> list[Shown]:
    """What is drawn of a log: the model before, and after with what the sensor adds."""
    name = "before" if explained else "simulated"
    before = Shown(name, run.before.voltage_V, run.before.error_V, style.MODEL)
    if not explained:
        return [before]
    # What was taken off the measured voltage stands on the model's here: one measurement is drawn.
    after = run.explained
    moved = run.log.voltage_V - after.log.voltage_V
    name = "after, log corrected" if corrected_mV(run) else "after"
    return [before, Shown(name, after.voltage_V + moved, after.error_V, style.FILTER)]


def _draw_by_soc(axes: style.Axes, run: LogRun, explained: bool) -> None:
    """RMSE by tenth of SOC, before and after side by side."""
    pairs = [(run.before, style.MODEL, -2.1, "before")]
    pairs += [(run.explained, style.FILTER, 2.1, "after")] if explained else []
    for simulation, colour, shift, name in pairs:
        bands = [b for b in simulation.bands if np.isfinite(b.metrics.rmse_V)]
        centre = np.array([50.0 * (b.soc_low + b.soc_high) for b in bands])
        sizes = [1e3 * b.metrics.rmse_V for b in bands]
        axes.bar(
            centre + shift * explained, sizes, 4.2 if explained else 8.4, color=colour, label=name
        )
    bands = [b for b in run.before.bands if np.isfinite(b.metrics.rmse_V)]
    if bands:
        worst = max(bands, key=lambda b: b.metrics.rmse_V)
        where = f"{100 * worst.soc_low:.0f}–{100 * worst.soc_high:.0f} % SOC"
        style.finding(axes, f"Worst at {where}: {millivolt(worst.metrics.rmse_V)}", style.NARROW)
    style.labels(axes, "SOC [%]", "RMSE [mV]")
    style.soc_axis(axes)


Group = Mapping[str, Any]


def residual_section(residual: Mapping[str, Any], name: str) -> Section:
    """Text and picture of where the error lies."""
    noise = residual["noise"]
    text = (
        f"{counted(residual['rows'])} rows, {millivolt(residual['rmse_V'])} RMSE, mean "
        f"{millivolt(residual['mean_V'])}."
    )
    if noise["floor_V"] is not None:
        text += (
            f" The noise from row to row, which no model can predict, is "
            f"{millivolt(noise['floor_V'])}: {percent(noise['share'], 1)} of the squared error."
        )
    content = (paragraph(text), residual_picture(residual))
    return Section("anatomy", f"Where the error lies ({name})", content, "Where it lies")


@pictured(
    "anatomy",
    "The residual of the first log before any correction, divided in four ways. Bars: root "
    "mean square of the rows in a group; dots: their mean, with its sign (positive: the "
    "model is too low). Numbers: the group's share of the whole squared error.",
)
def residual_picture(residual: Mapping[str, Any]) -> style.Figure:
    """Four panels of bars: what the error is divided by, how a group is called, its unit."""
    figure = style.new_figure(5.6)
    warm = residual.get("by_temperature_C") or []
    charge = ("charge moved up to", residual["by_charge_Ah"], lambda g: f"{g['to']:.2g}", "Ah")
    panels = (
        ("SOC", residual["by_soc"], lambda g: f"{100 * g['from']:.0f}–{100 * g['to']:.0f}", "%"),
        ("current (c: charge)", residual["by_current_C"], _rate, "C"),
        ("time since a current step", residual["by_edge_s"], _between, "s"),
        ("temperature", warm, _between, "°C") if len(warm) > 1 else charge,
    )
    for axes, panel in zip(style.panels(figure, 2, 2), panels, strict=True):
        _bars(axes, *panel)
    return figure


def _bars(
    axes: style.Axes, what: str, groups: Sequence[Group], name: Callable[[Group], str], unit: str
) -> None:
    place = np.arange(len(groups))
    sizes = [1e3 * (g["rmse_V"] or 0.0) for g in groups]
    means = [1e3 * g["mean_V"] for g in groups]
    worst = int(np.argmax([g["share"] for g in groups])) if groups else 0
    colours = [style.MODEL if k == worst else style.FILTER for k in range(len(groups))]
    axes.bar(place, sizes, 0.75, color=colours, alpha=0.8, label="_rms")
    axes.plot(place, means, "o", color=style.INK, markersize=3.5, label="mean")
    style.zero_line(axes)
    for k, g in enumerate(groups):
        if g["share"] >= 0.005:
            text = f"{100 * g['share']:.0f} %"
            style.note(axes, text, (k, sizes[k]), (0, 2), ha="center", va="bottom")
    axes.set_xticks(place, [name(g) for g in groups], fontsize=style.SMALL_PT)
    if len(groups) > 5:
        axes.tick_params(axis="x", rotation=60)
    style.labels(axes, f"{what} [{unit}]", "error [mV]")
    axes.margins(y=0.14)
    axes.grid(axis="x", visible=False)
    if what == "SOC":
        style.legend(axes)
    if not groups:
        style.finding(axes, f"No {what} to divide by", 0.42)
        return
    top, rows = groups[worst], sum(g["rows"] for g in groups)
    where = name(top) if name(top) == "rest" else f"{what.partition(' (')[0]} {name(top)} {unit}"
    part = f"{percent(top['rows'] / max(rows, 1), 0)} of rows"
    style.finding(axes, f"{percent(top['share'], 0)} of the error: {where}, {part}", 0.42)


def _between(g: Group) -> str:
    """Between its edges; above the one that it has."""
    low, high = g["from"], g["to"]
    text = f">{low:g}" if high is None else f"{low:g} to {high:g}"
    return text.replace("-", "−")


def _rate(g: Group) -> str:
    """Of a current, whose negative values are charges."""
    low, high = g["from"], g["to"]
    if low is not None and high is not None and low < 0.0 < high:
        return "rest"
    if low is None or low < 0.0:
        return f"c {_between({'from': -high, 'to': None if low is None else -low})}"
    return _between(g)
