"""Pictures of a diagnosis: a log before and after, all candidates, where the residual lies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from cellwise.diagnose.log_runs import LogRun
from cellwise.diagnose.result import Diagnosis, TriedCause
from cellwise.report.diagnosis.statements import cause_name, change, named_log
from cellwise.report.page import style
from cellwise.report.page.markup import EMPTY, Markup, details, paragraph, record_table
from cellwise.report.page.numerals import (
    capitalised,
    counted,
    duration,
    millivolt,
    percent,
    plural,
    significant,
    time_unit,
)
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
    "Below, the residual, measured minus simulated, before and after. Right: the minutes where "
    "the model was worst, and RMSE by tenth of SOC, before and after."
)
SURE_NATS = 10.0


@pictured(
    "before-after",
    "Measured voltage (grey) and the model's (vermillion); below, the residual. "
    "Right: the minutes where the model is worst, and RMSE by tenth of SOC.",
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
    style.legend(left[2], columns=2)
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
    name = "after" if run.corrected is None else "after, log corrected"
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


@pictured(
    "candidates",
    "Every cause that was tried alone, the likeliest on top. Left: error on held-out data with it, "
    "the line is the error without any. Right: by how much likelier the data are with it than "
    "with none, as a natural logarithm; below zero it explains less than the usual tolerances of "
    "a good laboratory do. A cause is accepted by both: a wrong cause can also reduce "
    "the error.",
)
def candidates_picture(diagnosis: Diagnosis) -> style.Figure:
    """Held-out error and evidence of every candidate."""
    tried = sorted(diagnosis.candidates, key=lambda c: _number(c.score, -np.inf))
    figure = style.new_figure(1.1 + 0.24 * max(len(tried), 3))
    left, right = style.panels(figure, 1, 2, sharey=True)
    accepted = {c.name for c in diagnosis.causes}
    colours = [style.FILTER if c.name in accepted else style.MEASURED for c in tried]
    place = np.arange(len(tried))
    errors = [1e3 * _number(c.holdout_rmse_V, 0.0) for c in tried]
    left.barh(place, errors, 0.7, color=colours)
    for k, error in enumerate(errors):
        style.note(left, significant(error), (error, k), (3, 0), va="center")
    left.set_yticks(place, [cause_name(c.name) for c in tried])
    left.margins(x=0.1)
    if diagnosis.causes:
        before = 1e3 * diagnosis.causes[0].holdout_rmse_before_V
        left.axvline(before, color=style.MODEL, linewidth=1.2)
        looks = {"ha": "right", "va": "center", "fontsize": 7.5, "color": style.MODEL}
        at = (before, len(tried) - 0.35)
        style.note(left, f"none: {significant(before)} ", at, (0, 0), **looks)
    left.set_ylim(-0.6, len(tried) + 0.05)
    style.labels(left, "held-out RMSE with this cause alone [mV]")
    style.finding(left, candidates_finding(diagnosis), 0.36)
    right.barh(place, [_number(c.score, 0.0) for c in tried], 0.7, color=colours)
    right.set_xscale("symlog", linthresh=10.0)
    ticks = _score_ticks([_number(c.score, 0.0) for c in tried])
    right.set_xticks(ticks, [significant(float(x)) for x in ticks])
    right.axvline(0.0, color=style.MUTED, linewidth=0.7)
    style.labels(right, "ln of how much likelier the data are with it")
    right.tick_params(labelleft=False)
    style.finding(right, evidence_finding(diagnosis), 0.3)
    for axes in (left, right):
        axes.grid(axis="y", visible=False)
    return figure


def _score_ticks(scores: list[float]) -> list[float]:
    """Zero, and powers of ten as far as the scores go."""
    most = max((abs(s) for s in scores), default=10.0)
    sizes = [10.0**k for k in range(1, max(int(np.log10(max(most, 10.0))), 1) + 1)]
    every = sizes if len(sizes) < 4 else sizes[::2]
    low = [-x for x in reversed(every)] if min(scores, default=0.0) < 0.0 else []
    return [*low, 0.0, *every]


def candidates_finding(diagnosis: Diagnosis) -> str:
    """Which candidate alone leaves how much, and which comes next."""
    order = sorted(diagnosis.candidates, key=lambda c: -_number(c.score, -np.inf))
    if not order:
        return "Nothing was tried"
    first = f"{_named(order[0])} alone leaves {millivolt(order[0].holdout_rmse_V)}"
    if len(order) == 1:
        return first
    return f"{first}; next, {cause_name(order[1].name)}, {millivolt(order[1].holdout_rmse_V)}"


def evidence_finding(diagnosis: Diagnosis) -> str:
    """By how much the first candidate leads; what was named instead once causes were combined."""
    order = sorted(diagnosis.candidates, key=lambda c: -_number(c.score, -np.inf))
    if len(order) < 2:
        return "Evidence"
    ahead = _number(order[0].score, 0.0) - _number(order[1].score, 0.0)
    lead, next_one = _named(order[0]), cause_name(order[1].name)
    if ahead > SURE_NATS:
        title = f"{lead} is certainly likelier than {next_one}, by {ahead:.0f}"
    else:
        title = f"{lead} is {significant(float(np.exp(ahead)), 2)} times likelier than {next_one}"
    named = [cause.name for cause in diagnosis.causes]
    if named and order[0].name not in named:
        title = f"Alone, {title[:1].lower()}{title[1:]}; in sets, {cause_name(named[0])} is named"
    return title


def _named(tried: TriedCause) -> str:
    return capitalised(cause_name(tried.name))


def _number(value: float, otherwise: float) -> float:
    return float(value) if np.isfinite(value) else float(otherwise)


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
    """Size and noise as text."""
    noise = residual["noise"]
    lines = [
        f"{counted(residual['rows'])} rows, {millivolt(residual['rmse_V'])} RMSE, mean "
        f"{millivolt(residual['mean_V'])}."
    ]
    if noise["floor_V"] is not None:
        lines.append(
            f"The noise from row to row, which no model can predict, is "
            f"{millivolt(noise['floor_V'])}: {percent(noise['share'], 1)} of the squared error."
        )
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
