"""What a virtual fleet says of an exported filter: errors, where they are, a verdict; its page."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.estimate.sensor import assumed_text
from cellwise.records import check_ranges, within
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
from cellwise.typing import FloatArray

Row = Mapping[str, Any]

BINS = np.append(
    np.arange(0.0, 0.5, 0.0005), 2.0
)  # of the size of the SOC error, for its quantiles
AGES = (0.0, 1 / 3, 2 / 3, 1.0)
CLIMATES_C = (-60.0, -10.0, 0.0, 10.0, 20.0, 30.0, 45.0, 100.0)
WORST = 100  # cases that are named
SOURCES = {
    "model": "virtual cells",
    "physics": "cells of porous electrodes",
    "measured": "runs of measured logs",
}


@dataclass(frozen=True)
class Limits:
    """What a firmware asks for; None: not judged.

    Parameters
    ----------
    rmse, p95, worst : float or None     most of the SOC error, 0..1
    coverage : float or None             least share of the time within two deviations, 0..1

    Raises
    ------
    InputError        a limit that is not between 0 and 1
    """

    rmse: float | None = within(1e-9, 1.0, None)
    p95: float | None = within(1e-9, 1.0, None)
    worst: float | None = within(1e-9, 1.0, None)
    coverage: float | None = within(1e-9, 1.0, None)

    def __post_init__(self) -> None:
        check_ranges(self, "the limits, which are fractions (0.03 is three points of SOC)")


@dataclass(frozen=True, eq=False)
class Certificate:
    """Of an exported filter over a virtual fleet; every figure after its first hour.

    Parameters
    ----------
    rows : list of dict           one for each cell
    settings : dict               what it was made with
    description : dict            of the export
    limits : Limits
    split : dict or None          of a gauge: its error by causes, its failures; None: of an export
    """

    rows: list[dict[str, Any]]
    settings: dict[str, Any]
    description: dict[str, Any]
    limits: Limits
    split: dict[str, Any] | None = None

    @property
    def worst(self) -> list[dict[str, Any]]:
        """Rows of the lives with the largest errors, the largest first."""
        return sorted(self.rows, key=lambda r: -r["worst"])[:WORST]

    @property
    def beyond(self) -> list[str]:
        """Limits that are not kept, in words; each source of cells has to keep them.

        With a patch those of the runs with it.
        """
        stated = {name: limit for name, limit in asdict(self.limits).items() if limit is not None}
        failures = len(self.split["failures"]) if self.split else 0
        said = [f"no answer to the end in {failures} lives"] * bool(stated and failures)
        for source, found in (self.patched or self.sources).items():
            for name, limit in stated.items():
                value = found[name]  # none is kept where there is no number
                if not (value >= limit if name == "coverage" else value <= limit):
                    where = f" ({SOURCES[source]})" if len(self.sources) > 1 else ""
                    said.append(f"{name} {100.0 * value:.2f} %{where}, limit {100.0 * limit:g} %")
        return said

    @property
    def sources(self) -> dict[str, dict[str, float]]:
        """Figures of each source of cells."""
        return grouped(self.rows, lambda r: str(r["source"]))

    @property
    def patched(self) -> dict[str, dict[str, float]]:
        """Figures of each source of cells with the patch; none without one."""
        rows = [{**row, **row["patched"]} for row in self.rows if "patched" in row]
        return grouped(rows, lambda r: str(r["source"]))

    def to_dict(self) -> dict[str, Any]:
        """JSON values, as the contract of `cellwise certify` names them."""
        whole = figures_of(self.rows)
        stated = {k: v for k, v in asdict(self.limits).items() if v is not None}
        targets = self.description.get("targets") or []
        aged = [r for r in self.rows if r["age"] is not None]
        return {
            "cells": len(self.rows),
            "hours": self.settings["hours"],
            "soc_error": {k: whole[k] for k in ("rmse", "p95", "worst")},
            "coverage_2sigma": whole["coverage"],
            "discharges_within_3_points": whole["ends_near"],
            "discharges": whole["ends"],
            "by": {
                "age": grouped(sorted(aged, key=lambda r: float(r["age"])), _age),
                "temperature": grouped(sorted(self.rows, key=_temperature), _climate),
                "fault": grouped(sorted(self.rows, key=_temperature), lambda r: str(r["fault"])),
            },
            "restart_loss": max(row["restart_loss"] for row in self.rows),
            "worst": [_case(row) for row in self.worst],
            "sources": self.sources,
            "instructions": {t["core"]: t["instructions_mean"] for t in targets},
            "verdict": {
                "within": None if not stated else not self.beyond,
                "limits": stated,
                "beyond": self.beyond,
            },
            "sensor": self.settings["sensor"],
            "settings": self.settings,
            **({"patched": self.patched} if self.patched else {}),
            **(self.split or {}),
        }

    def __repr__(self) -> str:
        whole = figures_of(self.rows)
        return (
            f"Certificate({fleet_text(self.sources, self.settings)}: SOC error "
            f"{100 * whole['rmse']:.2f} % RMS, {100 * whole['p95']:.2f} % in 95 % of the time, "
            + (f"{100 * whole['coverage']:.0f} %" if whole["coverage"] >= 0.0 else "no deviation")
            + " within two deviations)" * (whole["coverage"] >= 0.0)
        )


def fleet_text(sources: Mapping[str, Mapping[str, float]], settings: Mapping[str, Any]) -> str:
    """How many cells of which source lived how long."""
    hours = {"model": settings["hours"], "physics": settings["physics_hours"]}
    each = {source: f" x {hours[source]:g} h" if source in hours else "" for source in sources}
    return ", ".join(f"{SOURCES[s]} {one['cells']:.0f}{each[s]}" for s, one in sources.items())


def life_error(size: FloatArray) -> dict[str, Any]:
    """What a row keeps of the sizes of a life's SOC errors, for figures over many."""
    return {
        "rows": size.size,
        "squares": float(np.sum(size**2)),
        "worst": float(size.max()),
        "counts": np.histogram(np.minimum(size, BINS[-1]), BINS)[0].tolist(),
    }


def soc_error(rows: Sequence[Row]) -> dict[str, float]:
    """RMSE, 95 % quantile and worst over all hours of the cells."""
    samples = sum(r["rows"] for r in rows)
    within = np.cumsum(np.sum([r["counts"] for r in rows], axis=0)) / max(samples, 1)
    return {
        "rmse": math.sqrt(sum(r["squares"] for r in rows) / samples),
        "p95": float(BINS[1 + int(np.searchsorted(within, 0.95))]),
        "worst": max(r["worst"] for r in rows),
    }


def figures_of(rows: Sequence[Row]) -> dict[str, float]:
    """Figures over all hours of the cells: RMSE, 95 % quantile, worst, coverage, discharges."""
    ends = sum(r["ends"] for r in rows)
    return {
        **soc_error(rows),
        "coverage": sum(r["inside"] * r["rows"] for r in rows) / sum(r["rows"] for r in rows),
        "ends": ends,
        "ends_near": sum(r["ends_near"] for r in rows) / ends if ends else math.nan,
    }


def grouped(rows: Iterable[Row], key: Callable[[Row], str]) -> dict[str, dict[str, float]]:
    """Figures of the cells that share a key, in the order of the keys' first cell."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return {name: {"cells": len(own), **figures_of(own)} for name, own in groups.items()}


def _temperature(row: Row) -> float:
    return float(row["temperature_C"])


def _age(row: Row) -> str:
    return _band(row["age"], AGES, "{:.2f} to {:.2f} of its life")


def _climate(row: Row) -> str:
    return _band(row["temperature_C"], CLIMATES_C, "{:g} to {:g} degC")


def _band(value: float, edges: Sequence[float], text: str) -> str:
    k = min(max(int(np.searchsorted(edges, value, side="right")), 1), len(edges) - 1)
    return text.format(edges[k - 1], edges[k])


def _case(row: Row) -> dict[str, Any]:
    names = ("source", "cell", "name", "age", "temperature_C", "fault", "capacity_Ah", "soc0")
    more = ("started_at", "worst", "worst_h", "log")
    found = {name: row[name] for name in (*names, *more) if name in row}
    return {**found, "rmse": math.sqrt(row["squares"] / row["rows"])}


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
    "hysteresis, temperature law; what the model's fit left open is drawn, too. What the "
    "equivalent circuit itself gets wrong is in them only as large as the model says.",
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
    sources, patched = divided.pop("source"), divided.pop("patch", None)
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
        f"Certificate of {whose(data)} {model or 'an unnamed cell'}, by cellwise",
        [
            Section("causes", "What makes it wrong", cause_blocks(data)),
            Section("patch", "Without and with the patch", patch_blocks(patched)),
            Section("sources", "By what made the cells", (group_table("source", sources),)),
            Section("groups", "Where the error is", where),
            Section("worst", "The worst cells", (_worst(data),)),
            Section("made", "What the fleet is", (_made(data),)),
        ],
        data,
        lead=lead_of(alerts, facts, worst),
    )


PATCHED = (
    "The same cells, sensors and faults, stepped by the same C, before and after it has taken the "
    "patch; stated limits are those of the runs after."
)
OWN = (
    "On cells that are the model's, with a true start and, unless they are stated, perfect "
    "sensors: what each cause adds to the error, of which the first hour weighs as much as all "
    "that follows, and by how much the world had to be moved to make it right for the gauge."
)
NO_NUMBER = (
    "What no number of the gauge corrects: age is what aged cells add, restart what losses of "
    "power do, temperature what its tables have not, tuning what remains of the squares."
)
OF_FLEET = "On the certificate's fleet: how much smaller the error is with each cause made perfect."
CAUSE_COLUMNS = (
    ("cause", lambda c: str(c["name"]).replace("_", " ")),
    ("points of SOC", lambda c: f"{100.0 * c['points']:.2f}"),
)
CORRECTION = (
    "right for the gauge",
    lambda c: "none found" if c["is_open"] else f"{c['correction']:+.3g} {c['unit']}",
)


def cause_blocks(data: Mapping[str, Any]) -> Blocks:
    """A gauge's error by causes; nothing of an export."""
    if "causes" not in data:
        return ()
    numbers, left = split_causes(data["causes"])
    rest = (
        f"Its own error is {percent(data['own_error'])}, {percent(data['tuning'])} with all its "
        "numbers made right at once: tuning, and what its model has not."
    )
    failed = [f"{f['name']} ({f['fault']}): {f['problem']}" for f in data["failures"][:SHOWN]]
    return (
        paragraph(advice(data)),
        record_table(numbers, *CAUSE_COLUMNS, CORRECTION, caption=OWN),
        record_table(left, *CAUSE_COLUMNS, caption=NO_NUMBER),
        paragraph(rest),
        record_table(data["fleet_causes"], *CAUSE_COLUMNS, caption=OF_FLEET),
        *([bullets(failed)] if failed else []),
    )


def split_causes(causes: Sequence[Row]) -> tuple[list[Row], list[Row]]:
    """Causes that a number of the gauge's source corrects, and those that none does."""
    return [c for c in causes if c["unit"]], [c for c in causes if not c["unit"]]


def advice(data: Mapping[str, Any]) -> str:
    """What to correct first, what remains beside it, and what its fleet does most."""
    numbers, left = split_causes(data["causes"])
    said = [f"No number of its own, corrected, brings a tenth of its {percent(data['own_error'])}."]
    for first in (c for c in numbers if c["name"] == data["to_correct"]):
        brings = f"{_worth(first)} of {100.0 * data['own_error']:.2f}"
        said = [f"What would bring most to correct: {brings} ({CORRECTION[1](first)})."]
    others = {"What remains beside": left, "Of its fleet most": data["fleet_causes"]}
    for what, causes in others.items():
        if causes and causes[0]["points"] > 0.0:
            said.append(f"{what}: {_worth(causes[0])}.")
    return " ".join(said)


def _worth(cause: Row) -> str:
    return f"{str(cause['name']).replace('_', ' ')}, {100.0 * cause['points']:.2f} points"


def whose(data: Mapping[str, Any]) -> str:
    """What was certified, up to the cell's name."""
    name = data["settings"].get("gauge")
    return f"the gauge {name} on" if name else "the exported filter of"


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
    found = {"source": sources, **{name: own for name, own in data["by"].items() if own}}
    if "patched" in data:
        columns = {"as exported": data["sources"], "with the patch": data["patched"]}
        found["patch"] = {
            f"{SOURCES[name]}, {how}": column[name]
            for name in data["sources"]
            for how, column in columns.items()
        }
    return found


def patch_blocks(groups: Groups | None) -> Blocks:
    """The same lives without and with the patch; nothing without one."""
    if groups is None:
        return ()
    return (paragraph(PATCHED, "note"), group_table("patch", groups))


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
    cost = ", ".join(f"{core} {n:,.0f}" for core, n in data["instructions"].items())
    logs = [f"{name} (from {soc0:.2f}, {ah:.3g} Ah)" for name, soc0, ah in settings["measured"]]
    return bullets(
        (
            *MADE,
            f"Measured logs: {', '.join(logs) or 'none'}.",
            f"As standard deviations, {assumed_text(settings['sensor'])}.",
            f"Over a restart the error grew by {percent(data['restart_loss'])} at most beyond what "
            "flowed since the last write.",
            f"Seed {settings['seed']}, time step {settings['dt_s']:g} s, model sha256 "
            f"{settings['model_sha256'][:16]}.",
            f"Instructions of a step: {cost or 'not counted, no cross compiler at the export'}.",
        )
    )
