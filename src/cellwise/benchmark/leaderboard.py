"""Rows of a leaderboard: every estimator of a frozen suite in few figures, with what made them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cellwise.benchmark.faults import NONE
from cellwise.benchmark.paper_tables import (
    FIGURE,
    Difference,
    differences,
    interval_text,
    provenance,
)

AGAINST = "ekf"  # what every estimator is compared with
FULL = 0.95  # a log that begins below this SOC begins in the middle
HEAD = (
    "estimator", "all runs", "right start", "wrong start", "from the middle", "with a fault",
    "largest", "inside 2σ", "against ekf [95 %]", "ns per step", "made with",
)  # fmt: skip


def leaderboard(
    suite: str, suite_sha256: str, rows: Sequence[Mapping[str, Any]], **made_with: Any
) -> dict[str, Any]:
    """What a frozen suite's run says of every estimator that did all of its runs.

    An estimator that could not be judged in one run has no figure over all runs: what fails where
    it is hard must not be the better for it.
    """
    by_name: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        by_name.setdefault(str(row["estimator"]), []).append(row)
    most = max(len(own) for own in by_name.values())
    compared = {d.estimator: d for d in differences(rows, against=AGAINST)}
    return {
        "suite": suite,
        "suite_sha256": suite_sha256,
        "made_with": provenance(),
        **made_with,
        "rows": [
            _row(name, own, compared.get(name)) for name, own in by_name.items() if len(own) == most
        ],
    }


def _row(name: str, own: Sequence[Mapping[str, Any]], against: Difference | None) -> dict[str, Any]:
    healthy = [r for r in own if r["fault"] == NONE]
    full = [r for r in healthy if r["soc0_true"] >= FULL]
    return {
        "estimator": name,
        "runs": len(own),
        "problems": sum(bool(r["problem"]) for r in own),
        "all_runs": _mean(own),
        "right_start": _mean([r for r in full if not r["start_error"]]),
        "wrong_start": _mean([r for r in full if r["start_error"]]),
        "from_the_middle": _mean([r for r in healthy if r["soc0_true"] < FULL]),
        "with_a_fault": _mean([r for r in own if r["fault"] != NONE]),
        "largest": _known(np.max([float(r[FIGURE]) for r in own])),
        "coverage_2sigma": _mean(own, "coverage_2sigma"),
        "ns_per_step": _mean(healthy, "ns_per_step"),
        "against": None if against is None else against._asdict(),
    }


def table_row(found: Mapping[str, Any], row: Mapping[str, Any]) -> tuple[str, ...]:
    """One estimator for people, as :data:`HEAD` names the columns; figures in points of SOC."""
    names = ("all_runs", "right_start", "wrong_start", "from_the_middle", "with_a_fault", "largest")
    against = row["against"]
    compared = "-"
    if against is not None:
        ends = {end: math.nan if against[end] is None else against[end] for end in ("low", "high")}
        compared = interval_text(Difference(**{**against, **ends}))
    cost = row["ns_per_step"]
    return (
        str(row["estimator"]),
        *("-" if row[n] is None else f"{100 * row[n]:.2f}" for n in names),
        "-" if row["coverage_2sigma"] is None else f"{100 * row['coverage_2sigma']:.0f} %",
        compared,
        "-" if cost is None else f"{cost:.0f}",
        str(found["made_with"]).partition(",")[0],
    )


def _mean(rows: Sequence[Mapping[str, Any]], figure: str = FIGURE) -> float | None:
    """None where a run could not be judged, or has no such figure."""
    if not rows or any(r["problem"] for r in rows):
        return None
    return _known(np.mean([float(r[figure]) for r in rows]))


def _known(value: Any) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None
