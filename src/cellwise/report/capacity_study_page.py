"""The page of a capacity study: what every choice of the capacity costs, over the capacity."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cellwise.errors import InputError
from cellwise.report.page import style
from cellwise.report.page.markup import bullets, paragraph, table
from cellwise.report.page.picture import FigureFiles, pictured
from cellwise.report.page.section import Section, write_page
from cellwise.studies.capacity_study import CellStudy
from cellwise.studies.capacity_study_text import (
    choice_head,
    choice_row,
    named,
    papers_beside,
    study_finding,
    verdicts,
)

# Colour and marker of an estimator's line.
LOOKS = {
    "coulomb": (style.AMBER, "s"),
    "ekf": (style.BLUE, "o"),
    "ukf": (style.GREEN, "^"),
    "adaptive": (style.PURPLE, "D"),
}
# A capacity within this share of its neighbour's shares its label.
TOO_NEAR = 0.004


def capacity_study_page(
    studies: Sequence[CellStudy],
    path: str | Path,
    *,
    figures: str | Path | FigureFiles | None = None,
) -> Path:
    """Write the page of a capacity study: a section per cell, the papers' order.

    Parameters
    ----------
    studies : of CellStudy        the first one gives the page's first line
    path : str or Path            of the HTML file; it appears whole or not at all
    figures : folder or FigureFiles   for the same pictures as PNG and SVG files

    Raises
    ------
    InputError        no study; matplotlib is missing; the path cannot be written
    """
    if not studies:
        raise InputError("no study for the page", "at least one", "Study a cell first.")
    papers = Section("papers", "The papers' order", (bullets(papers_beside()),), "Papers")
    return write_page(
        path,
        study_finding(studies[0]),
        f"Capacity study of {', '.join(s.name for s in studies)}, by cellwise",
        [*(study_section(s, k) for k, s in enumerate(studies)), papers],
        {"studies": [study.to_dict() for study in studies]},
        figures=figures,
    )


def study_section(study: CellStudy, number: int = 0) -> Section:
    """Picture, verdicts and table of one cell."""
    key = f"capacity_study_{number}"
    text = (
        f"Identified again for every choice, judged on {', '.join(study.logs)}. SOC reference: the "
        f"tester's counter over {study.reference_Ah:g} Ah ({study.reference}), the same for all."
    )
    figures = table(
        choice_head(study),
        [choice_row(c) for c in study.choices],
        caption="RMSE of simulated voltage and of SOC; signed SOC error where the discharge ends.",
    )
    picture = study_picture(study)._replace(key=key)
    blocks = (paragraph(text), picture, bullets(verdicts(study)), figures)
    title = f"Which charge is the capacity: {study.name}"
    return Section(key.replace("_", "-"), title, blocks, study.name)


@pictured(
    "capacity_study",
    "Every dot is a choice of the capacity, with the whole identification redone. First: the "
    "voltage, which hardly depends on it until the scale ends before the cell does. Then: the SOC, "
    "which does; a filter can only follow the scale of its OCV. The line is the reference.",
)
def study_picture(study: CellStudy) -> style.Figure:
    """Two axes over the capacity."""
    figure = style.new_figure(3.1)
    left, right = style.panels(figure, 1, 2)
    choices = sorted(study.choices, key=lambda c: c.capacity_Ah)
    voltage, *filters = study.kinds
    capacity = np.array([c.capacity_Ah for c in choices])
    rmse_mV = 1e3 * np.array([c.voltage_rmse_V for c in choices])
    left.plot(capacity, rmse_mV, "o-", color=style.VERMILLION, linewidth=1.0)
    for kind in filters:
        colour, marker = LOOKS.get(kind, (style.INK, "o"))
        rmse = 100.0 * np.array([c.figure(kind) for c in choices])
        right.plot(
            capacity, rmse, color=colour, marker=marker, linewidth=1.0, ms=4, label=named(kind)
        )
    for axes in (left, right):
        axes.axvline(study.reference_Ah, color=style.MUTED, linewidth=1.0)
        axes.margins(y=0.0)
        axes.set_ylim(0.0, 1.3 * axes.get_ylim()[1])  # room for the names
    _name_choices(left, study)
    best = study.winner(voltage)
    style.finding(left, f"voltage: {best.choice} best, {1e3 * best.value:.1f} mV", 0.42)
    style.labels(left, "capacity [Ah]", "voltage RMSE [mV]")
    if filters:
        style.legend(right)
        best = study.winner(filters[0])
        style.finding(right, f"SOC by {named(filters[0])}: {best.choice} best", 0.42)
    style.labels(right, "capacity [Ah]", "SOC RMSE [points]")
    return figure


def _name_choices(axes: style.Axes, study: CellStudy) -> None:
    """Names beside the dots, one for all that share a spot."""
    spots: list[tuple[float, float, list[str]]] = []
    for one in sorted(study.choices, key=lambda c: c.capacity_Ah):
        if spots and abs(one.capacity_Ah / spots[-1][0] - 1.0) < TOO_NEAR:
            spots[-1][2].append(one.choice)
        else:
            spots.append((one.capacity_Ah, 1e3 * one.voltage_rmse_V, [one.choice]))
    for x, y, names in spots:
        text = names[0] if len(names) == 1 else f"{names[0]} +{len(names) - 1}"
        style.note(axes, text, (x, y), (0, 6), rotation=60, color=style.INK)
