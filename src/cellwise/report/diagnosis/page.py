"""The page of a diagnosis: the finding, before and after, the evidence, where the error sat."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cellwise.diagnose.causes.catalogue import CAUSES
from cellwise.diagnose.result import Diagnosis, FoundCause
from cellwise.plotting import Line, Panel
from cellwise.report.diagnosis.anatomy_section import anatomy_section
from cellwise.report.diagnosis.pictures import (
    BEFORE_AFTER_CAPTION,
    CANDIDATES_CAPTION,
    UNCHANGED_CAPTION,
    draw_before_after,
    draw_candidates,
    drawn_runs,
)
from cellwise.report.diagnosis.runs import BeforeAfter, before_after, with_anatomy
from cellwise.report.diagnosis.statements import (
    KINDS,
    cause_name,
    diagnosis_finding,
    statement,
    valued,
)
from cellwise.report.page.interactive import Traces, trace_section
from cellwise.report.page.markup import (
    EMPTY,
    Markup,
    bullets,
    details,
    escape,
    paragraph,
    table,
    tiles,
)
from cellwise.report.page.numerals import counted, listed, millivolt, percent, plural, significant
from cellwise.report.page.picture import FigureFiles, Picture, safe_key
from cellwise.report.page.section import Section, write_page

MOST_PICTURES = 4


def diagnose_page(
    diagnosis: Diagnosis, path: str | Path, *, figures: str | Path | FigureFiles | None = None
) -> Path:
    """Write the page of a diagnosis.

    Parameters
    ----------
    diagnosis : Diagnosis
    path : str or Path            of the HTML file; it appears whole or not at all
    figures : folder or FigureFiles   for the same pictures as PNG and SVG files

    Raises
    ------
    InputError        matplotlib is missing; the path cannot be written
    """
    diagnosis = with_anatomy(diagnosis)
    runs = before_after(diagnosis)
    name = diagnosis.model.name or "the model"
    return write_page(
        path,
        diagnosis_finding(diagnosis),
        f"Errors of {name} on {_names(diagnosis)}, by cellwise",
        diagnosis_sections(diagnosis, runs),
        diagnosis_data(diagnosis, runs),
        lead=Markup(diagnosis_tiles(diagnosis) + bullets(lead_lines(diagnosis))),
        figures=figures,
    )


def diagnosis_sections(diagnosis: Diagnosis, runs: Sequence[BeforeAfter]) -> tuple[Section, ...]:
    """The parts of the page."""
    explained = bool(diagnosis.causes)
    caption = BEFORE_AFTER_CAPTION if explained else UNCHANGED_CAPTION
    pictures = [
        Picture(
            f"before-after-{k + 1}-{safe_key(r.log.name or 'log')}",
            draw_before_after(r, explained),
            caption,
        )
        for k, r in enumerate(runs[:MOST_PICTURES])
    ]
    title = "Before and after" if explained else "Measured and simulated"
    sections = [Section("before-after", title, (pictures[0], runs_table(runs, explained)))]
    if explained:
        contents = tuple(cause_content(c, diagnosis) for c in diagnosis.causes)
        sections.append(Section("causes", "What it is", contents, "Causes"))
    if diagnosis.candidates:
        evidence = Picture("candidates", draw_candidates(diagnosis), CANDIDATES_CAPTION)
        shown = (evidence, bullets(diagnosis.reasons), candidates_table(diagnosis))
        sections.append(Section("evidence", "What was tried", shown, "Evidence"))
    if diagnosis.next_test:
        sections.append(Section("next", "Next test", (paragraph(diagnosis.next_test),)))
    sections.append(anatomy_section(diagnosis.anatomy, diagnosis.logs[0].name or "log"))
    if pictures[1:]:
        sections.append(Section("logs", "The other logs", tuple(pictures[1:])))
    sections.append(trace_section([(named(r), run_traces(r, explained)) for r in runs]))
    return tuple(sections)


def run_traces(run: BeforeAfter, explained: bool) -> Traces:
    """Voltages, residuals and current of a log, before and after."""
    hours = run.log.time_s / 3600.0
    drawn = drawn_runs(run, explained)
    voltages = [Line("measured", hours, run.log.voltage_V)]
    voltages += [Line(name, hours, voltage) for name, voltage, _, _ in drawn]
    residuals = tuple(Line(name, hours, 1e3 * error) for name, _, error, _ in drawn)
    current = Line("current", hours, run.log.current_A)
    panels = (
        Panel("voltage [V]", tuple(voltages)),
        Panel("residual [mV]", residuals),
        Panel("current [A]", (current,)),
    )
    return Traces("time [h]", panels)


def named(run: BeforeAfter) -> str:
    """A log's name, and whether the fit has seen it."""
    return f"{run.log.name or 'log'}{' (held out)' if run.held_out else ''}"


def diagnosis_data(diagnosis: Diagnosis, runs: Sequence[BeforeAfter]) -> dict[str, object]:
    """The figures for machines: the command's keys, and every log before and after."""
    logs = [
        {
            "log": r.log.name,
            "held_out": r.held_out,
            "rmse_before_V": r.before.metrics.rmse_V,
            "rmse_after_V": r.after.metrics.rmse_V,
        }
        for r in runs
    ]
    return {**diagnosis.to_dict(), "logs": logs}


def diagnosis_tiles(diagnosis: Diagnosis) -> Markup:
    """Key figures."""
    facts: list[tuple[object, object]] = [("verdict", cause_name(diagnosis.verdict))]
    if diagnosis.causes:
        first, last = diagnosis.causes[0], diagnosis.causes[-1]
        facts += [
            ("held-out RMSE before", millivolt(first.holdout_rmse_before_V)),
            ("after", millivolt(last.holdout_rmse_after_V)),
            ("first cause's gain, 95 %", _interval(first.gain_ci95)),
        ]
    else:
        facts.append(("RMSE of the first log", millivolt(diagnosis.anatomy.get("rmse_V"))))
    facts.append(("causes tried", counted(len(diagnosis.candidates))))
    return tiles(facts)


def lead_lines(diagnosis: Diagnosis) -> list[str]:
    """What follows the first line: every further cause, and what it means for the user."""
    lines = [
        f"{statement(c, diagnosis)}: {percent(c.gain, 0)} less error on held-out data, on top of "
        f"the causes before it."
        for c in diagnosis.causes[1:]
    ]
    kinds = list(dict.fromkeys(c.kind for c in diagnosis.causes))
    for kind in kinds:
        names = listed([cause_name(c.name) for c in diagnosis.causes if c.kind == kind])
        prefix = f"{names[:1].upper()}{names[1:]} – " if len(kinds) > 1 else ""
        meaning = KINDS[kind]
        lines.append(f"{prefix}{meaning[:1].lower()}{meaning[1:]}" if prefix else meaning)
    if diagnosis.causes:
        where = (
            f"Held out: {_held(diagnosis)}; only its initial SOC was fitted."
            if diagnosis.holdout
            else "Held out: later blocks of the logs themselves, never used in the fit."
        )
        lines.append(where)
    gain = diagnosis.soc_gain
    if gain and "soc_rmse_before" in gain and "soc_rmse_after" in gain:
        lines.append(
            f"SOC by the EKF on {gain.get('log') or 'the log'}: RMSE "
            f"{percent(gain['soc_rmse_before'])} before, {percent(gain['soc_rmse_after'])} after, "
            "against the tester's counter."
        )
    if diagnosis.next_test:
        lines.append(f"Next test: {diagnosis.next_test}")
    return lines


def cause_content(cause: FoundCause, diagnosis: Diagnosis) -> Markup:
    """One cause: meaning, numbers, evidence, what it is confused with."""
    known = CAUSES[cause.name]
    name = cause_name(cause.name)
    head_line = Markup(f"<h3>{escape(name[:1].upper() + name[1:])}</h3>")
    head_line = Markup(head_line + paragraph(f"{statement(cause, diagnosis)}. {cause.meaning}"))
    units = {p.name: p.unit for p in known.parameters}
    rows = [
        (k, valued(v, units.get(k, "1")), _between(cause.ci95.get(k), units.get(k, "1")))
        for k, v in cause.parameters.items()
    ]
    numbers = table(("parameter", "value", "95 % interval"), rows)
    before_after_rows = [
        ("fitted on", *_change(cause.train_rmse_before_V, cause.train_rmse_after_V), ""),
        (
            "held out",
            *_change(cause.holdout_rmse_before_V, cause.holdout_rmse_after_V),
            _interval(cause.gain_ci95),
        ),
    ]
    head = ("rows", "RMSE before", "after", "gain", "95 % interval")
    confused = cause.confusable_with
    lines = [
        KINDS[cause.kind],
        f"In the model: {known.term}.",
        f"What it leaves in the residual: {known.signature}",
        *(e for e in cause.evidence if e != known.signature),
    ]
    if confused:
        lines.append(f"Easily confused with {listed([cause_name(c) for c in confused])}.")
    return Markup(head_line + bullets(lines) + numbers + table(head, before_after_rows))


def runs_table(runs: Sequence[BeforeAfter], explained: bool) -> Markup:
    """Every log before and after."""
    rows = [
        (
            r.log.name or "log",
            "held out" if r.held_out else "fitted",
            counted(len(r.log)),
            millivolt(r.before.metrics.rmse_V),
            *((millivolt(r.after.metrics.rmse_V), percent(r.gain, 0)) if explained else ()),
        )
        for r in runs
    ]
    head = ("log", "used", "rows", "RMSE before" if explained else "RMSE")
    extra = ("after", "less by") if explained else ()
    caption = (
        "All rows of every log; the model comparison leaves out the first part of a held-out log, "
        "which determines its initial SOC. One that was not given is found by each model."
    )
    return table((*head, *extra), rows, caption=caption, text_columns=(0, 1))


def candidates_table(diagnosis: Diagnosis) -> Markup:
    """All candidates with their parameters, folded away."""
    rows = []
    for c in diagnosis.candidates:
        units = {p.name: p.unit for p in CAUSES[c.name].parameters} if c.name in CAUSES else {}
        values = ", ".join(f"{k} {valued(v, units.get(k, '1'))}" for k, v in c.parameters.items())
        score = significant(c.score)
        rows.append((cause_name(c.name), score, millivolt(c.holdout_rmse_V), values))
    if not rows:
        return EMPTY
    head = ("cause", "score", "held-out RMSE", "parameters when tried alone")
    return details(
        f"All figures of {plural(len(rows), 'candidate')}", table(head, rows, text_columns=(0, 3))
    )


def _change(before_V: float, after_V: float) -> tuple[str, str, str]:
    gain = 1.0 - after_V / before_V if before_V > 0.0 else 0.0
    return millivolt(before_V), millivolt(after_V), percent(gain, 0)


def _interval(ends: tuple[float, float]) -> str:
    return f"{percent(ends[0], 0)} to {percent(ends[1], 0)}"


def _between(ends: tuple[float, float] | None, unit: str) -> str:
    return "" if ends is None else f"{valued(ends[0], unit)} to {valued(ends[1], unit)}"


def _names(diagnosis: Diagnosis) -> str:
    return listed(list(dict.fromkeys(g.name or "a log" for g in diagnosis.logs)))


def _held(diagnosis: Diagnosis) -> str:
    return listed(list(dict.fromkeys(g.name or "another log" for g in diagnosis.holdout)))
