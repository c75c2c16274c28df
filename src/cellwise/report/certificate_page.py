"""The page of a certificate: how wrong an exported filter will be, and on which cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cellwise.report.page import style
from cellwise.report.page.markup import (
    Markup,
    bullets,
    details,
    lead_of,
    paragraph,
    record_table,
    tiles,
)
from cellwise.report.page.picture import FigureFiles, pictured
from cellwise.report.page.section import Section, write_page

SOURCES = {
    "model": "virtual cells",
    "physics": "cells of porous electrodes",
    "measured": "runs of measured logs",
}
NARROW = 0.8  # share of the time inside two standard deviations: below, the band misleads
SHOWN = 20  # worst cases on the page; all that are named stand in its data


def certificate_page(
    data: Mapping[str, Any],
    model: str,
    path: str | Path,
    *,
    figures: str | Path | FigureFiles | None = None,
) -> Path:
    """Write the page of what `cellwise certify` found.

    Parameters
    ----------
    data : mapping          the certificate's JSON
    model : str             name of the exported model
    path, figures : as of `write_page`, whose errors it raises
    """
    error, by = data["soc_error"], data["by"]
    sources = {SOURCES[name]: one for name, one in data["sources"].items()}
    tables = details("The groups in numbers", Markup("".join(map(_table, _shown(by).items()))))
    pictures = tuple(
        group_picture(name, groups)._replace(key=f"certificate-{name}")
        for name, groups in _shown(by).items()
    )
    sections = [
        Section("sources", "By what made the cells", (_table(("source", sources)),)),
        Section("groups", "Where the error is", (paragraph(GROUPS, "note"), *pictures, tables)),
        Section("worst", "The worst cells", (_worst(data),)),
        Section("made", "What the fleet is", (_made(data),)),
    ]
    worst = (
        f"Worst by {name}: {_named(max(groups, key=lambda g: groups[g]['rmse']))}, "
        f"{_percent(max(g['rmse'] for g in groups.values()), 1)} RMS."
        for name, groups in _shown(by).items()
        if len(groups) > 1
    )
    inside = data["coverage_2sigma"]
    narrow = [f"Do not rely on the filter's band: it holds {_percent(inside, 0)} of the time, 95 % "
              "if it were right."] if inside < NARROW else []  # fmt: skip
    figures_of_all = tiles(
        (
            ("SOC error, RMS", _percent(error["rmse"], 2)),
            ("below this in 95 % of the time", _percent(error["p95"], 1)),
            ("worst", _percent(error["worst"], 1)),
            ("within two deviations", _percent(data["coverage_2sigma"], 0)),
            ("discharges ending within 3 points", _percent(data["discharges_within_3_points"], 0)),
        )
    )
    return write_page(
        path,
        finding(data),
        f"Certificate of the exported filter of {model or 'an unnamed cell'}, by cellwise",
        sections,
        data,
        lead=lead_of(narrow, figures_of_all, list(worst)),
        figures=figures,
    )


def finding(data: Mapping[str, Any]) -> str:
    """The first line: the verdict where limits are stated, else the error."""
    verdict, error = data["verdict"], data["soc_error"]
    fleet = fleet_text(data["sources"], data["settings"])
    if verdict["within"] is False:
        return f"Beyond its limits on {fleet}: {'; '.join(verdict['beyond'])}"
    if verdict["within"]:
        return f"Within its limits on {fleet}: SOC error {_percent(error['rmse'], 2)} RMS"
    return f"SOC error {_percent(error['rmse'], 2)} RMS on {fleet}"


def fleet_text(sources: Mapping[str, Mapping[str, float]], settings: Mapping[str, Any]) -> str:
    """How many cells of which source lived how long."""
    hours = {"model": settings["hours"], "physics": settings["physics_hours"]}
    parts = []
    for source, found in sources.items():
        each = f" x {hours[source]:g} h" if source in hours else ""
        parts.append(f"{SOURCES[source]} {found['cells']:.0f}{each}")
    return ", ".join(parts)


GROUPS = (
    "RMS error (dot) and the error that 95 % of the time stays below (bar). Every group is of the "
    "same filter and the same tables."
)


@pictured("certificate")
def group_picture(name: str, groups: Mapping[str, Any]) -> style.Figure:
    """RMS and 95 % error of every group of a division."""
    figure, axes = style.new_axes(0.9 + 0.24 * len(groups))
    order = list(groups)[::-1]
    names = list(map(_named, order))
    axes.barh(names, [100.0 * groups[n]["p95"] for n in order], color=style.BLUE, alpha=0.35)
    axes.plot([100.0 * groups[n]["rmse"] for n in order], names, "o", color=style.INK, ms=4)
    style.finding(axes, f"by {name}")
    style.labels(axes, "SOC error [points]")
    return figure


def _shown(by: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """Groups that have members: of measured logs alone no age is known."""
    return {name: groups for name, groups in by.items() if groups}


def _named(group: str) -> str:
    return group.replace("degC", "°C").replace("-", "−")


def _table(group: tuple[str, Mapping[str, Mapping[str, float]]]) -> Markup:
    name, groups = group
    return record_table(
        list(groups.items()),
        (name, lambda g: _named(g[0])),
        ("cells", lambda g: f"{g[1]['cells']:.0f}"),
        ("RMSE", lambda g: _percent(g[1]["rmse"], 2)),
        ("95 % of the time below", lambda g: _percent(g[1]["p95"], 1)),
        ("worst", lambda g: _percent(g[1]["worst"], 1)),
        ("within two deviations", lambda g: _percent(g[1]["coverage"], 0)),
    )


def _worst(data: Mapping[str, Any]) -> Markup:
    return record_table(
        data["worst"][:SHOWN],
        ("cell", lambda r: r["name"]),
        ("fault", lambda r: r["fault"]),
        ("age", lambda r: "-" if r["age"] is None else f"{r['age']:.2f}"),
        ("°C", lambda r: f"{r['temperature_C']:.0f}"),
        ("RMSE", lambda r: _percent(r["rmse"], 1)),
        ("worst", lambda r: _percent(r["worst"], 1)),
        ("at hour", lambda r: f"{r['worst_h']:.1f}"),
        caption="The same seed and number make the same cell again.",
        text_columns=(0, 1),
    )


def _made(data: Mapping[str, Any]) -> Markup:
    settings = data["settings"]
    sensor = ", ".join(f"{k} {v:.3g}" for k, v in settings["sensor"].items())
    cost = ", ".join(f"{core} {n:,.0f}" for core, n in data["instructions"].items())
    return bullets(
        (
            "Virtual cells are the exported model, varied and aged: capacity, each resistance, "
            "OCV, hysteresis, temperature law. What the equivalent circuit itself gets wrong is in "
            "them only as large as the model says.",
            _physics_text(data),
            _measured_text(settings["measured"]),
            "At age 1 a cell has about 80 % of its capacity and twice its resistance.",
            "Every second cell has a fault beside what its sensors are off by.",
            "The filter starts 15 points off (one standard deviation), and its first hour is not "
            "scored.",
            f"Sensors, as standard deviations: {sensor}.",
            f"Seed {settings['seed']}, time step {settings['dt_s']:g} s, model sha256 "
            f"{settings['model_sha256'][:16]}.",
            f"Instructions of a step: {cost or 'not counted, no cross compiler at the export'}.",
        )
    )


def _physics_text(data: Mapping[str, Any]) -> str:
    if "physics" not in data["sources"]:
        return "No cell is a physics model: PyBaMM was not asked for, or is not installed."
    return (
        "Cells of porous electrodes (PyBaMM's SPMe, kinetics and transport of Chen2020) have the "
        "OCV, the capacity and the pulses of such a cell, after one second and ten minutes at half "
        "charge; how they answer to everything else is physics. They have no hysteresis."
    )


def _measured_text(logs: Sequence[Sequence[Any]]) -> str:
    if not logs:
        return "No measured log is among them."
    named = ", ".join(f"{name} (from {soc0:.2f}, {ah:.3g} Ah)" for name, soc0, ah in logs)
    return (
        f"Measured logs, each as it is and with every fault: {named}. Their SOC is counted from "
        "the stated or shown start over the stated capacity."
    )


def _percent(share: float | None, digits: int) -> str:
    return "-" if share is None or share != share else f"{100.0 * share:.{digits}f} %"
