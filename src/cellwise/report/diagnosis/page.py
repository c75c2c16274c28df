"""The page of a diagnosis: the finding, before and after, the evidence, where the error sat."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cellwise.diagnose.causes.catalogue import CAUSES, known_cause
from cellwise.diagnose.log_runs import LogRun
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
from cellwise.report.diagnosis.statements import (
    KINDS,
    cause_name,
    diagnosis_finding,
    judged_run,
    named_log,
    statement,
    valued,
)
from cellwise.report.page.interactive import Traces, trace_section
from cellwise.report.page.jumps import clock_of, linked_among
from cellwise.report.page.markup import (
    EMPTY,
    Markup,
    bullets,
    details,
    escape,
    lead_of,
    paragraph,
    table,
    tiles,
)
from cellwise.report.page.numerals import (
    ampere_hours,
    counted,
    listed,
    millivolt,
    percent,
    plural,
    significant,
)
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
    runs = in_order(diagnosis.runs)
    name = diagnosis.model.name or "the model"
    return write_page(
        path,
        # Plain spaces: programs read the figures in it, too.
        diagnosis_finding(diagnosis).replace("\N{NO-BREAK SPACE}", " "),
        f"Errors of {name} on {_names(diagnosis)}, by cellwise",
        diagnosis_sections(diagnosis, runs),
        diagnosis.to_dict(),
        lead=lead_of(fault_alerts(diagnosis), diagnosis_tiles(diagnosis), lead_lines(diagnosis)),
        figures=figures,
    )


def diagnosis_sections(diagnosis: Diagnosis, runs: Sequence[LogRun]) -> tuple[Section, ...]:
    """The parts of the page."""
    explained = bool(diagnosis.causes)
    caption = BEFORE_AFTER_CAPTION if explained else UNCHANGED_CAPTION
    pictures = [
        Picture(
            f"before-after-{k + 1}-{safe_key(r.log.name or 'log')}",
            draw_before_after(r, explained),
            caption,
            clock_of(r.log),
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
    if diagnosis.competing:
        sections.append(Section("competing", "What competes", (competing_table(diagnosis),)))
    if diagnosis.limits:
        apart = (bullets(inseparable_lines(diagnosis)), limits_table(diagnosis))
        sections.append(Section("limits", "What these logs could show", apart, "Limits"))
    if diagnosis.next_test:
        sections.append(Section("next", "Next test", (paragraph(diagnosis.next_test),)))
    sections.append(anatomy_section(diagnosis.anatomy, diagnosis.logs[0].name or "log"))
    if pictures[1:]:
        sections.append(Section("logs", "The other logs", tuple(pictures[1:])))
    sections.append(trace_section([(named_log(r), run_traces(r, explained)) for r in runs]))
    return tuple(sections)


def run_traces(run: LogRun, explained: bool) -> Traces:
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
    return Traces("time [h]", panels, clock_of(run.log))


def in_order(runs: Sequence[LogRun]) -> tuple[LogRun, ...]:
    """Held-out logs first."""
    return tuple(sorted(runs, key=lambda r: r.used != "holdout"))


def diagnosis_tiles(diagnosis: Diagnosis) -> Markup:
    """Key figures."""
    facts: list[tuple[object, object]] = [("verdict", cause_name(diagnosis.verdict))]
    if diagnosis.causes:
        facts.append(("first cause's gain, 95 %", _interval(diagnosis.causes[0].gain_ci95)))
    if (judged := judged_run(diagnosis)) is not None:
        facts.append((f"RMSE on {named_log(judged)}", millivolt(judged.before.metrics.rmse_V)))
        if diagnosis.causes:
            facts.append(("with the extended model", millivolt(judged.after.metrics.rmse_V)))
        if judged.corrected is not None:
            corrected = millivolt(judged.corrected.metrics.rmse_V)
            facts.append(("and with the log corrected", corrected))
    facts.append(("causes tried", counted(len(diagnosis.candidates))))
    return tiles(facts)


def fault_alerts(diagnosis: Diagnosis) -> list[Markup]:
    """What sensors did wrong, first of all, with links to where."""
    logs = [run.log for run in diagnosis.runs]
    return [
        linked_among(text, logs)
        for cause in diagnosis.causes
        if cause.name == "sensor_fault"
        for text in cause.evidence
    ]


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
            f"Held out: {_held(diagnosis)}; nothing but an initial SOC was fitted there."
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
    elif diagnosis.no_soc_gain:
        lines.append(f"No gain in SOC is claimed: {diagnosis.no_soc_gain}.")
    if diagnosis.next_test:
        lines.append(f"Next test: {diagnosis.next_test}")
    return lines


def cause_content(cause: FoundCause, diagnosis: Diagnosis) -> Markup:
    """One cause: meaning, numbers, evidence, what it is confused with."""
    known = known_cause(cause.name)
    name = cause_name(cause.name)
    sure = f", probability {percent(cause.probability, 0)}" if cause.probability >= 0.0 else ""
    head_line = Markup(f"<h3>{escape(name[:1].upper() + name[1:] + sure)}</h3>")
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


def runs_table(runs: Sequence[LogRun], explained: bool) -> Markup:
    """Every log before and after."""
    corrected = any(r.corrected is not None for r in runs)
    head = ["log", "used", "rows", "initial SOC", "RMSE before" if explained else "RMSE"]
    if explained:
        head += ["extended model", *(["log corrected, too"] if corrected else []), "less by"]
    rows = []
    for r in runs:
        row = [
            r.log.name or "log",
            "held out" if r.used == "holdout" else "fitted",
            counted(len(r.log)),
            f"{r.before.soc0:.3f}",
            millivolt(r.before.metrics.rmse_V),
        ]
        if explained:
            row.append(millivolt(r.after.metrics.rmse_V))
            if r.corrected is not None:
                row.append(millivolt(r.corrected.metrics.rmse_V))
            row.append(percent(r.gain, 0))
        rows.append(tuple(row))
    caption = (
        "What a simulation shows with either model: all rows of every log, from this initial SOC."
    )
    if corrected:
        caption += " Beside it, the corrected log from the SOC at which it is estimated to start."
    return table(tuple(head), rows, caption=caption, text_columns=(0, 1))


def competing_table(diagnosis: Diagnosis) -> Markup:
    """Explanations that were weighed, with their probability."""
    rows = [
        (listed([cause_name(c) for c in w.causes]) or "none", percent(w.probability, 0))
        for w in diagnosis.competing
    ]
    caption = (
        "Sets of causes and their probability among all that were compared; blocks of time "
        "weighted at random."
    )
    return table(("explanation", "probability"), rows, caption=caption, text_columns=(0,))


def inseparable_lines(diagnosis: Diagnosis) -> list[str]:
    """Groups that these logs do not separate."""
    return [
        f"These logs do not separate {listed([cause_name(c) for c in group])}."
        for group in diagnosis.inseparable
    ]


def limits_table(diagnosis: Diagnosis) -> Markup:
    """The smallest change of every cause's parameters that these logs could show."""
    rows = []
    for name, sizes in diagnosis.limits.items():
        units = {p.name: p.unit for p in CAUSES[name].parameters}
        values = ", ".join(f"{k} {valued(v, units.get(k, '1'))}" for k, v in sizes.items())
        rows.append((cause_name(name), values))
    caption = (
        "From sensitivities and noise, before any cause was fitted: smaller changes look the "
        "same as what a good laboratory leaves uncertain."
    )
    return table(("cause", "smallest change"), rows, caption=caption, text_columns=(0, 1))


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
