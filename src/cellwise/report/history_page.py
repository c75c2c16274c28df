"""The page of a life: capacity and resistance with bands, counted tests and windows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.arguments import check_kind
from cellwise.history.ageing import AgeingHistory, AgeingRecord
from cellwise.report.page import style
from cellwise.report.page.markup import details, lead_of, record_table, tiles
from cellwise.report.page.numerals import SPACE, banded, percent, plural
from cellwise.report.page.picture import Figures, pictured
from cellwise.report.page.section import Section, write_page

UNITS = {"days": "days since the first log", "throughput_Ah": "charge moved in these logs [Ah]"}


def history_page(found: AgeingHistory, path: str | Path, *, figures: Figures = None) -> Path:
    """Write the page of a life.

    Raises
    ------
    InputError        matplotlib is missing; the path cannot be written
    """
    check_kind("found", found, AgeingHistory, "Pass what ageing_history(model, logs) gives.")
    data = found.to_dict()
    use = data["trend"]["use"]
    now, now_std = found.resistance_scale, found.resistance_std
    known = (
        "unknown"
        if found.withheld
        else f"{use['capacity_Ah']:.3g} ± {2 * use['capacity_std_Ah']:.2g} Ah"
    )
    resistance = "unknown" if found.withheld else f"{now:.2f} ± {2 * now_std:.2f}"
    key_figures = tiles(
        [
            ("of the new cell's capacity", _now(found)),
            ("capacity to use", known),
            ("resistance, times the model's", resistance),
            ("logs", str(len(found.logs))),
        ]
    )
    notices = [*data["notices"], *(n for one in data["logs"] for n in one["notices"])]
    test = data["trend"]["next_reference"].replace("+-", "±")
    sections = [
        Section(
            "table",
            "Every log",
            (details("the numbers", record_table(log_rows(found), *LOG_COLUMNS)),),
            "Table",
        ),
    ]
    if not found.withheld:
        sections = [
            Section(
                "life",
                "Capacity and resistance",
                (capacity_picture(found), resistance_picture(found)),
            ),
            *sections,
        ]
    return write_page(
        path,
        _first_line(found),
        f"{plural(len(found.logs), 'log')} of one life, by cellwise",
        sections,
        data,
        lead=lead_of(list(dict.fromkeys(notices)), key_figures, [_next(test)]),
        figures=figures,
    )


def _next(test: str) -> str:
    """Whether to test the cell next, and how."""
    none, _, why = test.partition(": ")
    return f"No reference test is needed: {why}." if none == "none" else f"Next test: {test}."


def _now(found: AgeingHistory) -> str:
    """The share of the new cell's capacity at the last log, the same everywhere."""
    if found.withheld:
        return "unknown"
    share, std = found.share
    return f"{100.0 * share:.1f} ± {200.0 * std:.1f}{SPACE}%"


def _first_line(found: AgeingHistory) -> str:
    """What was lost, where the logs show it: beyond two standard deviations; else the capacity."""
    if found.withheld:
        return "Far off this model: neither capacity nor resistance can be said"
    change = found.change
    if change.shown:
        what = "lost" if change.share < 0.0 else "gained"
        size = f"{100.0 * abs(change.share):.1f} ± {200.0 * change.std:.1f}{SPACE}%"
        return f"{size} of the new cell's capacity {what} since the first log"
    capacity = f"{found.capacity_Ah:.3g} ± {2.0 * found.capacity_std_Ah:.2g} Ah"
    if len(found.logs) == 1:
        return f"Capacity {capacity} by one log"
    return (
        f"Capacity {capacity} by all {len(found.logs)} logs; no change shown since the first "
        f"({percent(change.share, 1)} ± {percent(2.0 * change.std, 1)} of the new cell's)"
    )


@pictured(
    "history_capacity",
    "Each dot is a log with two standard deviations: counted over a complete half cycle, or "
    "from whatever part of the range it covers. The line is the trend, its band what the next "
    "complete test would show in 95 of 100 cases.",
)
def capacity_picture(found: AgeingHistory) -> style.Figure:
    """Share of the new cell's capacity over the life."""
    figure, axes = style.new_axes()
    counted = np.array([one.counted for one in found.logs])
    share = 100.0 * np.array([one.share for one in found.logs])
    std = 100.0 * np.array([one.share_std for one in found.logs])
    for rows, colour, label in (
        (~counted, style.MUTED, "window or drive"),
        (counted, style.GREEN, "complete half cycle"),
    ):
        if rows.any():
            looks: dict[str, Any] = {"color": colour, "label": label}
            style.error_dots(axes, found.way[rows], share[rows], std[rows], **looks)
    trend, band = 100.0 * found.trend.share, 200.0 * found.trend.std
    axes.plot(found.way, trend, color=style.BLUE, label="trend", zorder=4)
    looks = {"color": style.BLUE, "alpha": 0.18, "linewidth": 0}
    axes.fill_between(found.way, trend - band, trend + band, **looks)
    low = min(np.min(trend - band), np.min(share - 2.0 * std))
    high = max(np.max(trend + band), np.max(share + 2.0 * std))
    axes.set_ylim(float(low) - 2.0, float(high) + 2.0)
    if found.trend.knee is not None:
        at = found.way[found.trend.knee]
        axes.axvline(at, color=style.VERMILLION, linewidth=1.0, label="knee")
    style.key_below(axes)
    style.finding(axes, f"{_now(found)} of the new cell's capacity at the last log")
    style.labels(axes, UNITS[found.over], "share of new capacity [%]")
    return figure


@pictured(
    "history_resistance",
    "Times the model's, at each log's own temperature and load. Logs of unlike loads scatter by "
    "more than their bars: believe the run of the dots, not one of them.",
)
def resistance_picture(found: AgeingHistory) -> style.Figure:
    """Resistance over the life."""
    figure, axes = style.new_axes()
    scale = np.array([one.resistance_scale for one in found.logs])
    std = np.array([one.resistance_std for one in found.logs])
    style.error_dots(axes, found.way, scale, std)
    now, now_std = found.resistance_scale, found.resistance_std
    style.finding(axes, f"Resistance now: {now:.2f} ± {2 * now_std:.2f} of the model's")
    style.labels(axes, UNITS[found.over], "resistance / model's")
    return figure


def log_rows(found: AgeingHistory) -> Iterator[tuple[AgeingRecord, float, float]]:
    """Every log with the trend there, and its deviation, shares of the new cell's capacity."""
    return zip(found.logs, found.trend.share.tolist(), found.trend.std.tolist(), strict=True)


# Of one of them: how it reads on a page and in a command.
LOG_COLUMNS: tuple[tuple[str, Callable[[tuple[AgeingRecord, float, float]], str]], ...] = (
    ("log", lambda one: one[0].log.name),
    ("capacity Ah", lambda one: banded(one[0].capacity_Ah, one[0].capacity_std_Ah)),
    ("resistance", lambda one: banded(one[0].resistance_scale, one[0].resistance_std)),
    ("share", lambda one: percent(one[0].share, 1)),
    ("trend", lambda one: f"{percent(one[1], 1)} ± {percent(2.0 * one[2], 1)}"),
    ("by", lambda one: one[0].how),
)
