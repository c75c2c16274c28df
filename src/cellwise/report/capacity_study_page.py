"""The capacity study as text and page: which choice wins, by how much, and why."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cellwise.errors import InputError
from cellwise.report.page import style
from cellwise.report.page.markup import bullets, paragraph, table
from cellwise.report.page.numerals import capitalised
from cellwise.report.page.picture import FigureFiles, pictured
from cellwise.report.page.section import Blocks, Section, write_page
from cellwise.studies.capacity_study import VOLTAGE, CellStudy, ChoiceResult, Winner
from cellwise.studies.capacity_study_cells import published_orders
from cellwise.studies.published import LFP_CELL, LFP_ERRORS, NCA_CELL, NCA_RESIDUALS

NAMES = {
    VOLTAGE: "simulated voltage",
    "coulomb": "coulomb counting",
    "ekf": "EKF",
    "ukf": "UKF",
    "adaptive": "adaptive",
}

SHORT = {"coulomb": "count", "ekf": "EKF", "ukf": "UKF", "adaptive": "adapt"}


def named(kind: str) -> str:
    """A figure's name in text."""
    return NAMES.get(kind, kind)


def amount(kind: str, value: float) -> str:
    """An RMSE or a difference of two, with its unit."""
    return f"{1e3 * value:.1f} mV" if kind == VOLTAGE else f"{100 * value:.2f} points"


def choice_head(study: CellStudy) -> tuple[str, ...]:
    """Head of the table of choices."""
    filters = tuple(study.choices[0].soc)
    return (
        "choice", "Ah", "own fit mV", "voltage mV", "above 10 %",
        *(f"{SHORT.get(e, e)} %" for e in filters),
        *(f"{SHORT.get(e, e)} end" for e in filters),
    )  # fmt: skip


def choice_row(result: ChoiceResult) -> tuple[str, ...]:
    """One choice: RMSE of voltage and SOC, signed SOC errors at the end of discharge."""
    return (
        result.choice,
        f"{result.capacity_Ah:.3f}",
        f"{1e3 * result.fit_rmse_V:.1f}",
        f"{1e3 * result.voltage_rmse_V:.1f}",
        f"{1e3 * result.voltage_above_10pct_V:.1f}",
        *(f"{100 * s.rmse:.2f}" for s in result.soc.values()),
        *(f"{100 * s.end:+.2f}" for s in result.soc.values()),
    )


def verdicts(study: CellStudy) -> list[str]:
    """One line per figure: the winner, the next one that is truly behind, and why."""
    return [_verdict(study, study.winner(kind)) for kind in study.kinds]


def papers_beside() -> list[str]:
    """What the two papers print, on their own cells, from best to worst."""
    orders = published_orders()
    lfp = ", ".join(
        f"{LFP_ERRORS[c].capacity_Ah:g} Ah ({c}) {LFP_ERRORS[c].rms_mV:g} mV" for c in orders["lfp"]
    )
    nca = ", ".join(
        f"{c.removeprefix('rate:')} {NCA_RESIDUALS[c.removeprefix('rate:')].rmse_mV:g} mV"
        for c in orders["ncr18650b"]
    )
    return [
        f"LFP paper ({LFP_CELL}), voltage RMS on a charge-depleting cycle: {lfp}.",
        f"NCR18650B paper ({NCA_CELL}), voltage RMSE on each rate's own HPPC: {nca}.",
    ]


def _verdict(study: CellStudy, winner: Winner) -> str:
    others = [name for name in study.order(winner.kind) if name != winner.choice]
    text = f"{named(winner.kind)}: {winner.choice} wins with {amount(winner.kind, winner.value)}"
    alike = [name for name in others if name in winner.alike]
    if alike:
        text += f"; not separable from it: {', '.join(alike)}"
    worse = [name for name in others if name not in winner.alike]
    if worse:
        next_one = worse[0]
        d = winner.behind[next_one]
        text += (
            f"; {next_one} is {amount(winner.kind, d.value)} worse "
            f"(95 % {amount(winner.kind, d.low)} to {amount(winner.kind, d.high)})"
        )
    return f"{text}. {_why(study, winner)}"


def _why(study: CellStudy, winner: Winner) -> str:
    worst = _result(study, study.order(winner.kind)[-1])
    off = 100 * (worst.capacity_Ah / study.reference_Ah - 1.0)
    if winner.kind == VOLTAGE:
        return (
            "OCV and tables are fitted over the choice's own SOC, so a scale that is off hardly "
            f"shows in the voltage until it ends before the cell does ({worst.choice}, {off:+.1f} "
            f"% of the reference: {amount(VOLTAGE, worst.voltage_rmse_V)})."
        )
    return (
        f"Of the squared error of {worst.choice} {100 * worst.axis_share[winner.kind]:.0f} % is "
        f"its SOC scale, {off:+.1f} % off the reference: counting divides by it, and a filter is "
        "led by an OCV over it."
    )


def _result(study: CellStudy, choice: str) -> ChoiceResult:
    return next(c for c in study.choices if c.choice == choice)


def study_finding(study: CellStudy) -> str:
    """One line: what the choice of the capacity does to SOC."""
    kind = study.kinds[1] if len(study.kinds) > 1 else VOLTAGE
    winner, last = study.winner(kind), study.order(kind)[-1]
    if kind == VOLTAGE:
        return f"{study.name}: {winner.choice} fits the voltage best"
    return (
        f"{study.name}: {winner.choice} as the capacity leaves {100 * winner.value:.2f} points of "
        f"SOC error in {named(kind)}, {last} {100 * _result(study, last).figure(kind):.2f}"
    )


# Colour and marker of an estimator's line.
LOOKS = {
    VOLTAGE: (style.VERMILLION, "o"),
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
    path, figures : as of `write_page`, whose errors it raises
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
    key = f"capacity-study-{number}"
    text = (
        f"Identified again for every choice, judged on {', '.join(study.logs)}. SOC reference: the "
        f"tester's counter over {study.reference_Ah:g} Ah ({study.reference}), the same for all."
    )
    figures = table(
        choice_head(study),
        [choice_row(c) for c in study.choices],
        caption="RMSE of simulated voltage and of SOC; signed SOC error where the discharge ends.",
    )
    voltage, *filters = study.kinds
    pictures = tuple(
        study_picture(study, kinds)._replace(key=f"{key}-{what}")
        for what, kinds in (("voltage", [voltage]), ("soc", filters))
        if kinds
    )
    said = paragraph(EXPLAINED, "note")
    blocks: Blocks = (paragraph(text), bullets(verdicts(study)), said, *pictures, figures)
    title = f"Which charge is the capacity: {study.name}"
    return Section(key, title, blocks, study.name)


EXPLAINED = (
    "Every dot is a choice of the capacity, with the whole identification redone. First: the "
    "voltage, which hardly depends on it until the scale ends before the cell does. Then: the SOC, "
    "which does; a filter can only follow the scale of its OCV. The line is the reference."
)


@pictured("capacity-study")
def study_picture(study: CellStudy, kinds: Sequence[str]) -> style.Figure:
    """RMSE of the voltage, or of SOC by several estimators, over the capacity."""
    figure, axes = style.new_axes(2.8)
    choices = sorted(study.choices, key=lambda c: c.capacity_Ah)
    capacity = [c.capacity_Ah for c in choices]
    of_voltage = VOLTAGE in kinds
    scale = 1e3 if of_voltage else 100.0
    for kind in kinds:
        colour, marker = LOOKS.get(kind, (style.INK, "o"))
        rmse = [scale * c.figure(kind) for c in choices]
        axes.plot(capacity, rmse, color=colour, marker=marker, lw=1.0, ms=4, label=named(kind))
    axes.axvline(study.reference_Ah, color=style.MUTED, linewidth=1.0)
    axes.margins(y=0.0)
    axes.set_ylim(0.0, 1.3 * axes.get_ylim()[1])  # room for the names
    best = study.winner(kinds[0])
    text = f"{named(kinds[0])}: {best.choice} best, {amount(best.kind, best.value)}"
    style.finding(axes, capitalised(text))
    style.labels(axes, "capacity [Ah]", "voltage RMSE [mV]" if of_voltage else "SOC RMSE [points]")
    if of_voltage:
        _name_choices(axes, study)
    else:
        style.legend(axes)
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
