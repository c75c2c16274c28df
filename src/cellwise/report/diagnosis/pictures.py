"""Pictures of a diagnosis: a log before and after, all candidates, where the residual lies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from cellwise.diagnose.result import LogRun
from cellwise.report.diagnosis.statements import change, corrected_mV, named_log
from cellwise.report.page import style
from cellwise.report.page.markup import paragraph
from cellwise.report.page.numerals import counted, millivolt, percent
from cellwise.report.page.picture import pictured
from cellwise.report.page.plot import Plot, as_model, simulation_plot
from cellwise.report.page.section import Blocks, Section

BEFORE_AFTER_CAPTION = (
    "Measured voltage (grey), the model as it was (vermillion) and with the causes known (blue); "
    "the residual, measured minus simulated, before and after; the current."
)


def before_after_plot(run: LogRun, explained: bool, key: str) -> Plot:
    """Voltage and residual of a log before and after."""
    size = millivolt(run.before.rmse_V)
    title = f"{named_log(run)}: " + (f"error {change(run)}" if explained else f"{size} RMSE")
    before = as_model(run.before, "before" if explained else "simulated")
    if not explained:
        return simulation_plot(key, title, run.log, [before])
    # What was taken off the measured voltage stands on the model's here: one measurement is drawn.
    after = run.explained
    moved = run.log.voltage_V - after.log.voltage_V
    name = "after, log corrected" if corrected_mV(run) else "after"
    models = [before, (name, after.voltage_V + moved, after.residual_V)]
    return simulation_plot(key, title, run.log, models, caption=BEFORE_AFTER_CAPTION)


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
    temperature_C = residual.get("by_temperature_C") or []
    charge = ("charge moved up to", residual["by_charge_Ah"], lambda g: f"{g['to']:.2g}", "Ah")
    panels = (
        ("SOC", residual["by_soc"], lambda g: f"{100 * g['from']:.0f}–{100 * g['to']:.0f}", "%"),
        ("current (c: charge)", residual["by_current_C"], _rate, "C"),
        ("time since a current step", residual["by_edge_s"], _between, "s"),
        ("temperature", temperature_C, _between, "°C") if len(temperature_C) > 1 else charge,
    )
    pictures = tuple(
        residual_picture(*one)._replace(key=f"anatomy-{k}") for k, one in enumerate(panels, start=1)
    )
    content: Blocks = (paragraph(text), paragraph(ANATOMY, "note"), *pictures)
    return Section("anatomy", f"Where the error lies ({name})", content, "Where it lies")


ANATOMY = (
    "The residual of the first log before any correction, divided in four ways. Bars: root mean "
    "square of the rows in a group; dots: their mean, with its sign (positive: the model is too "
    "low). Numbers: the group's share of the whole squared error."
)


@pictured("anatomy")
def residual_picture(
    what: str, groups: Sequence[Group], name: Callable[[Group], str], unit: str
) -> style.Figure:
    """Size and mean of the residual in every group of a division."""
    figure, axes = style.new_axes()
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
    style.finding(axes, _title(what, groups, name, unit, worst))
    return figure


def _title(
    what: str, groups: Sequence[Group], name: Callable[[Group], str], unit: str, worst: int
) -> str:
    if not groups:
        return f"No {what} to divide by"
    top, rows = groups[worst], sum(g["rows"] for g in groups)
    where = name(top) if name(top) == "rest" else f"{what.partition(' (')[0]} {name(top)} {unit}"
    part = f"{percent(top['rows'] / max(rows, 1), 0)} of rows"
    return f"{percent(top['share'], 0)} of the error: {where}, {part}"


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
