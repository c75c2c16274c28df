"""The standings of a leaderboard on a page: how estimators rank, and how sure that is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.report.page import style
from cellwise.report.page.markup import Markup, bullets, paragraph, table
from cellwise.report.page.picture import Picture, pictured
from cellwise.report.page.section import Section, write_page

MEANS = (
    "Settled SOC RMSE in points, mean over logs of the mean over hard runs: from the middle, under "
    "load, 30 points wrong, or with a fault; easy runs (the right start and nothing wrong) have a "
    "column of their own and no part in a rank. In brackets what holds 95 % over resampled logs. "
    "Ended within 3 points: share of runs whose last error is. Interval score: width of the "
    "band of two deviations and 40 times what lies outside, smaller is better."
)


def standings_sections(
    parts: Sequence[Mapping[str, Any]], not_run: Sequence[tuple[str, str]] = ()
) -> list[Section]:
    """A section for each part of a leaderboard, as `cellwise.benchmark.submission` makes them."""
    sections = []
    for k, part in enumerate(parts):
        blocks: list[Markup | Picture] = [
            _standings_picture(part)._replace(key=f"benchmark-standings-{k}"),
            table(part["head"], part["cells"], caption=MEANS, text_columns=(1,)),
            table(part["band_head"], part["bands"], text_columns=(0, 7, 8)),
        ]
        if not_run and k == 0:
            said = [f"{name}: {why}" for name, why in not_run]
            blocks += [paragraph("Not run:"), bullets(said, "notices")]
        sections.append(Section(f"standings-{k}", part["title"], tuple(blocks), part["title"]))
    return sections


def standings_page(suite: str, parts: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """The leaderboard alone, as a page."""
    title = f"Leaderboard '{suite}', by cellwise"
    return write_page(path, title, title, standings_sections(parts), {"suite": suite})


@pictured(
    "benchmark-standings",
    "Large: mean over the hard runs of all logs. Small: every log. Further left is better; the "
    "scale is logarithmic.",
)
def _standings_picture(part: Mapping[str, Any]) -> style.Figure:
    """Dots over a logarithmic scale, a line per estimator, the best on top."""
    names = part["names"]
    figure = style.new_figure(1.0 + 0.3 * max(len(names), 2))
    axes = figure.subplots()
    for place, (means, hard) in enumerate(zip(part["by_log"], part["hard"], strict=True)):
        dots = np.maximum(100.0 * np.array(means), 0.02)
        axes.plot(dots, np.full(dots.size, place), "o", color=style.MUTED, markersize=3)
        if hard is not None:
            axes.plot([100.0 * hard], [place], "D", color=style.CYCLE[0], markersize=7)
    axes.set_xscale("log")
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    style.plain_numbers(axes.xaxis)
    if part["hard"][0] is not None:
        style.finding(axes, f"{names[0]} comes nearest: {100 * part['hard'][0]:.2f} points")
    style.labels(axes, "settled SOC RMSE, hard runs [points]", " ")
    return figure
