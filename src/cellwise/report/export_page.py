"""The page of an export: what the filter costs on the target, and what it loses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cellwise.plotting import Plottable
from cellwise.report.page.markup import Markup, bullets, paragraph, record_table, table, tiles
from cellwise.report.page.numerals import counted, listed, plural, significant
from cellwise.report.page.picture import Figures
from cellwise.report.page.plot import Plot
from cellwise.report.page.section import Section, write_page

Row = Mapping[str, Any]
COSTS = {
    "text_bytes": "code [B]",
    "model_bytes": "tables [B]",
    "ram_bytes": "static RAM [B]",
    "state_bytes": "state per cell [B]",
    "stack_bytes": "stack [B]",
    "instructions_mean": "instructions a step",
    "instructions_most": "most on the log",
    "instructions_stress": "under every fault",
    "instructions_anew": "SOC re-initialised",
    "pack_instructions_mean": "a step of the pack",
    "pack_instructions_most": "most of the pack",
}
ACCURACY_COLUMNS = (
    ("SOC points", lambda a: str(a["points"])),
    ("tables [B]", lambda a: counted(a["flash_bytes"])),
    ("RMSE [points]", lambda a: f"{100 * a['soc_rmse']:.4f}"),
    ("largest [points]", lambda a: f"{100 * a['soc_max']:.4f}"),
)


def export_page(
    report: Mapping[str, Any],
    path: str | Path,
    on_log: Plottable | None = None,
    *,
    figures: Figures = None,
) -> Path:
    """Write the page of an export.

    Parameters
    ----------
    report : mapping             what `cellwise export --json` prints
    on_log : Plottable or None   the exported filter beside the float64 one over a log
    path, figures : as of `write_page`, whose errors it raises
    """
    name, model_bytes = report["model"] or "The model", counted(report["model_bytes"])
    text = f"{name} in C takes {model_bytes} bytes of tables and {report['state_bytes']} bytes per "
    text += "cell"
    facts: list[tuple[object, object]] = [
        ("tables in flash", f"{model_bytes} B"),
        ("state per cell", f"{report['state_bytes']} B"),
        ("time step", f"{report['dt_s']:g} s"),
        ("states", report["states"]),
    ]
    known = [c for c in report["targets"] if c["instructions_mean"] is not None]
    if known:
        least = min(known, key=lambda c: float(c["instructions_mean"]))
        core = least["core"]
        text += f", {counted(round(least['instructions_mean']))} instructions a step on {core}"
        facts.append((f"code, {core}", f"{counted(least['text_bytes'])} B"))
        facts.append((f"stack, {core}", f"{counted(least['stack_bytes'])} B"))
    cost, lost = (
        "No cross compiler was there: code, stack and instructions are unknown.",
        "No log was given, so what single precision loses is not known.",
    )
    rows = list(report["accuracy"])
    mine = next((k for k, a in enumerate(rows) if a["points"] == report["options"]["points"]), None)
    if mine is not None:
        text += f"; SOC stays within {_points(rows[mine]['soc_max'])} of the float64 EKF's"
        facts.append(("SOC RMSE against float64", _points(rows[mine]["soc_rmse"])))
    targets = report["targets"]
    sections = [
        Section(
            "cost", "Cost on the target", (_costs(targets) if targets else paragraph(cost),), "Cost"
        ),
        Section(
            "accuracy", "What is lost", (_lost(rows, mine) if rows else paragraph(lost),),
            "Accuracy",
        ),
        Section("files", "What was written", (_files(report),), "Files"),
    ]  # fmt: skip
    if on_log is not None:
        plot = Plot("trace", "The exported filter and the float64 EKF", *on_log.panels())
        sections.insert(2, Section("log", "Over a log", (plot,), "Log"))
    about = f"{report['model'] or 'A model'} as C for a step of {report['dt_s']:g} s, by cellwise"
    return write_page(path, f"{text}.", about, sections, report, lead=tiles(facts), figures=figures)


def cost_rows(targets: Sequence[Row]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """All costs of every core, a column each: head and rows."""

    def shown(value: float | None) -> str:
        return "" if value is None else counted(round(value))

    rows = [
        (name, *(shown(c.get(key)) for c in targets))
        for key, name in COSTS.items()
        if any(key in c for c in targets)
    ]
    return ("", *(c["core"] for c in targets)), rows


def _costs(targets: Sequence[Row]) -> Markup:
    caption = "Instructions of one step over samples of a drive in an emulator: not cycles."
    return table(*cost_rows(targets), caption=caption)


def _lost(rows: Sequence[Row], exported: int | None) -> Markup:
    """SOC lost by number of points, what was exported marked."""
    return record_table(
        rows,
        *ACCURACY_COLUMNS,
        caption="SOC of the exported filter minus that of the float64 EKF on the same samples.",
        marked=exported,
    )


def _files(report: Mapping[str, Any]) -> Markup:
    """Files, options, and the model they are of."""
    options = report["options"]
    on = [k for k, v in options.items() if v and k not in ("points", "temperatures")]
    lines = [
        f"{plural(len(report['files']), 'file')}: {listed(list(report['files']))}.",
        f"Tables of {plural(options['points'], 'SOC point')} and "
        f"{plural(options['temperatures'], 'temperature')}.",
        f"Compiled in: {listed(on) or 'nothing beyond the plain model'}.",
        f"A sample is {report['input_bytes']} bytes, an answer {report['output_bytes']}.",
        f"SHA-256 of the model: {report['model_sha256']}.",
    ]
    return bullets(lines)


def _points(share: float) -> str:
    """A small SOC error in points, two digits."""
    return f"{significant(100.0 * share, 2)} points"
