"""A benchmark's rows in few numbers: per estimator, per fault, per start."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from cellwise.report.page.numerals import NONE, duration, percent, significant

HEALTHY = "none"
Rows = Sequence[Mapping[str, Any]]


class Overview(NamedTuple):
    """One estimator over runs without a fault; means, NaN where there is no reference.

    ``runs`` that could be judged, ``converged`` of them; ``problems`` that could not.
    """

    estimator: str
    runs: int
    problems: int
    settled: float
    worst: float
    from_start: float
    converged: int
    convergence_s: float
    low_soc: float
    coverage: float
    nis: float
    ns_per_step: float
    state_bytes: int


def good(rows: Rows) -> list[Mapping[str, Any]]:
    """Rows that could be judged."""
    return [row for row in rows if not row["problem"]]


def healthy(rows: Rows) -> list[Mapping[str, Any]]:
    """Rows without a fault that could be judged."""
    return [row for row in good(rows) if row["fault"] == HEALTHY]


def names(rows: Rows, column: str) -> list[str]:
    """Values of a column in the order in which they come."""
    return list(dict.fromkeys(str(row[column]) for row in rows))


def mean_of(rows: Iterable[Mapping[str, Any]], column: str) -> float:
    """Mean over the rows that have the figure, NaN where none has."""
    values = np.array([row[column] for row in rows], dtype=np.float64)
    values = values[np.isfinite(values)]
    return float(values.mean()) if values.size else float("nan")


def overviews(rows: Rows) -> list[Overview]:
    """One line per estimator, from the smallest settled error to the largest."""
    found = [_overview(name, rows) for name in names(rows, "estimator")]
    return sorted(found, key=lambda o: (np.isnan(o.settled), o.settled))


def _overview(name: str, rows: Rows) -> Overview:
    own = [row for row in rows if row["estimator"] == name and row["fault"] == HEALTHY]
    judged = healthy(own)
    settled = np.array([row["settled_rmse"] for row in judged])
    times = np.array([row["convergence_s"] for row in judged])
    reached = times[np.isfinite(times)]
    return Overview(
        estimator=name,
        runs=len(judged),
        problems=len(own) - len(judged),
        settled=mean_of(judged, "settled_rmse"),
        worst=float(np.nanmax(settled)) if np.isfinite(settled).any() else float("nan"),
        from_start=mean_of(judged, "soc_rmse"),
        converged=int(reached.size),
        convergence_s=float(np.median(reached)) if reached.size else float("nan"),
        low_soc=mean_of(judged, "low_soc_rmse"),
        coverage=mean_of(judged, "coverage_2sigma"),
        nis=mean_of(judged, "nis_mean"),
        ns_per_step=mean_of(judged, "ns_per_step"),
        state_bytes=max((int(row["state_bytes"]) for row in judged), default=0),
    )


OVERVIEW_COLUMNS: tuple[tuple[str, Callable[[Overview], str]], ...] = (
    ("estimator", lambda o: o.estimator),
    ("settled RMSE", lambda o: percent(o.settled)),
    ("worst", lambda o: percent(o.worst)),
    ("RMSE from the start", lambda o: percent(o.from_start)),
    ("within 2 points", lambda o: f"{o.converged} of {o.runs}"),
    ("after", lambda o: duration(o.convergence_s)),
    ("last 10 % SOC", lambda o: percent(o.low_soc)),
    ("inside 2σ", lambda o: percent(o.coverage, 1)),
    ("mean NIS", lambda o: significant(o.nis, 2)),
    ("per step", lambda o: step_time(o.ns_per_step)),
    ("state", lambda o: f"{o.state_bytes} B" if o.state_bytes else NONE),
)


def step_time(ns: float) -> str:
    """Nanoseconds, or microseconds from ten of them on."""
    if not np.isfinite(ns):
        return NONE
    return f"{ns:.0f} ns" if ns < 1e4 else f"{ns / 1e3:.0f} µs"


class Matrix(NamedTuple):
    """Mean settled RMSE, shape (estimators, labels); NaN where nothing was run."""

    estimators: list[str]
    labels: list[str]
    values: np.ndarray[Any, np.dtype[np.float64]]


def fault_matrix(rows: Rows) -> Matrix:
    """By fault, each from the one start that faults are run from."""
    faults = [f for f in names(rows, "fault") if f != HEALTHY]
    if not faults:
        return Matrix([], [], np.zeros((0, 0)))
    starts = {(r["log"], r["start_error"]) for r in rows if r["fault"] != HEALTHY}
    chosen = [r for r in good(rows) if (r["log"], r["start_error"]) in starts]
    return _matrix(chosen, [HEALTHY, *faults], lambda row: str(row["fault"]))


def fault_rows(matrix: Matrix, shown: Callable[[float], str]) -> list[tuple[str, ...]]:
    """Rows of a table of faults, an estimator in each column."""
    return [
        (label, *(shown(float(v)) for v in matrix.values[:, k]))
        for k, label in enumerate(matrix.labels)
    ]


def suite_coverage(rows: Rows) -> dict[str, float]:
    """Share of rows inside 2σ by estimator, mean over its every run, with and without a fault.

    Only estimators that ran with faults.
    """
    found: dict[str, float] = {}
    for one in overviews(rows):
        own = [row for row in good(rows) if row["estimator"] == one.estimator]
        share = mean_of(own, "coverage_2sigma")
        if any(row["fault"] != HEALTHY for row in own) and np.isfinite(share):
            found[one.estimator] = share
    return found


def coverage_text(rows: Rows) -> str:
    """The same as text; empty where nothing ran with a fault."""
    shares = [f"{name} {percent(share, 1)}" for name, share in suite_coverage(rows).items()]
    if not shares:
        return ""
    return f"Inside 2σ over every run, with and without a fault: {', '.join(shares)}."


def log_matrix(rows: Rows) -> Matrix:
    """By log, over every start, without a fault."""
    chosen = healthy(rows)
    places = list(dict.fromkeys(log_name(row) for row in chosen))
    return _matrix(chosen, places, log_name)


def start_name(error: float) -> str:
    """A start error in points."""
    return f"{100.0 * error:+.0f} points" if error else "right start"


def log_name(row: Mapping[str, Any]) -> str:
    """Log and cell of a row."""
    return f"{row['log']} ({row['cell']})"


def _matrix(rows: Rows, labels: list[str], label: Callable[[Mapping[str, Any]], str]) -> Matrix:
    estimators = [o.estimator for o in overviews(rows)]
    cells: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        cells.setdefault((str(row["estimator"]), label(row)), []).append(row)
    values = np.array(
        [[mean_of(cells.get((e, name), []), "settled_rmse") for name in labels] for e in estimators]
    ).reshape(len(estimators), len(labels))
    return Matrix(estimators, labels, values)
