"""What a virtual fleet says of an exported filter: its errors, where they are, and a verdict."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cellwise.benchmark.records import check_ranges, within

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
    """

    rows: list[dict[str, Any]]
    settings: dict[str, Any]
    description: dict[str, Any]
    limits: Limits

    @property
    def worst(self) -> list[dict[str, Any]]:
        """Rows of the lives with the largest errors, the largest first."""
        return sorted(self.rows, key=lambda r: -r["worst"])[:WORST]

    @property
    def beyond(self) -> list[str]:
        """Limits that are not kept, in words; each source of cells has to keep them."""
        said = []
        for source, found in self.sources.items():
            for name, limit in asdict(self.limits).items():
                value = found[name]
                if limit is not None and (value < limit if name == "coverage" else value > limit):
                    where = f" ({SOURCES[source]})" if len(self.sources) > 1 else ""
                    said.append(f"{name} {100.0 * value:.2f} %{where}, limit {100.0 * limit:g} %")
        return said

    @property
    def sources(self) -> dict[str, dict[str, float]]:
        """Figures of each source of cells."""
        return grouped(self.rows, lambda r: str(r["source"]))

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
            "worst": [_case(row) for row in self.worst],
            "sources": self.sources,
            "instructions": {t["core"]: t["instructions_mean"] for t in targets},
            "verdict": {
                "within": None if not stated else not self.beyond,
                "limits": stated,
                "beyond": self.beyond,
            },
            "settings": self.settings,
        }

    def __repr__(self) -> str:
        whole = figures_of(self.rows)
        return (
            f"Certificate({fleet_text(self.sources, self.settings)}: SOC error "
            f"{100 * whole['rmse']:.2f} % RMS, {100 * whole['p95']:.2f} % in 95 % of the time, "
            f"{100 * whole['coverage']:.0f} % within two deviations)"
        )


def fleet_text(sources: Mapping[str, Mapping[str, float]], settings: Mapping[str, Any]) -> str:
    """How many cells of which source lived how long."""
    hours = {"model": settings["hours"], "physics": settings["physics_hours"]}
    each = {source: f" x {hours[source]:g} h" if source in hours else "" for source in sources}
    return ", ".join(f"{SOURCES[s]} {one['cells']:.0f}{each[s]}" for s, one in sources.items())


def figures_of(rows: Sequence[Row]) -> dict[str, float]:
    """Figures over all hours of the cells: RMSE, 95 % quantile, worst, coverage, discharges."""
    samples = sum(r["rows"] for r in rows)
    counts = np.sum([r["counts"] for r in rows], axis=0)
    within = np.cumsum(counts) / max(samples, 1)
    ends = sum(r["ends"] for r in rows)
    return {
        "rmse": math.sqrt(sum(r["squares"] for r in rows) / samples),
        "p95": float(BINS[1 + int(np.searchsorted(within, 0.95))]),
        "worst": max(r["worst"] for r in rows),
        "coverage": sum(r["inside"] * r["rows"] for r in rows) / samples,
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
