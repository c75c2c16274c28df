"""Capacity study: what every choice of the capacity costs, drawn over the capacity itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellwise.benchmark.capacity_study import CellStudy
from cellwise.benchmark.capacity_study_text import (
    choice_head,
    choice_row,
    named,
    papers_beside,
    verdicts,
)
from cellwise.errors import InputError
from cellwise.report.markup import Markup, bullets, paragraph, table
from cellwise.report.picture import Picture
from cellwise.report.section import Section, write_page
from cellwise.report.style import (
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
    from cellwise.report.style import Axes, Figure

COLOURS = {"coulomb": AMBER, "ekf": BLUE, "ukf": GREEN, "adaptive": PURPLE}
MARKERS = {"coulomb": "s", "ekf": "o", "ukf": "^", "adaptive": "D"}
# A number within this share of its neighbour shares its label.
TOO_NEAR = 0.004


def capacity_study_page(
    studies: Sequence[CellStudy], path: str | Path, *, figures: str | Path | None = None
) -> Path:
    """Write the page of a capacity study.

    Parameters
    ----------
    studies : of CellStudy        the first one gives the page's first line
    path : str or Path            of the HTML file; it appears whole or not at all
    figures : str, Path or None   folder for the same pictures as PNG and SVG files

    Raises
    ------
    InputError        no study; matplotlib is missing; the path cannot be written
    """
    if not studies:
        raise InputError("no study for the page", "at least one", "Study a cell first.")
    return write_page(
        path,
        study_finding(studies[0]),
        f"Capacity study of {', '.join(s.name for s in studies)}, by cellwise",
        [capacity_study_section(s, k) for k, s in enumerate(studies)]
        + [Section("papers", "The papers' order", (bullets(papers_beside()),), "Papers")],
        {"studies": [s.to_dict() for s in studies]},
        figures=figures,
    )


def study_finding(study: CellStudy) -> str:
    """One line: what the choice of the capacity does to SOC."""
    kind = study.kinds[1] if len(study.kinds) > 1 else study.kinds[0]
    winner, last = study.winner(kind), study.order(kind)[-1]
    worst = next(c for c in study.choices if c.choice == last)
    if kind == study.kinds[0]:
        return f"{study.name}: {winner.choice} fits the voltage best"
    return (
        f"{study.name}: {winner.choice} as the capacity leaves {100 * winner.value:.2f} points of "
        f"SOC error in {named(kind)}, {last} {100 * worst.soc[kind].rmse:.2f}"
    )


def capacity_study_section(study: CellStudy, number: int = 0) -> Section:
    """Picture, verdicts and table of one cell."""
    about = (
        f"Identified anew for every choice, judged on {', '.join(study.logs)}. SOC reference: the "
        f"tester's counter over {study.reference_Ah:g} Ah ({study.reference}), the same for all."
    )
    return Section(
        f"capacity-study-{number}",
        f"Which charge is the capacity: {study.name}",
        (
            paragraph(about),
            study_picture(study, number),
            bullets(verdicts(study)),
            Markup(
                table(
                    choice_head(study),
                    [choice_row(c) for c in study.choices],
                    caption="RMSE of simulated voltage and of SOC; signed SOC error where the "
                    "discharge ends.",
                )
            ),
        ),
        study.name,
    )


def study_picture(study: CellStudy, number: int = 0) -> Picture:
    """Voltage and SOC error over the capacity that was chosen."""
    caption = (
        "Every dot is a choice of the capacity, with the whole identification redone. Left: the "
        "voltage hardly minds until the scale ends before the cell does. Right: SOC minds at once, "
        "and a filter can only follow the scale that its OCV was given. The line is the reference."
    )
    return Picture(f"capacity_study_{number}", draw_study(study), caption)


@styled
def draw_study(study: CellStudy) -> Figure:
    """Two axes over the capacity."""
    figure = new_figure(3.1)
    left, right = figure.subplots(1, 2)
    capacity = np.array([c.capacity_Ah for c in study.choices])
    order = np.argsort(capacity)
    left.plot(
        capacity[order],
        [1e3 * study.choices[k].voltage_rmse_V for k in order],
        "o-",
        color=VERMILLION,
        linewidth=1.0,
    )
    for name in study.choices[0].soc:
        right.plot(
            capacity[order],
            [100 * study.choices[k].soc[name].rmse for k in order],
            marker=MARKERS.get(name, "o"),
            color=COLOURS.get(name, INK),
            linewidth=1.0,
            markersize=4,
            label=named(name),
        )
    for axes in (left, right):
        axes.axvline(study.reference_Ah, color=MUTED, linewidth=1.0)
        axes.set_ylim(bottom=0.0)
    _name_choices(left, study)
    voltage = study.winner(study.kinds[0])
    finding(left, f"voltage: {voltage.choice} best, {1e3 * voltage.value:.1f} mV", 0.42)
    labels(left, "capacity [Ah]", "voltage RMSE [mV]")
    if study.choices[0].soc:
        legend(right)
        kind = study.kinds[1]
        best = study.winner(kind)
        finding(right, f"SOC by {named(kind)}: {best.choice} best", 0.42)
    labels(right, "capacity [Ah]", "SOC RMSE [points]")
    return figure


def _name_choices(axes: Axes, study: CellStudy) -> None:
    """Names beside the dots, one for all that share a spot."""
    spots: list[tuple[float, float, list[str]]] = []
    for c in sorted(study.choices, key=lambda c: c.capacity_Ah):
        if spots and abs(c.capacity_Ah / spots[-1][0] - 1.0) < TOO_NEAR:
            spots[-1][2].append(c.choice)
        else:
            spots.append((c.capacity_Ah, 1e3 * c.voltage_rmse_V, [c.choice]))
    for x, y, names in spots:
        text = names[0] if len(names) == 1 else f"{names[0]} +{len(names) - 1}"
        axes.annotate(
            text, (x, y), (0, 6), textcoords="offset points", rotation=60, fontsize=7, color=INK
        )
