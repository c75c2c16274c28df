"""A row of a leaderboard, and how the rows of a suite stand: ranks with their uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from cellwise.benchmark.faults import NONE
from cellwise.benchmark.paper_tables import (
    FIGURE,
    RESAMPLES,
    SEED,
    SHARES,
    Difference,
    differences,
    interval_text,
    provenance,
)

AGAINST = "ekf"  # what every estimator is compared with
ENDED = 0.03  # of SOC: gauge vendors count the discharges that end within three points
# What a row keeps of each of its runs.
RUN_FIGURES: dict[str, type] = {
    "log": str, "fault": str, "start_error": float, "dt_s": float, "soc0_true": float,
    "easy": bool, "quick": bool, "settled_rmse": float, "settled_max": float,
    "soc_final_error": float, "convergence_s": float, "coverage_2sigma": float,
    "interval_score": float, "band_width": float, "ns_per_step": float, "state_bytes": int,
    "process_MB": float, "problem": str,
}  # fmt: skip
Runs = Sequence[Mapping[str, Any]]


class Standing(NamedTuple):
    """One estimator among those of a suite, over hard runs unless said; None: not known.

    ``rank`` by ``hard`` (mean settled RMSE, every log with equal weight); ``low`` and ``high`` hold
    95 % of its ranks over resampled logs. ``ended``, ``converged``: shares of runs; ``failed``:
    runs that could not be judged, which leave an estimator without a rank: what fails where it is
    hard must not be the better for it.
    """

    estimator: str
    rank: int | None
    low: int | None
    high: int | None
    hard: float | None
    wrong_start: float | None
    with_a_fault: float | None
    worst: float | None
    ended: float | None
    converged: float | None
    convergence_s: float | None
    against: Difference | None
    failed: int
    easy: float | None
    coverage: float | None
    band: float | None
    interval_score: float | None
    ns_per_row: float | None
    state_bytes: int
    process_MB: float | None


def _points(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.2f}"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"


def _cost(ns: float | None) -> str:
    if ns is None:
        return "-"
    return f"{ns:.0f} ns" if ns < 1e4 else f"{ns / 1e3:.0f} µs"


def _after(seconds: float | None) -> str:
    return "" if seconds is None else f", {seconds / 60.0:.0f} min"


Columns = tuple[tuple[str, Callable[[Standing], str]], ...]
# How a standing reads, figures in points of SOC; then its band and its cost.
COLUMNS: Columns = (
    ("rank [95 %]", lambda s: "-" if s.rank is None else f"{s.rank} [{s.low}, {s.high}]"),
    ("estimator", lambda s: s.estimator),
    ("hard runs", lambda s: _points(s.hard)),
    ("wrong start", lambda s: _points(s.wrong_start)),
    ("with a fault", lambda s: _points(s.with_a_fault)),
    ("worst", lambda s: _points(s.worst)),
    ("ended within 3 points", lambda s: _share(s.ended)),
    ("within 2 points, after", lambda s: _share(s.converged) + _after(s.convergence_s)),
    ("against ekf [95 %]", lambda s: "-" if s.against is None else interval_text(s.against)),
    ("failed", lambda s: str(s.failed)),
    ("easy runs", lambda s: _points(s.easy)),
)
BAND_COLUMNS: Columns = (
    ("estimator", lambda s: s.estimator),
    ("inside 2σ", lambda s: _share(s.coverage)),
    ("band ±", lambda s: _points(None if s.band is None else s.band / 2.0)),
    ("interval score", lambda s: _points(s.interval_score)),
    ("per row", lambda s: _cost(s.ns_per_row)),
    ("state", lambda s: f"{s.state_bytes} B" if s.state_bytes else "-"),
    ("process", lambda s: "-" if s.process_MB is None else f"{s.process_MB:.0f} MB"),
)


def leaderboard(suite: str, suite_sha256: str, rows: Runs, **made_with: Any) -> dict[str, Any]:
    """The runs of every estimator that did all of a frozen suite's, or its quick cut.

    What they amount to is :func:`standings`.
    """
    by_name: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        by_name.setdefault(str(row["estimator"]), []).append(row)
    whole = max((frozenset(map(_run, own)) for own in by_name.values()), key=len)
    quick = frozenset(_run(row) for row in rows if row.get("quick"))
    return {
        "suite": suite,
        "suite_sha256": suite_sha256,
        "made_with": provenance(),
        **made_with,
        "rows": [
            {"estimator": name, "runs": [{k: _plain(r.get(k)) for k in RUN_FIGURES} for r in own]}
            for name, own in by_name.items()
            if (found := set(map(_run, own))) == whole or (quick and found == quick)
        ],
    }


def _run(row: Mapping[str, Any]) -> tuple[Any, ...]:
    return row["log"], row["fault"], row["start_error"], row["dt_s"]


def standings(rows: Mapping[str, Runs], *, quick: bool = False) -> list[Standing]:
    """How estimators stand by their runs, the best first; those that lack runs are left out.

    Ranks are those of the means over logs; their interval is of the same logs, drawn with
    replacement (cluster bootstrap, as :func:`~cellwise.benchmark.paper_tables.differences`).

    Parameters
    ----------
    rows : mapping     runs by estimator, each as :data:`RUN_FIGURES` names its figures
    quick : bool       over the quick cut alone
    """
    taken = {n: [r for r in own if r.get("quick") or not quick] for n, own in rows.items()}
    most = max((frozenset(map(_run, own)) for own in taken.values()), key=len, default=frozenset())
    taken = {n: own for n, own in taken.items() if own and frozenset(map(_run, own)) == most}
    hard = {n: [r for r in own if not r.get("easy")] for n, own in taken.items()}
    judged = [n for n, own in hard.items() if own and not any(r["problem"] for r in taken[n])]
    flat = [{**r, "estimator": n} for n in judged for r in _filled(hard[n])]
    compared = {d.estimator: d for d in differences(flat, against=AGAINST)}
    logs = sorted({str(r["log"]) for own in hard.values() for r in own})
    means = np.array(
        [[np.mean([r[FIGURE] for r in hard[n] if r["log"] == g]) for g in logs] for n in judged]
    ).reshape(len(judged), len(logs))
    places = dict(zip(judged, _ranks(means), strict=True))
    found = [_standing(n, taken[n], hard[n], places.get(n), compared.get(n)) for n in taken]
    return sorted(found, key=lambda s: (s.rank is None, s.rank or 0, s.estimator))


def _ranks(means: np.ndarray[Any, Any]) -> list[tuple[int, int, int]]:
    """Rank and the interval of the rank of every estimator; means of shape (estimators, logs)."""
    if not means.size:
        return []
    rng = np.random.default_rng(SEED)
    logs = means.shape[1]
    drawn = means[:, rng.integers(0, logs, (RESAMPLES, logs))].mean(axis=2)
    order = 1 + np.argsort(np.argsort(drawn, axis=0), axis=0)
    low, high = np.percentile(order, SHARES, axis=1, method="nearest")
    rank = 1 + np.argsort(np.argsort(means.mean(axis=1)))
    return [(int(r), int(a), int(b)) for r, a, b in zip(rank, low, high, strict=True)]


def _standing(
    name: str,
    every: Runs,
    hard: Runs,
    place: tuple[int, int, int] | None,
    against: Difference | None,
) -> Standing:
    rank, low, high = place or (None, None, None)
    times = [r["convergence_s"] for r in hard if r["convergence_s"] is not None]
    times = [t for t in times if np.isfinite(t)]
    ends = [r["soc_final_error"] for r in hard if not r["problem"]]
    memory = [r["process_MB"] for r in every if r.get("process_MB")]
    return Standing(
        name, rank, low, high,
        _by_log(hard),
        _by_log([r for r in hard if r["fault"] == NONE]),
        _by_log([r for r in hard if r["fault"] != NONE]),
        _known(max((r["settled_max"] for r in hard if not r["problem"]), default=None)),
        _known(np.mean(np.abs(ends) <= ENDED)) if ends else None,
        len(times) / len(hard) if hard else None,
        _known(np.median(times)) if times else None,
        against,
        sum(bool(r["problem"]) for r in every),
        _by_log([r for r in every if r.get("easy")]),
        _by_log(hard, "coverage_2sigma"),
        _by_log(hard, "band_width"),
        _by_log(hard, "interval_score"),
        _by_log([r for r in every if r["fault"] == NONE], "ns_per_step"),
        max((int(r.get("state_bytes") or 0) for r in every), default=0),
        _known(max(memory)) if memory else None,
    )  # fmt: skip


def _filled(runs: Runs) -> list[dict[str, Any]]:
    """Runs whose unknown figures are NaN again."""
    return [{k: np.nan if v is None else v for k, v in r.items()} for r in runs]


def _by_log(runs: Runs, figure: str = FIGURE) -> float | None:
    """Mean over logs of the means over their runs; None as :func:`_mean`."""
    logs = {r["log"] for r in runs}
    means = [_mean([r for r in runs if r["log"] == g], figure) for g in logs]
    return (
        None if not means or None in means else float(np.mean([m for m in means if m is not None]))
    )


def _mean(rows: Runs, figure: str = FIGURE) -> float | None:
    """None where a run could not be judged, or has no such figure."""
    if not rows or any(r["problem"] or r[figure] is None for r in rows):
        return None
    return _known(np.mean([float(r[figure]) for r in rows]))


def _known(value: Any) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None


def _plain(value: Any) -> Any:
    """As JSON has it: a figure that is not known is null."""
    if isinstance(value, float):
        return float(f"{value:.6g}") if np.isfinite(value) else None
    return value
