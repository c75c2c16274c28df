"""A capacity study as the page takes it; the page itself is in :mod:`cellwise.report`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cellwise.errors import InputError
from cellwise.report.capacity_study_page import StudyOnPage, write_study_page
from cellwise.report.page.picture import FigureFiles
from cellwise.studies.capacity_study import CellStudy
from cellwise.studies.capacity_study_text import (
    choice_head,
    choice_row,
    named,
    papers_beside,
    verdicts,
)


def capacity_study_page(
    studies: Sequence[CellStudy],
    path: str | Path,
    *,
    figures: str | Path | FigureFiles | None = None,
) -> Path:
    """Write the page of a capacity study.

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
    return write_study_page(
        [on_page(study) for study in studies],
        path,
        first_line=study_finding(studies[0]),
        papers=papers_beside(),
        data={"studies": [study.to_dict() for study in studies]},
        figures=figures,
    )


def on_page(study: CellStudy) -> StudyOnPage:
    """One cell's study as plain values."""
    voltage = study.winner(study.kinds[0])
    soc = ""
    if len(study.kinds) > 1:
        kind = study.kinds[1]
        soc = f"SOC by {named(kind)}: {study.winner(kind).choice} best"
    estimators = tuple(study.choices[0].soc)
    return StudyOnPage(
        name=study.name,
        about=f"Identified again for every choice, judged on {', '.join(study.logs)}. SOC "
        f"reference: the tester's counter over {study.reference_Ah:g} Ah ({study.reference}), the "
        "same for all.",
        reference_Ah=study.reference_Ah,
        choices=[c.choice for c in study.choices],
        capacity_Ah=[c.capacity_Ah for c in study.choices],
        voltage_rmse_V=[c.voltage_rmse_V for c in study.choices],
        soc_rmse={e: [c.soc[e].rmse for c in study.choices] for e in estimators},
        names={e: named(e) for e in estimators},
        titles=(f"voltage: {voltage.choice} best, {1e3 * voltage.value:.1f} mV", soc),
        verdicts=verdicts(study),
        head=choice_head(study),
        rows=[choice_row(c) for c in study.choices],
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
