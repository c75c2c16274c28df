"""The page of a capacity study: what every choice of the capacity costs, over the capacity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cellwise.report.page.markup import Markup, bullets, paragraph, table
from cellwise.report.page.picture import FigureFiles, Picture
from cellwise.report.page.section import Section, write_page
from cellwise.report.page.style import (
    AMBER,
    BLUE,
    GREEN,
    INK,
    MUTED,
    PURPLE,
    VERMILLION,
    finding,
    labels,
    legend,
    new_figure,
    styled,
)

if TYPE_CHECKING:
    from cellwise.report.page.style import Axes, Figure

COLOURS = {"coulomb": AMBER, "ekf": BLUE, "ukf": GREEN, "adaptive": PURPLE}
MARKERS = {"coulomb": "s", "ekf": "o", "ukf": "^", "adaptive": "D"}
# A number within this share of its neighbour shares its label.
TOO_NEAR = 0.004


class StudyOnPage(NamedTuple):
    """One cell's study as the page shows it.

    ``soc_rmse`` holds one RMSE per choice under every estimator, ``names`` what people call it;
    ``titles`` are the titles of the two axes; ``head`` and ``rows`` the table.
    """

    name: str
    about: str
    reference_Ah: float
    choices: Sequence[str]
    capacity_Ah: Sequence[float]
    voltage_rmse_V: Sequence[float]
    soc_rmse: Mapping[str, Sequence[float]]
    names: Mapping[str, str]
    titles: tuple[str, str]
    verdicts: Sequence[str]
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def write_study_page(
    studies: Sequence[StudyOnPage],
    path: str | Path,
    *,
    first_line: str,
    papers: Sequence[str],
    data: Mapping[str, Any],
    figures: str | Path | FigureFiles | None = None,
) -> Path:
    """Write the page: a section per cell, the papers' order, the figures for machines.

    Raises
    ------
    InputError        matplotlib is missing; the path cannot be written
    """
    return write_page(
        path,
        first_line,
        f"Capacity study of {', '.join(s.name for s in studies)}, by cellwise",
        [study_section(s, k) for k, s in enumerate(studies)]
        + [Section("papers", "The papers' order", (bullets(papers),), "Papers")],
        data,
        figures=figures,
    )


def study_section(study: StudyOnPage, number: int = 0) -> Section:
    """Picture, verdicts and table of one cell."""
    return Section(
        f"capacity-study-{number}",
        f"Which charge is the capacity: {study.name}",
        (
            paragraph(study.about),
            study_picture(study, number),
            bullets(study.verdicts),
            Markup(
                table(
                    study.head,
                    study.rows,
                    caption="RMSE of simulated voltage and of SOC; signed SOC error where the "
                    "discharge ends.",
                )
            ),
        ),
        study.name,
    )


def study_picture(study: StudyOnPage, number: int = 0) -> Picture:
    """Voltage and SOC error over the capacity that was chosen."""
    caption = (
        "Every dot is a choice of the capacity, with the whole identification redone. Left: the "
        "voltage hardly depends on it until the scale ends before the cell does. Right: SOC does, "
        "and a filter can only follow the scale that its OCV was given. The line is the reference."
    )
    return Picture(f"capacity_study_{number}", draw_study(study), caption)


@styled
def draw_study(study: StudyOnPage) -> Figure:
    """Two axes over the capacity."""
    figure = new_figure(3.1)
    left, right = figure.subplots(1, 2)
    capacity = np.array(study.capacity_Ah)
    order = np.argsort(capacity)
    left.plot(
        capacity[order],
        1e3 * np.array(study.voltage_rmse_V)[order],
        "o-",
        color=VERMILLION,
        linewidth=1.0,
    )
    for name, values in study.soc_rmse.items():
        right.plot(
            capacity[order],
            100.0 * np.array(values)[order],
            marker=MARKERS.get(name, "o"),
            color=COLOURS.get(name, INK),
            linewidth=1.0,
            markersize=4,
            label=study.names.get(name, name),
        )
    for axes in (left, right):
        axes.axvline(study.reference_Ah, color=MUTED, linewidth=1.0)
        axes.margins(y=0.0)
        axes.set_ylim(0.0, 1.3 * axes.get_ylim()[1])  # room for the names
    _name_choices(left, study)
    finding(left, study.titles[0], 0.42)
    labels(left, "capacity [Ah]", "voltage RMSE [mV]")
    if study.soc_rmse:
        legend(right)
        finding(right, study.titles[1], 0.42)
    labels(right, "capacity [Ah]", "SOC RMSE [points]")
    return figure


def _name_choices(axes: Axes, study: StudyOnPage) -> None:
    """Names beside the dots, one for all that share a spot."""
    spots: list[tuple[float, float, list[str]]] = []
    dots = zip(study.capacity_Ah, study.voltage_rmse_V, study.choices, strict=True)
    for capacity, rmse, name in sorted(dots, key=lambda dot: dot[0]):
        if spots and abs(capacity / spots[-1][0] - 1.0) < TOO_NEAR:
            spots[-1][2].append(name)
        else:
            spots.append((capacity, 1e3 * rmse, [name]))
    for x, y, names in spots:
        text = names[0] if len(names) == 1 else f"{names[0]} +{len(names) - 1}"
        axes.annotate(
            text, (x, y), (0, 6), textcoords="offset points", rotation=60, fontsize=7, color=INK
        )
