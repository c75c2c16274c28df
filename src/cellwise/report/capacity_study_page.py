"""The capacity study as text and page: which choice wins, by how much, and why."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cellwise.errors import InputError
from cellwise.report.page import style
from cellwise.report.page.markup import bullets, paragraph, table
from cellwise.report.page.numerals import capitalised
from cellwise.report.page.picture import Figures, pictured
from cellwise.report.page.section import Blocks, Section, write_page
from cellwise.studies.capacity_study import VOLTAGE, CellStudy, published_orders
from cellwise.studies.published import LFP, NCR18650B

# Of every figure: name in text, name in a table's head, colour and marker of its line.
KINDS = {
    VOLTAGE: ("simulated voltage", "", style.VERMILLION, "o"),
    "coulomb": ("coulomb counting", "count", style.AMBER, "s"),
    "ekf": ("EKF", "EKF", style.BLUE, "o"),
    "ukf": ("UKF", "UKF", style.GREEN, "^"),
    "adaptive": ("adaptive", "adapt", style.PURPLE, "D"),
}
# A capacity within this share of its neighbour's shares its label.
TOO_NEAR = 0.004
EXPLAINED = (
    "Every dot is a choice of the capacity, with the whole identification redone. First: the "
    "voltage; OCV and tables are fitted over the choice's own SOC, so a scale that is off hardly "
    "shows in it until it ends before the cell does. Then: the SOC, which shows it; counting "
    "divides by it, and a filter can only follow the scale of its OCV. The line is the reference."
)


def named(kind: str) -> str:
    """A figure's name in text."""
    return KINDS[kind][0] if kind in KINDS else kind


def amount(kind: str, value: float) -> str:
    """An RMSE or a difference of two, with its unit."""
    return f"{1e3 * value:.1f} mV" if kind == VOLTAGE else f"{100 * value:.2f} points"


def choices(study: CellStudy) -> tuple[list[str], list[list[str]]]:
    """Head and rows: RMSE of voltage and SOC, signed SOC error where the discharge ends."""
    filters = [KINDS[e][1] if e in KINDS else e for e in study.kinds[1:]]
    ends = [f"{name} end" for name in filters]
    head = ["choice", "Ah", "own fit mV", "voltage mV", "above 10 %"]
    rows = [
        [
            one.choice,
            f"{one.capacity_Ah:.3f}",
            *(
                f"{1e3 * volt:.1f}"
                for volt in (one.fit_rmse_V, one.voltage_rmse_V, one.voltage_above_10pct_V)
            ),
            *(f"{100 * s.rmse:.2f}" for s in one.soc.values()),
            *(f"{100 * s.end:+.2f}" for s in one.soc.values()),
        ]
        for one in study.choices
    ]
    return [*head, *(f"{name} %" for name in filters), *ends], rows


def verdicts(study: CellStudy) -> list[str]:
    """One line per figure: the winner, the next one that is truly behind, and why."""
    return [_verdict(study, kind) for kind in study.kinds]


def _verdict(study: CellStudy, kind: str) -> str:
    winner, worst = study.winner(kind), study.order(kind)[-1]
    text = f"{named(kind)}: {winner.choice} wins with {amount(kind, winner.value)}"
    if winner.alike:
        text += f"; not separable from it: {', '.join(winner.alike)}"
    worse = [item for item in winner.behind.items() if item[0] not in winner.alike]
    for name, d in worse[:1]:
        text += (
            f"; {name} is {amount(kind, d.value)} worse (95 % {amount(kind, d.low)} to "
            f"{amount(kind, d.high)})"
        )
    if kind == VOLTAGE:
        return f"{text}."
    off = 100 * (worst.capacity_Ah / study.reference_Ah - 1.0)
    share = 100 * worst.soc[kind].axis_share
    return (
        f"{text}. Of the squared error of {worst.choice} {share:.0f} % is its SOC scale, "
        f"{off:+.1f} % off the reference."
    )


def papers_beside() -> list[str]:
    """What the two papers print, on their own cells, from best to worst."""
    orders = published_orders()
    errors, residuals = LFP["errors"], NCR18650B["residuals"]
    lfp = ", ".join(
        f"{errors[c]['capacity_Ah']:g} Ah ({c}) {errors[c]['rms_mV']:g} mV" for c in orders["lfp"]
    )
    rates = [choice.removeprefix("rate:") for choice in orders["ncr18650b"]]
    nca = ", ".join(f"{rate} {residuals[rate]['rmse_mV']:g} mV" for rate in rates)
    return [
        f"LFP paper ({LFP['cell']}), voltage RMS on a charge-depleting cycle: {lfp}.",
        f"NCR18650B paper ({NCR18650B['cell']}), voltage RMSE on each rate's own HPPC: {nca}.",
    ]


def study_finding(study: CellStudy) -> str:
    """One line: what the choice of the capacity does to SOC."""
    kind = study.kinds[min(1, len(study.kinds) - 1)]
    best, last = study.order(kind)[0], study.order(kind)[-1]
    if kind == VOLTAGE:
        return f"{study.name}: {best.choice} fits the voltage best"
    return (
        f"{study.name}: {best.choice} as the capacity leaves {100 * best.figure(kind):.2f} points "
        f"of SOC error in {named(kind)}, {last.choice} {100 * last.figure(kind):.2f}"
    )


def capacity_study_page(
    studies: Sequence[CellStudy],
    path: str | Path,
    *,
    figures: Figures = None,
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
    caption = "RMSE of simulated voltage and of SOC; signed SOC error where the discharge ends."
    voltage, *filters = study.kinds
    pictures = [study_picture(study, [voltage])._replace(key=f"{key}-voltage")]
    pictures += [study_picture(study, filters)._replace(key=f"{key}-soc")] * bool(filters)
    blocks: Blocks = (
        paragraph(text),
        bullets(verdicts(study)),
        paragraph(EXPLAINED, "note"),
        *pictures,
        table(*choices(study), caption=caption),
    )
    return Section(key, f"Which charge is the capacity: {study.name}", blocks, study.name)


@pictured("capacity-study")
def study_picture(study: CellStudy, kinds: Sequence[str]) -> style.Figure:
    """RMSE of the voltage, or of SOC by several estimators, over the capacity."""
    figure, axes = style.new_axes()
    found = sorted(study.choices, key=lambda c: c.capacity_Ah)
    capacity, of_voltage = [c.capacity_Ah for c in found], VOLTAGE in kinds
    scale = 1e3 if of_voltage else 100.0
    for kind in kinds:
        name, _, colour, marker = KINDS.get(kind, (kind, "", style.INK, "o"))
        rmse = [scale * c.figure(kind) for c in found]
        axes.plot(capacity, rmse, color=colour, marker=marker, lw=1.0, ms=4, label=name)
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
