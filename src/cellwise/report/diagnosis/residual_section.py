"""Where a residual lies, as pictures: error by SOC, current, time since an edge, and so on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from cellwise.report.page import style
from cellwise.report.page.markup import EMPTY, Markup, details, paragraph, record_table
from cellwise.report.page.numerals import (
    counted,
    duration,
    listed,
    millivolt,
    percent,
    plural,
    significant,
    time_unit,
)
from cellwise.report.page.picture import pictured
from cellwise.report.page.section import Section

Group = Mapping[str, Any]


def residual_section(residual: Mapping[str, Any], name: str) -> Section:
    """Picture and tables of where the error lies."""
    content = (residual_text(residual), residual_picture(residual), residual_tables(residual))
    return Section("anatomy", f"Where the error lies ({name})", content, "Where it lies")


def panels(
    residual: Mapping[str, Any],
) -> list[tuple[str, Sequence[Group], Callable[[Group], str], str]]:
    """Of every division: what it is by, its groups, how a group is called, label of the axis."""
    warm = residual.get("by_temperature_C") or []
    by_charge = (
        "charge moved",
        residual["by_charge_Ah"],
        lambda g: significant(g["to"], 2),
        "charge moved up to [Ah]",
    )
    longest = residual["by_time_s"][-1]["to"] if residual["by_time_s"] else 0.0
    scale, unit = time_unit(longest or 1.0)
    return [
        ("SOC", residual["by_soc"], _soc, "SOC [%]"),
        ("current", residual["by_current_C"], _rate, "current [C]; c: charge"),
        (
            "time since an edge",
            residual["by_edge_s"],
            _seconds,
            "time since the current stepped [s]",
        ),
        (
            "elapsed time",
            residual["by_time_s"],
            lambda g: significant(g["to"] / scale, 2),
            f"elapsed time up to [{unit}]",
        ),
        ("temperature", warm, _plain, "temperature [°C]") if len(warm) > 1 else by_charge,
        ("period", _by_period(residual), _period, "period of the error's movement [s]"),
    ]


@pictured(
    "anatomy",
    "The residual of the first log before any correction, divided in six ways. Bars: root "
    "mean square of the rows in a group; dots: their mean, with its sign (positive: the "
    "model is too low). Numbers: the group's share of the whole squared error.",
)
def residual_picture(residual: Mapping[str, Any]) -> style.Figure:
    """Six panels of bars."""
    figure = style.new_figure(6.2)
    for axes, (what, groups, name, label) in zip(
        style.panels(figure, 2, 3), panels(residual), strict=True
    ):
        _bars(axes, what, groups, name, label)
    return figure


def _bars(
    axes: style.Axes, what: str, groups: Sequence[Group], name: Callable[[Group], str], label: str
) -> None:
    place = np.arange(len(groups))
    sizes = [1e3 * (g.get("rmse_V", g.get("rms_V")) or 0.0) for g in groups]
    means = [1e3 * g["mean_V"] for g in groups if "mean_V" in g]
    worst = int(np.argmax([g["share"] for g in groups])) if groups else 0
    colours = [style.MODEL if k == worst else style.FILTER for k in range(len(groups))]
    axes.bar(place, sizes, 0.75, color=colours, alpha=0.8, label="_rms")
    if means:
        axes.plot(place, means, "o", color=style.INK, markersize=3.5, label="mean")
        style.zero_line(axes)
    for k, g in enumerate(groups):
        if g["share"] >= 0.005:
            text = f"{100 * g['share']:.0f} %"
            style.note(axes, text, (k, sizes[k]), (0, 2), ha="center", va="bottom")
    axes.set_xticks(place, [name(g) for g in groups], fontsize=7.5)
    if len(groups) > 5:
        axes.tick_params(axis="x", rotation=60)
    style.labels(axes, label, "error [mV]")
    axes.margins(y=0.14)
    axes.grid(axis="x", visible=False)
    style.finding(axes, _title(what, groups, name, worst), 0.25)
    if what == "SOC":
        style.legend(axes)


def _title(what: str, groups: Sequence[Group], name: Callable[[Group], str], worst: int) -> str:
    if not groups:
        return f"No {what} to divide by"
    top = groups[worst]
    units = {"SOC": " % SOC", "current": "C", "temperature": " °C"}
    where = f"{name(top)}{units.get(what, '')}"
    rows = sum(g.get("rows", 0) for g in groups)
    part = f", {percent(top['rows'] / rows, 0)} of rows" if rows else ""
    text = {
        "elapsed time": f"part {worst + 1} of {len(groups)} of the time",
        "charge moved": f"part {worst + 1} of {len(groups)} of the charge",
        "current": "rest" if where == "restC" else where.replace("c ", "charge at "),
        "time since an edge": f"{where} s after an edge",
        "period": "a constant" if worst == 0 else f"periods of {where} s",
    }.get(what, where)
    return f"{percent(top['share'], 0)} of the error: {text}{part}"


def residual_text(residual: Mapping[str, Any]) -> Markup:
    """Noise, correlation and drift as text."""
    noise, white, drift = residual["noise"], residual["whiteness"], residual["drift"]
    lines = [
        f"{counted(residual['rows'])} rows, {millivolt(residual['rmse_V'])} RMSE, mean "
        f"{millivolt(residual['mean_V'])}."
    ]
    if noise["floor_V"] is not None:
        lines.append(
            f"The noise from row to row, which no model can predict, is "
            f"{millivolt(noise['floor_V'])}: {percent(noise['share'], 1)} of the squared error."
        )
    if white["white"]:
        lines.append("The residual is white: successive rows are uncorrelated.")
    elif white["correlation_s"] is not None:
        lines.append(f"Errors are correlated over {duration(white['correlation_s'])}.")
    sure = [
        f"{millivolt(drift[key])} per {unit}"
        for key, unit in (("V_per_h", "hour"), ("V_per_Ah", "ampere-hour"))
        if drift[key] is not None and abs(drift[key]) > 2.0 * (drift[f"{key}_std"] or 0.0)
    ]
    lines.append(f"It drifts by {listed(sure)}." if sure else "No drift is certain.")
    return paragraph(" ".join(lines))


def residual_tables(residual: Mapping[str, Any]) -> Markup:
    """Every group in figures, folded away."""
    parts = [
        record_table(
            groups,
            (label, name),
            ("rows", lambda g: counted(g["rows"]) if "rows" in g else ""),
            ("RMSE", lambda g: millivolt(g.get("rmse_V", g.get("rms_V")))),
            ("mean", lambda g: millivolt(g.get("mean_V"))),
            ("share of the squared error", lambda g: percent(g["share"], 1)),
            caption=f"By {what}",
        )
        for what, groups, name, label in panels(residual)
        if groups
    ]
    if not parts:
        return EMPTY
    return details(f"All figures, {plural(len(parts), 'table')}", Markup("".join(parts)))


def _soc(g: Group) -> str:
    return f"{100 * g['from']:.0f}–{100 * g['to']:.0f}"


def _plain(g: Group) -> str:
    return f"{g['from']:.0f}–{g['to']:.0f}".replace("-", "−")


def _rate(g: Group) -> str:
    low, high = g["from"], g["to"]
    if low is not None and high is not None and low < 0.0 < high:
        return "rest"
    if low is None:
        return f"c >{-high:g}"
    if high is None:
        return f">{low:g}"
    return f"{low:g}–{high:g}" if low > 0.0 else f"c {-high:g}–{-low:g}"


def _by_period(residual: Mapping[str, Any]) -> list[Group]:
    """The constant part, then from fast to slow."""
    constant = residual.get("constant")
    if not constant:
        return []
    first = {"from": 0.0, "to": 0.0, "rms_V": abs(constant["mean_V"]), "share": constant["share"]}
    return [first, *residual["by_period_s"]]


def _period(g: Group) -> str:
    return "constant" if g["to"] == 0.0 else _seconds(g)


def _seconds(g: Group) -> str:
    low, high = g["from"], g["to"]
    if not low:
        return f"<{high:g}"
    return f">{low:g}" if high is None else f"{low:g}–{high:g}"
