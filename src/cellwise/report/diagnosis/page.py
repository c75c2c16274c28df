"""The page of a diagnosis: the finding, before and after, the evidence, where the error sat."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.arguments import check_kind
from cellwise.diagnose.causes.catalogue import CAUSES, known_cause
from cellwise.diagnose.result import Diagnosis, FoundCause, LogRun, TriedCause
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Code
from cellwise.report.diagnosis.pictures import before_after_plot, residual_section
from cellwise.report.diagnosis.statements import (
    KINDS,
    corrected_mV,
    diagnosis_finding,
    in_words,
    judged_run,
    named_log,
    probability,
    shown_parameters,
    statement,
    unsure_lines,
    valued,
    weights,
    within,
)
from cellwise.report.page.markup import (
    EMPTY,
    MOST,
    Markup,
    bullets,
    clock_of,
    details,
    escape,
    linked,
    linked_among,
    paragraph,
    record_table,
    tiles,
)
from cellwise.report.page.numerals import (
    ampere_hours,
    capitalised,
    counted,
    listed,
    millivolt,
    percent,
    plural,
    significant,
    spoken_name,
)
from cellwise.report.page.picture import Figures
from cellwise.report.page.section import Blocks, Section, plots_within, write_page


def diagnose_page(diagnosis: Diagnosis, path: str | Path, *, figures: Figures = None) -> Path:
    """Write the page of a diagnosis.

    Parameters
    ----------
    diagnosis : Diagnosis
    path, figures : as of `write_page`, whose errors it raises
    """
    check_kind("diagnosis", diagnosis, Diagnosis, "Pass what diagnose(model, log) gives.")
    runs = sorted(diagnosis.runs, key=lambda r: r.used != "holdout")  # held-out logs first
    name = diagnosis.model.name or "the model"
    lines, more = lead_lines(diagnosis), alerts(diagnosis)
    first = [*lines[: MOST.bullets - bool(more)], *more[:1]]
    rest = [*lines[len(first) - bool(more) :], *more[1:]]
    return write_page(
        path,
        # Plain spaces: programs read the figures in it, too.
        diagnosis_finding(diagnosis).replace("\N{NO-BREAK SPACE}", " "),
        f"Errors of {name} on {_names(diagnosis.logs)}, by cellwise",
        diagnosis_sections(diagnosis, runs),
        diagnosis.to_dict(),
        lead=Markup(
            bullets(first)
            + diagnosis_tiles(diagnosis)
            + details(plural(len(rest), "more remark"), bullets(rest, "notices")) * bool(rest)
        ),
        figures=figures,
    )


def diagnosis_sections(diagnosis: Diagnosis, runs: Sequence[LogRun]) -> tuple[Section, ...]:
    """The parts of the page."""
    explained = bool(diagnosis.causes)
    plots = tuple(
        before_after_plot(run, explained, f"before-after-{k}")
        for k, run in enumerate(runs[: MOST.plots], start=1)
    )
    title = "Before and after" if explained else "Measured and simulated"
    first: Blocks = (*plots[:1], runs_table(runs, explained))
    sections = [Section("before-after", title, first)]
    if explained:
        contents = tuple(cause_content(c, diagnosis) for c in diagnosis.causes)
        sections.append(Section("causes", "What it is", contents, "Causes"))
    if diagnosis.candidates:
        tried = (
            bullets(diagnosis.reasons),
            candidates_table(diagnosis),
            competing_table(diagnosis),
        )
        sections.append(Section("evidence", "What was tried", tried, "Evidence"))
    if diagnosis.limits:
        alike = [listed([spoken_name(c) for c in group]) for group in diagnosis.inseparable]
        lines = bullets(f"These logs do not separate {names}." for names in alike)
        limits = (lines, limits_table(diagnosis))
        sections.append(Section("limits", "What these logs could show", limits, "Limits"))
    sections.append(residual_section(diagnosis.anatomy, clock_of(diagnosis.logs[0])))
    if plots[1:]:
        sections.append(Section("logs", "The other logs", tuple(plots_within(plots[1:]))))
    return tuple(sections)


def diagnosis_tiles(diagnosis: Diagnosis) -> Markup:
    """Key figures."""
    facts: list[tuple[object, object]] = []
    if (judged := judged_run(diagnosis)) is not None:
        facts.append((f"RMSE on {named_log(judged)}", millivolt(judged.before.rmse_V)))
        if diagnosis.causes:
            facts.append(("with the extended model", millivolt(judged.after.rmse_V)))
        if corrected := corrected_mV(judged):
            facts.append(("and with the log corrected", corrected))
    gain = diagnosis.soc_gain
    if gain is not None:
        ends = (percent(gain[f"soc_rmse_{k}"]) for k in ("before", "after"))
        facts.append((f"SOC RMSE of the EKF on {gain['log'] or 'the log'}", " → ".join(ends)))
    facts.append(("causes tried", counted(len(diagnosis.candidates))))
    return tiles(facts)


def alerts(diagnosis: Diagnosis) -> list[Markup]:
    """What sensors did wrong and where the model was not measured, with links to where."""
    logs = [run.log for run in diagnosis.runs]
    shown = {log.name: log for log in logs}
    faults = [linked(f.notice(), f.log, shown.get(f.log.name)) for f in diagnosis.faults]
    worst_first = sorted(diagnosis.notices, key=lambda n: n.code is not Code.FAR_OFF)
    return [*faults, *(linked_among(n, logs) for n in worst_first)]


def lead_lines(diagnosis: Diagnosis) -> list[str]:
    """What follows the first line: what to measure, what is unsure, then what was found."""
    lines = [f"Measure next: {in_words(diagnosis.next_test)}"] if diagnosis.next_test else []
    lines += unsure_lines(diagnosis)
    lines += [
        f"{statement(c, diagnosis)}: {percent(c.gain, 0)} less error on held-out data, on top of "
        f"the causes before it."
        for c in diagnosis.causes[1:]
    ]
    kinds = list(dict.fromkeys(c.kind for c in diagnosis.causes))
    for kind in kinds:
        names = listed([spoken_name(c.name) for c in diagnosis.causes if c.kind == kind])
        prefix = f"{capitalised(names)} – " if len(kinds) > 1 else ""
        lines.append(f"{prefix}{within(KINDS[kind])}" if prefix else KINDS[kind])
    if diagnosis.causes:
        where = (
            f"Held out: {_names(diagnosis.holdout)}; nothing but an initial SOC was fitted there."
            if diagnosis.holdout
            else "Held out: later blocks of the logs themselves, never used in the fit."
        )
        lines.append(where)
    gain = diagnosis.soc_gain
    if gain is not None:
        lines.append(
            f"SOC by the EKF on {gain['log'] or 'the log'}: RMSE "
            f"{percent(gain['soc_rmse_before'])} before, {percent(gain['soc_rmse_after'])} after, "
            f"against the tester's counter over {ampere_hours(gain['reference_capacity_Ah'])}: "
            f"{gain['reference']}."
        )
    return lines


def cause_content(cause: FoundCause, diagnosis: Diagnosis) -> Markup:
    """One cause: meaning, numbers, evidence, what it is confused with."""
    known = known_cause(cause.name)
    sure = f", probability {probability(cause.probability)}" if cause.probability >= 0.0 else ""
    units = _units(cause.name)
    lines = [
        KINDS[cause.kind],
        f"In the model: {known.term}.",
        f"What it leaves in the residual: {known.signature}",
        *(in_words(e) for e in cause.evidence if e != known.signature),
    ]
    if cause.confusable_with:
        names = listed([spoken_name(c) for c in cause.confusable_with])
        lines.append(f"Easily confused with {names}.")

    def numbers(parameters: Sequence[tuple[str, float]]) -> Markup:
        return record_table(
            parameters,
            ("parameter", lambda p: p[0]),
            ("value", lambda p: valued(p[1], units.get(p[0], "1"))),
            ("95 % interval", lambda p: _between(cause.ci95.get(p[0]), units.get(p[0], "1"))),
        )

    shown = shown_parameters(cause)
    folded = [p for p in cause.parameters.items() if p not in shown]
    what = f"{plural(len(folded), 'parameter')} of which these logs say no more than is usual"
    return Markup(
        f"<h3>{escape(capitalised(spoken_name(cause.name)) + sure)}</h3>"
        + paragraph(f"{statement(cause, diagnosis)}. {cause.meaning}")
        + bullets(lines)
        + numbers(shown)
        + (details(what, numbers(folded)) if folded else "")
    )


def runs_table(runs: Sequence[LogRun], explained: bool) -> Markup:
    """Every log before and after."""
    caption = (
        "What a simulation shows with either model: all rows of every log, from this initial SOC."
    )
    if any(map(corrected_mV, runs)):
        caption += " Beside it, the corrected log from the SOC at which it is estimated to start."
    if any(map(own_start, runs)):
        caption += (
            " Its own start: what `simulate` shows where no start is stated, since the extended "
            "model finds another one."
        )
    return record_table(runs, *run_columns(explained), caption=caption, text_columns=(0, 1))


def own_start(run: LogRun) -> str:
    """RMSE of a log from the start that the extended model finds itself."""
    own = run.own_start
    return f"{millivolt(own.rmse_V)} from {own.soc0:.3f}" if own else ""


def run_columns(explained: bool) -> list[tuple[str, Callable[[LogRun], str]]]:
    """How a log before and after reads on a page and in a command."""
    after: list[tuple[str, Callable[[LogRun], str]]] = [
        ("extended model", lambda r: millivolt(r.after.rmse_V)),
        ("log corrected, too", corrected_mV),
        ("its own start", own_start),
        ("less by", lambda r: percent(r.gain, 0)),
    ]
    return [
        ("log", lambda r: clock_of(r.log)),
        ("used", lambda r: "held out" if r.used == "holdout" else "fitted"),
        ("rows", lambda r: counted(len(r.log))),
        ("initial SOC", lambda r: f"{r.before.soc0:.3f}"),
        ("RMSE before" if explained else "RMSE", lambda r: millivolt(r.before.rmse_V)),
        *(after if explained else ()),
    ]


def competing_table(diagnosis: Diagnosis) -> Markup:
    """Explanations that were weighed, with their probability."""
    if not diagnosis.competing:
        return EMPTY
    return record_table(
        weights(diagnosis),
        ("explanation", lambda w: w[0]),
        ("probability", lambda w: w[1]),
        caption="Sets of causes and their probability among all that were compared. That of a "
        "cause is the sum over all sets that hold it.",
    )


def limits_table(diagnosis: Diagnosis) -> Markup:
    """The smallest change of every cause that these logs could show."""
    without = sorted({c.name for c in diagnosis.candidates} - set(diagnosis.limits))
    found = record_table(
        diagnosis.limits.items(),
        ("cause", lambda one: spoken_name(one[0])),
        ("smallest change", lambda one: _values(*one)),
        caption="From sensitivities and noise, before any cause was fitted: smaller changes look "
        "the same as what a good laboratory leaves uncertain.",
        text_columns=(0, 1),
    )
    none = f"These logs could show no change of {listed([spoken_name(c) for c in without])}."
    return Markup(found + (paragraph(none) if without else ""))


def candidates_table(diagnosis: Diagnosis) -> Markup:
    """All candidates, the likeliest first; those beyond a few are folded away."""
    order = sorted(diagnosis.candidates, key=lambda c: -np.nan_to_num(c.score, nan=-np.inf))
    few, rest = order[: MOST.listed], order[MOST.listed :]

    def figures(shown: Sequence[TriedCause], **options: Any) -> Markup:
        return record_table(shown, *TRIED_COLUMNS, text_columns=(0, 3), **options)

    caption = (
        "Every cause alone, the likeliest first. Evidence: ln of how much likelier the data are "
        "with it than with none; below zero it explains less than usual tolerances do. A cause is "
        "accepted by both, for a wrong one can also reduce the error."
    )
    more = details(f"{plural(len(rest), 'candidate')} more", figures(rest)) if rest else ""
    return Markup(figures(few, caption=caption) + more)


# Of a candidate: how it reads on a page and in a command.
TRIED_COLUMNS: tuple[tuple[str, Callable[[TriedCause], str]], ...] = (
    ("cause", lambda c: spoken_name(c.name)),
    ("held-out RMSE", lambda c: millivolt(c.holdout_rmse_V)),
    ("evidence", lambda c: significant(c.score)),
    ("its parameters", lambda c: _values(c.name, c.parameters, 2)),
)


def _units(cause: str) -> dict[str, str]:
    """Units of a cause's parameters by their names."""
    return {p.name: p.unit for p in CAUSES[cause].parameters} if cause in CAUSES else {}


def _values(cause: str, parameters: Mapping[str, float], most: int = 99) -> str:
    """The first ones; the others of many stand in the figures for machines."""
    units, more = _units(cause), len(parameters) - most
    shown = [f"{k} {valued(v, units.get(k, '1'))}" for k, v in list(parameters.items())[:most]]
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")


def _between(ends: tuple[float, float] | None, unit: str) -> str:
    return "" if ends is None else f"{valued(ends[0], unit)} to {valued(ends[1], unit)}"


def _names(logs: Sequence[CellLog]) -> str:
    return listed(list(dict.fromkeys(g.name or "a log" for g in logs)))
