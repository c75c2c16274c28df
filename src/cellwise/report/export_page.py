"""The page of an export: what the filter costs on the target, and what it loses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cellwise.plotting import Plottable
from cellwise.report.page.markup import Markup, bullets, paragraph, record_table, table, tiles
from cellwise.report.page.numerals import counted, listed, plural, significant
from cellwise.report.page.picture import FigureFiles
from cellwise.report.page.plot import Plot
from cellwise.report.page.section import Blocks, Section, write_page

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
}


def export_page(
    report: Mapping[str, Any],
    path: str | Path,
    on_log: Plottable | None = None,
    *,
    figures: str | Path | FigureFiles | None = None,
) -> Path:
    """Write the page of an export.

    Parameters
    ----------
    report : mapping             what `cellwise export --json` prints
    on_log : Plottable or None   the exported filter beside the float64 one over a log
    path, figures : as of `write_page`, whose errors it raises
    """
    return write_page(
        path,
        export_finding(report),
        f"{report['model'] or 'A model'} as C for a step of {report['dt_s']:g} s, by cellwise",
        export_sections(report, on_log),
        report,
        lead=export_tiles(report),
        figures=figures,
    )


def export_finding(report: Mapping[str, Any]) -> str:
    """What a step costs and what it loses."""
    name = report["model"] or "The model"
    text = f"{name} in C takes {counted(report['model_bytes'])} bytes of tables and "
    text += f"{report['state_bytes']} bytes per cell"
    cheapest = _cheapest(report["targets"])
    if cheapest is not None:
        text += f", {counted(round(cheapest['instructions_mean']))} instructions a step on "
        text += cheapest["core"]
    mine = _exported(report)
    if mine is not None:
        text += f"; SOC stays within {_points(mine['soc_max'])} of the float64 EKF's"
    return text + "."


def export_tiles(report: Mapping[str, Any]) -> Markup:
    """Key figures."""
    facts: list[tuple[object, object]] = [
        ("tables in flash", f"{counted(report['model_bytes'])} B"),
        ("state per cell", f"{report['state_bytes']} B"),
        ("time step", f"{report['dt_s']:g} s"),
        ("states", report["states"]),
    ]
    cheapest = _cheapest(report["targets"])
    if cheapest is not None:
        facts.append((f"code, {cheapest['core']}", f"{counted(cheapest['text_bytes'])} B"))
        facts.append((f"stack, {cheapest['core']}", f"{counted(cheapest['stack_bytes'])} B"))
    mine = _exported(report)
    if mine is not None:
        facts.append(("SOC RMSE against float64", _points(mine["soc_rmse"])))
    return tiles(facts)


def export_sections(report: Mapping[str, Any], on_log: Plottable | None) -> list[Section]:
    """The parts of the page."""
    targets = report["targets"]
    cost: Blocks = (
        paragraph("No cross compiler was there: code, stack and instructions are unknown."),
    )
    lost: Blocks = (paragraph("No log was given, so what single precision loses is not known."),)
    if targets:
        cost = (cost_table(targets),)
    if report["accuracy"]:
        lost = (accuracy_table(report),)
    sections = [
        Section("cost", "Cost on the target", cost, "Cost"),
        Section("accuracy", "What is lost", lost, "Accuracy"),
        Section("files", "What was written", (files_content(report),), "Files"),
    ]
    if on_log is not None:
        plot = Plot("trace", "The exported filter and the float64 EKF", *on_log.panels())
        sections.insert(2, Section("log", "Over a log", (plot,), "Log"))
    return sections


def cost_table(targets: Sequence[Row]) -> Markup:
    """All costs of every core, a column each."""

    def shown(value: float | None) -> str:
        return "" if value is None else counted(round(value))

    rows = [(name, *(shown(c.get(key)) for c in targets)) for key, name in COSTS.items()]
    caption = "Instructions of one step over samples of a drive in an emulator: not cycles."
    return table(("", *(c["core"] for c in targets)), rows, caption=caption)


def accuracy_table(report: Mapping[str, Any]) -> Markup:
    """SOC lost by number of points, what was exported marked."""
    mine = _exported(report)
    return record_table(
        report["accuracy"],
        ("SOC points", lambda a: a["points"]),
        ("tables [B]", lambda a: counted(a["flash_bytes"])),
        ("RMSE [points]", lambda a: f"{100 * a['soc_rmse']:.4f}"),
        ("largest [points]", lambda a: f"{100 * a['soc_max']:.4f}"),
        caption="SOC of the exported filter minus that of the float64 EKF on the same samples.",
        marked=None if mine is None else list(report["accuracy"]).index(mine),
    )


def files_content(report: Mapping[str, Any]) -> Markup:
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


def _cheapest(targets: Sequence[Row]) -> Row | None:
    """The core that takes the fewest instructions; None where none was counted."""
    known = [c for c in targets if c["instructions_mean"] is not None]
    return min(known, key=lambda c: float(c["instructions_mean"]), default=None)


def _points(share: float) -> str:
    """A small SOC error in points, two digits."""
    return f"{significant(100.0 * share, 2)} points"


def _exported(report: Mapping[str, Any]) -> Row | None:
    """The row of the accuracy that is of what was exported."""
    points = report["options"]["points"]
    return next((a for a in report["accuracy"] if a["points"] == points), None)
