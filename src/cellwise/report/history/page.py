"""The page of a life: capacity and resistance with bands, counted tests and windows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellwise.history.life import Life
from cellwise.report.page.markup import Markup, details, lead_of, paragraph, table, tiles
from cellwise.report.page.numerals import percent, plural, significant
from cellwise.report.page.picture import FigureFiles, Picture
from cellwise.report.page.section import Section, write_page
from cellwise.report.page.style import (
    BLUE,
    GREEN,
    MUTED,
    VERMILLION,
    finding,
    labels,
    legend,
    new_figure,
    styled,
)

if TYPE_CHECKING:
    from cellwise.report.page.style import Figure

UNITS = {"days": "days since the first log", "throughput_Ah": "charge moved in these logs [Ah]"}


def history_page(
    found: Life, path: str | Path, *, figures: str | Path | FigureFiles | None = None
) -> Path:
    """Write the page of a life.

    Raises
    ------
    InputError        matplotlib is missing; the path cannot be written
    """
    data = found.to_dict()
    share, std = float(found.trend.share[-1]), float(found.trend.std[-1])
    use = data["trend"]["use"]
    known = f"{use['capacity_Ah']:.3g} ± {2 * use['capacity_std_Ah']:.2g}"
    key_figures = tiles(
        [
            ("of the new cell's capacity", f"{percent(share, 1)} ± {percent(2 * std, 1)}"),
            ("capacity to use [Ah]", known),
            ("resistance to use", f"{significant(use['resistance_scale'], 3)} of the model's"),
            ("logs", str(len(found.logs))),
        ]
    )
    notices = [*data["notices"], *(n for one in data["logs"] for n in one["notices"])]
    sections = [
        Section("capacity", "Capacity", (_capacity_picture(found),), "Capacity"),
        Section("resistance", "Resistance", (_resistance_picture(found),), "Resistance"),
        Section(
            "next",
            "The next reference test",
            (paragraph(data["trend"]["next_reference"].capitalize() + "."),),
            "Next test",
        ),
        Section("table", "Every log", (details("the numbers", _table(found)),), "Table"),
    ]
    return write_page(
        path,
        _first_line(found),
        f"{plural(len(found.logs), 'log')} of one life, by cellwise",
        sections,
        data,
        lead=lead_of(list(dict.fromkeys(notices)), key_figures),
        figures=figures,
    )


def _first_line(found: Life) -> str:
    """What was lost, where that is more than two standard deviations of the trend."""
    first, last = float(found.trend.share[0]), float(found.trend.share[-1])
    lost, known = 1.0 - last / first, 2.0 * float(found.trend.std[-1]) / first
    if abs(lost) > known:
        what = "lost" if lost > 0.0 else "gained"
        size = f"{percent(abs(lost), 1)} ± {percent(known, 1)}"
        return f"{size} of the capacity {what} since the first log"
    return (
        f"No change of the capacity can be determined: {percent(-lost, 1)} since the first log, "
        f"± {percent(known, 1)}"
    )


def _capacity_picture(found: Life) -> Picture:
    return Picture(
        "history_capacity",
        draw_capacity(found),
        "Each dot is a log with two standard deviations: counted over a complete half cycle, or "
        "from whatever part of the range it covers. The line is the trend, its band what the next "
        "complete test would show in 95 of 100 cases.",
    )


@styled
def draw_capacity(found: Life) -> Figure:
    """Share of the new cell's capacity over the life."""
    figure = new_figure(3.4)
    axes = figure.subplots()
    counted = np.array([one.counted for one in found.logs])
    share = 100.0 * np.array([one.share for one in found.logs])
    std = 100.0 * np.array([one.share_std for one in found.logs])
    for rows, colour, label in (
        (~counted, MUTED, "window or drive"),
        (counted, GREEN, "complete half cycle"),
    ):
        if rows.any():
            axes.errorbar(
                found.way[rows], share[rows], 2.0 * std[rows], fmt="o", color=colour, label=label,
                markersize=3.5, linewidth=0.8,
            )  # fmt: skip
    trend, band = 100.0 * found.trend.share, 200.0 * found.trend.std
    axes.plot(found.way, trend, color=BLUE, label="trend")
    axes.fill_between(found.way, trend - band, trend + band, color=BLUE, alpha=0.18, linewidth=0)
    low = min(float(np.min(trend - band)), float(np.min(share))) - 2.0
    axes.set_ylim(low, max(float(np.max(trend + band)), float(np.max(share))) + 2.0)
    if found.trend.knee is not None:
        axes.axvline(found.way[found.trend.knee], color=VERMILLION, linewidth=1.0, label="knee")
    legend(axes)
    finding(axes, f"{trend[-1]:.1f} ± {band[-1]:.1f} % of the new cell's capacity at the last log")
    labels(axes, UNITS[found.over], "share of the new cell's capacity [%]")
    return figure


def _resistance_picture(found: Life) -> Picture:
    return Picture(
        "history_resistance",
        draw_resistance(found),
        "Resistance on the model's, at each log's own temperature and load.",
    )


@styled
def draw_resistance(found: Life) -> Figure:
    """Resistance over the life."""
    figure = new_figure(2.6)
    axes = figure.subplots()
    scale = np.array([one.resistance_scale for one in found.logs])
    std = np.array([one.resistance_std for one in found.logs])
    axes.errorbar(found.way, scale, 2.0 * std, fmt="o", color=BLUE, markersize=3.5, linewidth=0.8)
    now, now_std = found.resistance
    finding(axes, f"Resistance now: {now:.2f} ± {2 * now_std:.2f} of the model's")
    labels(axes, UNITS[found.over], "resistance / model's")
    return figure


def _table(found: Life) -> Markup:
    head = ("log", "capacity Ah", "±", "resistance", "±", "share", "trend", "±", "by")
    rows = [
        (
            one.log.name,
            significant(one.capacity_Ah, 4),
            significant(one.capacity_std_Ah, 2),
            significant(one.resistance_scale, 4),
            significant(one.resistance_std, 2),
            percent(one.share, 1),
            percent(float(found.trend.share[k]), 1),
            percent(float(found.trend.std[k]), 1),
            one.how,
        )
        for k, one in enumerate(found.logs)
    ]
    return Markup(table(head, rows))
