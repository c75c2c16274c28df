"""Pictures of a benchmark: settled errors by log, fault, start and temperature; error curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cellwise.estimate.replay import CONVERGED_SOC
from cellwise.report.benchmark.overview import (
    Matrix,
    healthy,
    log_name,
    mean_of,
    names,
    overviews,
    start_name,
)
from cellwise.report.page import style
from cellwise.report.page.markup import MOST
from cellwise.report.page.numerals import duration, percent
from cellwise.report.page.picture import Picture, pictured, safe_key

Rows = Sequence[Mapping[str, Any]]
MARKERS = "osD^vPX<>h"
WARM_SPREAD_K = 4.0
# Per cent of SOC that an axis shows: a logarithmic one from, a linear one up to, since an initial
# error that persists would press all else to zero.
LEAST_PERCENT, MOST_POINTS = 0.02, 12.0
GOOD, FAIR, POOR = 1.0, 2.0, 5.0  # per cent of SOC
LIMITS = dict(zip((GOOD, FAIR, POOR), style.TINTS, strict=False))
BAD = style.TINTS[-1]


def _looks(estimators: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Colour and marker of every estimator, the same in every picture."""
    return {
        name: {"color": style.CYCLE[k % len(style.CYCLE)], "marker": MARKERS[k % len(MARKERS)]}
        for k, name in enumerate(estimators)
    }


@pictured(
    "benchmark-logs",
    "Every dot is the mean over the starts of one log, without a fault; further left is "
    "better, every grid line of the scale is a factor.",
)
def log_picture(matrix: Matrix) -> style.Figure:
    """Dots over a logarithmic scale, a line per log."""
    figure = style.new_figure(1.2 + 0.3 * max(len(matrix.labels), 2))
    axes = figure.subplots()
    place = np.arange(len(matrix.labels))
    looks = _looks(matrix.estimators)
    for name, values in zip(matrix.estimators, matrix.values, strict=True):
        axes.plot(
            np.maximum(100.0 * values, LEAST_PERCENT), place, linestyle="none", markersize=6,
            label=name, **looks[name],
        )  # fmt: skip
    axes.set_xscale("log")
    axes.set_yticks(place, matrix.labels)
    axes.set_ylim(len(matrix.labels) - 0.5, -0.5)
    style.plain_numbers(axes.xaxis)
    style.finding(axes, _logs_title(matrix))
    style.labels(axes, "settled SOC RMSE [%]", " ")
    style.side_legend(axes)
    return figure


@pictured(
    "benchmark-faults",
    "Mean settled RMSE in per cent of SOC, every fault from the same start; green up to 1 %, "
    "red beyond 5 %. The fault is in what the filter sees, never in the reference.",
)
def fault_picture(matrix: Matrix) -> style.Figure:
    """Numbers on tinted fields, faults downwards, estimators across."""
    values = 100.0 * matrix.values.T
    figure = style.new_figure(0.9 + 0.27 * len(matrix.labels))
    axes = figure.subplots()
    for (row, column), value in np.ndenumerate(values):
        if not np.isfinite(value):
            continue
        tint = next((t for limit, t in LIMITS.items() if value <= limit), BAD)
        axes.fill_between([column - 0.48, column + 0.48], row - 0.46, row + 0.46, color=tint, lw=0)
        axes.text(column, row, f"{value:.2f}", ha="center", va="center", color=style.INK)
    axes.set_xlim(-0.5, len(matrix.estimators) - 0.5)
    axes.set_ylim(len(matrix.labels) - 0.5, -0.5)
    axes.set_xticks(range(len(matrix.estimators)), matrix.estimators)
    axes.set_yticks(range(len(matrix.labels)), matrix.labels)
    axes.grid(visible=False)
    axes.tick_params(length=0)
    if values.shape[0] > 1 and np.isfinite(values[1:]).any():
        worst = np.array([np.nanmax(c) if np.isfinite(c).any() else np.inf for c in values[1:].T])
        best = int(np.argmin(worst))
        text = f"{matrix.estimators[best]} is most robust: at most {worst[best]:.2f} % settled"
        style.finding(axes, text)
    return figure


@pictured(
    "benchmark-starts",
    "First: median time until the error stays within two points for ten minutes, over the "
    "runs that get there; a hollow mark where some never do. Then: the settled error.",
)
def start_picture(rows: Rows, matrix: Matrix) -> style.Figure:
    """Two axes over the start error."""
    figure = style.new_figure(3.4)
    left, right = style.panels(figure, 1, 2)
    chosen = healthy(rows)
    errors = sorted({float(row["start_error"]) for row in chosen})
    looks = _looks(matrix.estimators)
    place = np.arange(len(errors), dtype=np.float64)
    for k, name in enumerate(matrix.estimators):
        own = [row for row in chosen if row["estimator"] == name]
        shift = 0.06 * (k - 0.5 * len(matrix.estimators))
        for where, error in zip(place, errors, strict=True):
            times = np.array([r["convergence_s"] for r in own if r["start_error"] == error])
            reached = times[np.isfinite(times)]
            if reached.size:
                face = looks[name]["color"] if reached.size == times.size else style.PAPER
                left.plot(where + shift, max(float(np.median(reached)), 0.5) / 60.0,
                          linestyle="none", markersize=6, markerfacecolor=face,
                          **looks[name])  # fmt: skip
        right.plot(place + shift, np.maximum(100.0 * matrix.values[k], LEAST_PERCENT),
                   linestyle="none", markersize=6, label=name, **looks[name])  # fmt: skip
    for axes in (left, right):
        axes.set_yscale("log")
        axes.set_xticks(place, [start_name(e) for e in errors])
        style.plain_numbers(axes.yaxis)
    right.axhline(100.0 * CONVERGED_SOC, color=style.MUTED, linewidth=0.8, linestyle=(0, (1, 2)))
    style.finding(left, _recovery_title(chosen, matrix.estimators, errors), 0.42)
    style.finding(right, _settled_title(matrix), 0.42)
    style.labels(left, "start", "within 2 points after [min]")
    style.labels(right, "start", "settled SOC RMSE [%]")
    style.side_legend(right)  # no mark below it
    return figure


def _logs_title(matrix: Matrix) -> str:
    """Which estimator is best on most logs, and how good it is there."""
    judged = np.isfinite(matrix.values).any(axis=0) if matrix.values.size else np.array([False])
    if not judged.any():
        return "No log was judged"
    best = np.nanargmin(matrix.values[:, judged], axis=0)
    most = int(np.argmax(np.bincount(best)))
    logs = np.count_nonzero(best == most)
    lowest = percent(float(np.nanmin(matrix.values[most])))
    return f"{matrix.estimators[most]} is best on {logs} of {best.size} logs, down to {lowest}"


def _recovery_title(rows: Rows, estimators: Sequence[str], errors: Sequence[float]) -> str:
    """Which estimator is back first from the starts that are farthest off, in every run."""
    farthest = max((abs(e) for e in errors), default=0.0)
    slowest = {}
    for name in estimators:
        times = [
            float(r["convergence_s"])
            for r in rows
            if r["estimator"] == name and abs(float(r["start_error"])) == farthest
        ]
        if farthest > 0.0 and times and np.isfinite(times).all():
            slowest[name] = max(times)
    if not slowest:
        return "No estimator came back in every run"
    first = min(slowest, key=lambda name: slowest[name])
    after = f"after {duration(slowest[first])}" if slowest[first] > 0.0 else "at once"
    return f"From {round(100.0 * farthest):d} points off {first} is back {after}"


def _settled_title(matrix: Matrix) -> str:
    """Which estimator ends best from its worst start."""
    known = [k for k, own in enumerate(matrix.values) if np.isfinite(own).all() and own.size]
    if not known:
        return "No estimator settled from every start"
    best = min(known, key=lambda k: float(np.max(matrix.values[k])))
    worst = percent(float(np.max(matrix.values[best])))
    return f"{matrix.estimators[best]} settles to {worst} or less from every start"


def temperature_picture(rows: Rows) -> Picture | None:
    """Settled RMSE over the log's temperature; None where all are alike."""
    chosen = [r for r in healthy(rows) if np.isfinite(r["temperature_C"])]
    if not chosen or np.ptp([r["temperature_C"] for r in chosen]) < WARM_SPREAD_K:
        return None
    return _temperature_picture(chosen, [o.estimator for o in overviews(rows)])


@pictured(
    "benchmark-temperature",
    "One dot per log: the mean over its starts, at the median temperature of the log.",
)
def _temperature_picture(rows: Rows, estimators: Sequence[str]) -> style.Figure:
    """Dots of every log, over its temperature."""
    figure = style.new_figure(3.2)
    axes = figure.subplots()
    looks = _looks(estimators)
    for name in estimators:
        own = [r for r in rows if r["estimator"] == name]
        dots = []
        for log in names(own, "log"):
            there = [r for r in own if r["log"] == log]
            dots.append((mean_of(there, "temperature_C"), 100 * mean_of(there, "settled_rmse")))
        dots.sort()
        if not dots:
            continue
        axes.plot(*np.array(dots).T, linestyle="none", markersize=5, label=name, **looks[name])
    axes.set_yscale("log")
    style.plain_numbers(axes.yaxis)
    style.finding(axes, "Settled error over temperature")
    style.labels(axes, "temperature of the log [°C]", "settled SOC RMSE [%]")
    style.side_legend(axes)
    return figure


def curve_pictures(
    rows: Rows, curves: Mapping[int, Mapping[str, Sequence[float]]]
) -> tuple[Picture, ...]:
    """SOC error over time of the first logs, every estimator from the farthest start."""
    groups: dict[str, list[int]] = {}
    for k in curves:
        groups.setdefault(log_name(rows[k]), []).append(k)
    pictures = []
    for log, members in list(groups.items())[: MOST.curves]:
        far = max(abs(float(rows[k]["start_error"])) for k in members)
        chosen = [k for k in members if abs(float(rows[k]["start_error"])) == far]
        first = float(rows[chosen[0]]["start_error"])
        chosen = [k for k in chosen if rows[k]["start_error"] == first]
        picture = _curve_picture(rows, curves, chosen, log)
        key, caption = f"{picture.key}-{safe_key(log)}", picture.caption
        where = f"{log}, {start_name(first)}"
        pictures.append(picture._replace(key=key, caption=f"{where}: {caption}"))
    return tuple(pictures)


@pictured(
    "benchmark-curve",
    "estimated minus true SOC, and the filter's own band of two standard deviations as thin lines.",
)
def _curve_picture(
    rows: Rows,
    curves: Mapping[int, Mapping[str, Sequence[float]]],
    chosen: Sequence[int],
    log: str,
) -> style.Figure:
    """Error curves of several runs."""
    figure = style.new_figure(3.4)
    axes = figure.subplots()
    order = [o.estimator for o in overviews(rows)]
    looks = _looks(order)
    largest = 2.0 * 100.0 * CONVERGED_SOC
    for k in sorted(chosen, key=lambda k: order.index(rows[k]["estimator"])):
        curve = curves[k]
        hours = np.array(curve["time_s"]) / 3600.0
        error, std = 100.0 * np.array(curve["error"]), 100.0 * np.array(curve["std"])
        colour = looks[rows[k]["estimator"]]["color"]
        name = f"{rows[k]['estimator']}: {percent(rows[k]['settled_rmse'])}"
        axes.plot(hours, error, color=colour, label=name)
        for side in (-2.0, 2.0):
            axes.plot(hours, side * std, color=colour, linewidth=0.5, alpha=0.6)
        late = error[hours.size // 5 :]
        if rows[k]["settled_rmse"] < 0.1 and late.size:
            largest = max(largest, 1.3 * float(np.nanmax(np.abs(late))))
    style.zero_line(axes)
    for level in (-100.0 * CONVERGED_SOC, 100.0 * CONVERGED_SOC):
        axes.axhline(level, color=style.MUTED, linewidth=0.8, linestyle=(0, (1, 2)))
    largest = min(largest, MOST_POINTS)
    axes.set_ylim(-largest, largest)
    best = min(chosen, key=lambda k: rows[k]["settled_rmse"])
    style.finding(axes, f"{log}: {rows[best]['estimator']} comes nearest")
    style.labels(axes, "time [h]", "SOC error [points]")
    style.legend(axes, columns=2, place="upper right")
    return figure
