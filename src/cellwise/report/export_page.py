"""The page of an export: what the filter costs on the target, and what it loses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.report.page import style
from cellwise.report.page.markup import Markup, bullets, paragraph, record_table, table, tiles
from cellwise.report.page.numerals import counted, listed, plural, significant
from cellwise.report.page.picture import FigureFiles, pictured
from cellwise.report.page.section import Blocks, HasPanels, Section, trace_section, write_page

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
    on_log: HasPanels | None = None,
    *,
    figures: str | Path | FigureFiles | None = None,
) -> Path:
    """Write the page of an export.

    Parameters
    ----------
    report : mapping             what `cellwise export --json` prints
    path : str or Path           of the HTML file; it appears whole or not at all
    on_log : with panels, None   the exported filter beside the float64 one over a log
    figures : folder or FigureFiles   for the same pictures as files

    Raises
    ------
    InputError        matplotlib is missing; the path cannot be written
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


def export_sections(report: Mapping[str, Any], on_log: HasPanels | None) -> list[Section]:
    """The parts of the page."""
    targets = report["targets"]
    cost: Blocks = (
        paragraph("No cross compiler was there: code, stack and instructions are unknown."),
    )
    lost: Blocks = (paragraph("No log was given, so what single precision loses is not known."),)
    if targets:
        cost = (cost_picture(targets), cost_table(targets))
    if report["accuracy"]:
        lost = (accuracy_picture(report), accuracy_table(report))
    sections = [
        Section("cost", "Cost on the target", cost, "Cost"),
        Section("accuracy", "What is lost", lost, "Accuracy"),
        Section("files", "What was written", (files_content(report),), "Files"),
    ]
    if on_log is not None:
        sections.insert(2, trace_section([("exported filter and float64 EKF", on_log)]))
    return sections


@pictured(
    "export-cost",
    "Instructions of one step, mean and most, over samples of a drive in an emulator (QEMU counts "
    "instructions, not cycles; the scale is logarithmic), and the bytes of code and tables.",
)
def cost_picture(targets: Sequence[Row]) -> style.Figure:
    """Instructions and flash of every core."""
    figure = style.new_figure(2.9)
    left, right = style.panels(figure, 1, 2)
    place = np.arange(len(targets))
    names = [c["core"] for c in targets]
    cheapest = _cheapest(targets)
    if cheapest is not None:
        mean = [c["instructions_mean"] or 0.0 for c in targets]
        most = [c["instructions_most"] or 0.0 for c in targets]
        left.bar(place - 0.2, mean, 0.38, color=style.FILTER, label="mean")
        left.bar(place + 0.2, most, 0.38, color=style.MODEL, label="most on the log")
        left.set_yscale("log")
        left.set_ylim(bottom=0.3 * min(v for v in mean if v > 0.0))
        style.plain_numbers(left.yaxis)
        style.legend(left)
        text = f"{counted(round(cheapest['instructions_mean']))} instructions on {cheapest['core']}"
        style.finding(left, text, 0.42)
    code = np.array([c["text_bytes"] for c in targets])
    tables = np.array([c["model_bytes"] for c in targets])
    right.bar(place, code, 0.6, color=style.FILTER, label="code")
    right.bar(place, tables, 0.6, bottom=code, color=style.MUTED, label="tables")
    style.legend(right)
    style.finding(right, f"{counted(int((code + tables).max()))} bytes of flash at most", 0.42)
    for axes, label in ((left, "instructions [1 per step]"), (right, "flash [B]")):
        axes.set_xticks(place, names)
        axes.grid(axis="x", visible=False)
        style.labels(axes, "core [name]", label)
    return figure


@pictured(
    "export-accuracy",
    "Every dot is a number of SOC points: how far SOC is from the float64 EKF of the full model on "
    "the log, over the bytes of its tables. The ring is what was exported. The ordinate is "
    "logarithmic.",
)
def accuracy_picture(report: Mapping[str, Any]) -> style.Figure:
    """SOC lost over the bytes of the tables."""
    figure = style.new_figure(3.2)
    axes = figure.subplots()
    rows = sorted(report["accuracy"], key=lambda a: a["flash_bytes"])
    size = [a["flash_bytes"] for a in rows]
    for key, colour, name in (
        ("soc_max", style.MODEL, "largest"),
        ("soc_rmse", style.FILTER, "RMSE"),
    ):
        values = [max(100.0 * a[key], 1e-6) for a in rows]
        axes.plot(size, values, "o-", color=colour, linewidth=1.0, markersize=4, label=name)
    for a in rows:
        at = (a["flash_bytes"], max(100.0 * a["soc_max"], 1e-6))
        style.note(axes, f"{a['points']}", at, ha="center")
    mine = _exported(report)
    if mine is not None:
        spot = ([mine["flash_bytes"]], [max(100.0 * mine["soc_rmse"], 1e-6)])
        axes.plot(
            *spot, "o", markersize=11, markerfacecolor="none", color=style.MUTED, label="exported"
        )
        style.finding(
            axes,
            f"{mine['points']} SOC points: {_points(mine['soc_rmse'])} RMSE, "
            f"{_points(mine['soc_max'])} at most",
        )
    axes.set_yscale("log")
    style.plain_numbers(axes.yaxis)
    axes.margins(y=0.15)
    style.legend(axes)
    style.labels(axes, "tables in flash [B]", "SOC against float64 [points]")
    return figure


def cost_table(targets: Sequence[Row]) -> Markup:
    """All costs of every core."""

    def shown(value: float | None) -> str:
        return "" if value is None else counted(round(value))

    rows = [(c["core"], *(shown(c.get(key)) for key in COSTS)) for c in targets]
    return table(("core", *COSTS.values()), rows)


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
