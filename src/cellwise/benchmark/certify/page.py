"""The page of a certificate: how wrong an exported filter will be, and on which cells."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cellwise.benchmark.certify.certificate import SOURCES, fleet_text
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
from cellwise.report.page.numerals import percent
from cellwise.report.page.picture import pictured
from cellwise.report.page.section import Blocks, Section, write_page

NARROW = 0.8  # share of the time inside two standard deviations: below, the band misleads
SHOWN = 20  # worst cases on the page; all that are named stand in its data
GROUPS = (
    "RMS error (dot) and the error that 95 % of the time stays below (bar). Every group is of the "
    "same filter and the same tables."
)
# How a group of cells reads, behind its name.
GROUP_COLUMNS = (
    ("cells", lambda g: f"{g[1]['cells']:.0f}"),
    ("RMSE", lambda g: percent(g[1]["rmse"])),
    ("95 % of the time below", lambda g: percent(g[1]["p95"], 1)),
    ("worst", lambda g: percent(g[1]["worst"], 1)),
    ("within two deviations", lambda g: percent(g[1]["coverage"], 0)),
)
MADE = (
    "Virtual cells are the exported model, varied and aged: capacity, each resistance, OCV, "
    "hysteresis, temperature law. What the equivalent circuit itself gets wrong is in them only as "
    "large as the model says.",
    "Cells of porous electrodes (PyBaMM's SPMe, kinetics and transport of Chen2020), where there "
    "are any, have the OCV, the capacity and the pulses of such a cell, after one second and ten "
    "minutes at half charge; how they answer to everything else is physics. They have no "
    "hysteresis.",
    "Measured logs are run as they are and with every fault; their SOC is counted from the stated "
    "or shown start over the stated capacity.",
    "At age 1 a cell has about 80 % of its capacity and twice its resistance. Every second cell "
    "has a fault beside what its sensors are off by. The filter starts 15 points off (one standard "
    "deviation), and its first hour is not scored.",
)
Groups = Mapping[str, Mapping[str, float]]


def certificate_page(data: Mapping[str, Any], model: str, path: str | Path) -> Path:
    """Write the page of what `cellwise certify` found.

    Parameters
    ----------
    data : mapping          the certificate's JSON
    model : str             name of the exported model
    path : as of `write_page`, whose errors it raises
    """
    error, inside = data["soc_error"], data["coverage_2sigma"]
    divided = groups_of(data)
    sources = divided.pop("source")
    pictures = [group_picture(n, g)._replace(key=f"certificate-{n}") for n, g in divided.items()]
    tables = Markup("".join(group_table(name, groups) for name, groups in divided.items()))
    where: Blocks = (
        paragraph(GROUPS, "note"),
        *pictures,
        details("The groups in numbers", tables),
    )
    alerts = [
        f"Do not rely on the filter's band: it holds {percent(inside, 0)} of the time, 95 % if it "
        "were right."
    ] * (inside < NARROW)
    worst = []
    for name, groups in divided.items():
        rmse, most = max((one["rmse"], group) for group, one in groups.items())
        if len(groups) > 1:
            worst.append(f"Worst by {name}: {_named(most)}, {percent(rmse, 1)} RMS.")
    facts = tiles(
        (
            ("SOC error, RMS", percent(error["rmse"])),
            ("below this in 95 % of the time", percent(error["p95"], 1)),
            ("worst", percent(error["worst"], 1)),
            ("within two deviations", percent(inside, 0)),
            ("discharges ending within 3 points", percent(data["discharges_within_3_points"], 0)),
        )
    )
    return write_page(
        path,
        finding(data),
        f"Certificate of the exported filter of {model or 'an unnamed cell'}, by cellwise",
        [
            Section("sources", "By what made the cells", (group_table("source", sources),)),
            Section("groups", "Where the error is", where),
            Section("worst", "The worst cells", (_worst(data),)),
            Section("made", "What the fleet is", (_made(data),)),
        ],
        data,
        lead=lead_of(alerts, facts, worst),
    )


def finding(data: Mapping[str, Any]) -> str:
    """The first line: the verdict where limits are stated, else the error."""
    within, error = data["verdict"]["within"], percent(data["soc_error"]["rmse"])
    fleet = fleet_text(data["sources"], data["settings"])
    if within is False:
        return f"Beyond its limits on {fleet}: {'; '.join(data['verdict']['beyond'])}"
    return f"{'Within its limits on ' + fleet + ': ' if within else ''}SOC error {error} RMS" + (
        "" if within else f" on {fleet}"
    )


def groups_of(data: Mapping[str, Any]) -> dict[str, Groups]:
    """Groups that have members, by what they divide: of measured logs alone no age is known."""
    sources = {SOURCES[name]: one for name, one in data["sources"].items()}
    return {"source": sources, **{name: own for name, own in data["by"].items() if own}}


@pictured("certificate")
def group_picture(name: str, groups: Groups) -> style.Figure:
    """RMS and 95 % error of every group of a division."""
    rmse, p95 = ([100.0 * one[k] for one in groups.values()] for k in ("rmse", "p95"))
    text = f"By {name}: {min(rmse):.1f} to {max(rmse):.1f} points RMS"
    return style.dots_on_bars(list(map(_named, groups)), rmse, p95, text, "SOC error [points]")


def group_table(name: str, groups: Groups) -> Markup:
    """A row for each group."""
    return record_table(groups.items(), (name, lambda g: _named(g[0])), *GROUP_COLUMNS)


def _named(group: str) -> str:
    return group.replace("degC", "°C").replace("-", "−")


def _worst(data: Mapping[str, Any]) -> Markup:
    return record_table(
        data["worst"][:SHOWN],
        ("cell", lambda r: r["name"]),
        ("fault", lambda r: r["fault"]),
        ("age", lambda r: "-" if r["age"] is None else f"{r['age']:.2f}"),
        ("°C", lambda r: f"{r['temperature_C']:.0f}"),
        ("RMSE", lambda r: percent(r["rmse"], 1)),
        ("worst", lambda r: percent(r["worst"], 1)),
        ("at hour", lambda r: f"{r['worst_h']:.1f}"),
        caption="The same seed and number make the same cell again.",
        text_columns=(0, 1),
    )


def _made(data: Mapping[str, Any]) -> Markup:
    settings = data["settings"]
    sensor = ", ".join(f"{k} {v:.3g}" for k, v in settings["sensor"].items())
    cost = ", ".join(f"{core} {n:,.0f}" for core, n in data["instructions"].items())
    logs = [f"{name} (from {soc0:.2f}, {ah:.3g} Ah)" for name, soc0, ah in settings["measured"]]
    return bullets(
        (
            *MADE,
            f"Measured logs: {', '.join(logs) or 'none'}.",
            f"Sensors, as standard deviations: {sensor}.",
            f"Seed {settings['seed']}, time step {settings['dt_s']:g} s, model sha256 "
            f"{settings['model_sha256'][:16]}.",
            f"Instructions of a step: {cost or 'not counted, no cross compiler at the export'}.",
        )
    )
