"""The standings of a leaderboard on a page: how estimators rank, and how sure that is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.benchmark.leaderboard import (
    BAND_HEAD,
    HEAD,
    Standing,
    band_cells,
    standing_cells,
    standings,
)
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
Runs = Mapping[str, Sequence[Mapping[str, Any]]]


def standings_sections(
    entries: Sequence[Mapping[str, Any]], not_run: Sequence[tuple[str, str]] = ()
) -> list[Section]:
    """A section for the whole suite and one for its quick cut, where estimators ran them."""
    runs = {e["row"]["estimator"]: e["row"]["runs"] for e in entries}
    made = {e["row"]["estimator"]: e for e in entries}
    sections = []
    for key, title, quick in (("standings", "Leaderboard", False), ("quick", "Quick cut", True)):
        found = standings(runs, quick=quick)
        if not found:
            continue
        bands = [
            band_cells(s, made[s.estimator]["made_with"], made[s.estimator].get("by", ""))
            for s in found
        ]
        blocks: list[Markup | Picture] = [
            standings_picture(found, runs, quick)._replace(key=f"benchmark-{key}"),
            table(HEAD, [standing_cells(s) for s in found], caption=MEANS, text_columns=(1,)),
            table(BAND_HEAD, bands, text_columns=(0, 7, 8)),
        ]
        if not_run and not quick:
            blocks += [
                paragraph("Not run:"),
                bullets([f"{name}: {why}" for name, why in not_run], "notices"),
            ]
        sections.append(Section(key, title, tuple(blocks), title))
    return sections


def standings_page(entries: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """The leaderboard alone, as a page."""
    title = f"Leaderboard '{entries[0]['suite']}', by cellwise"
    sections = standings_sections(entries)
    return write_page(path, title, title, sections, {"rows": [e["row"] for e in entries]})


@pictured(
    "benchmark-standings",
    "Large: mean over the hard runs of all logs. Small: every log. Further left is better; the "
    "scale is logarithmic.",
)
def _standings_picture(found: Sequence[Standing], runs: Runs, quick: bool) -> style.Figure:
    """Dots over a logarithmic scale, a line per estimator, the best on top."""
    figure = style.new_figure(1.0 + 0.3 * max(len(found), 2))
    axes = figure.subplots()
    for place, one in enumerate(found):
        own = [r for r in runs[one.estimator] if not r["easy"] and (r["quick"] or not quick)]
        logs = sorted({r["log"] for r in own})
        means = [np.mean([_number(r["settled_rmse"]) for r in own if r["log"] == g]) for g in logs]
        dots = np.maximum(100.0 * np.array(means), 0.02)
        axes.plot(dots, np.full(dots.size, place), "o", color=style.MUTED, markersize=3)
        if one.hard is not None:
            axes.plot([100.0 * one.hard], [place], "D", color=style.CYCLE[0], markersize=7)
    axes.set_xscale("log")
    axes.set_yticks(range(len(found)), [_label(one) for one in found])
    axes.set_ylim(len(found) - 0.5, -0.5)
    style.plain_numbers(axes.xaxis)
    first = found[0]
    if first.hard is not None:
        style.finding(axes, f"{first.estimator} comes nearest: {100 * first.hard:.2f} points")
    style.labels(axes, "settled SOC RMSE, hard runs [points]", " ")
    return figure


def standings_picture(found: Sequence[Standing], runs: Runs, quick: bool) -> Picture:
    """Who stands where, over every log."""
    return _standings_picture(found, runs, quick)


def _label(one: Standing) -> str:
    return (
        one.estimator
        if one.rank is None
        else f"{one.estimator}  {one.rank} [{one.low}, {one.high}]"
    )


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)
