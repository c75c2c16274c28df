"""How estimators stand by their runs: ranks with their uncertainty, and the tables that say so."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from cellwise.benchmark.faults import NONE
from cellwise.typing import FloatArray

AGAINST = "ekf"  # what every estimator is compared with
ENDED = 0.03  # of SOC: gauge vendors count the discharges that end within three points
SEED, RESAMPLES = 0, 10_000  # of logs: the same table from the same rows
SHARES = (2.5, 97.5)
FEWEST_LOGS = 3  # drawn with replacement, fewer say nothing of other logs
FIGURE = "settled_rmse"
Runs = Sequence[Mapping[str, Any]]


class Standing(NamedTuple):
    """One estimator among those of a suite, over hard runs unless said; None: not known.

    ``rank`` by ``hard`` (mean settled RMSE, every log with equal weight); ``low`` and ``high`` hold
    95 % of its ranks over resampled logs (None of fewer than three), ``against`` is its mean less
    that of `AGAINST` and the ends of the interval of this difference (None of fewer than three
    logs). ``ended``, ``converged``: shares of runs; ``failed``: runs that could not be judged,
    which leave an estimator without a rank: what fails where it is hard must not be the better for
    it.
    """

    estimator: str
    runs: int
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
    against: tuple[float, float | None, float | None] | None
    failed: int
    easy: float | None
    coverage: float | None
    band: float | None
    interval_score: float | None
    nis: float | None
    ns_per_row: float | None
    state_bytes: int
    process_MB: float | None


class Table(NamedTuple):
    """A table as text; columns hold numbers but for ``text``."""

    head: list[str]
    rows: list[list[str]]
    text: tuple[int, ...] = (0,)


def _points(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.2f}"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"


def _rank(s: Standing) -> str:
    if s.rank is None or s.low is None:
        return "-" if s.rank is None else f"{s.rank} (too few logs for an interval)"
    return f"{s.rank} [{s.low}, {s.high}]"


def _after(s: Standing) -> str:
    late = "" if s.convergence_s is None else f", {s.convergence_s / 60.0:.0f} min"
    return _share(s.converged) + late


def _against(s: Standing) -> str:
    if s.against is None:
        return "-"
    mean, low, high = s.against
    ends = "" if low is None or high is None else f" [{100 * low:+.2f}, {100 * high:+.2f}]"
    return f"{100 * mean:+.2f}{ends}"


def step_time(ns: float | None) -> str:
    """Nanoseconds, or microseconds from ten of them on."""
    if ns is None or not np.isfinite(ns):
        return "-"
    return f"{ns:.0f} ns" if ns < 1e4 else f"{ns / 1e3:.0f} µs"


Columns = dict[str, Callable[[Standing], str]]
# How a standing reads, figures in points of SOC; then its band and its cost.
COLUMNS: Columns = {
    "rank [95 %]": _rank,
    "estimator": lambda s: s.estimator,
    "interval score": lambda s: _points(s.interval_score),
    "inside 2σ": lambda s: _share(s.coverage),
    "hard runs": lambda s: _points(s.hard),
    "wrong start": lambda s: _points(s.wrong_start),
    "with a fault": lambda s: _points(s.with_a_fault),
    "worst": lambda s: _points(s.worst),
    "ended within 3 points": lambda s: _share(s.ended),
    "within 2 points, after": _after,
    f"against {AGAINST} [95 %]": _against,
    "failed": lambda s: str(s.failed),
    "easy runs": lambda s: _points(s.easy),
}
BAND_COLUMNS: Columns = {
    "estimator": lambda s: s.estimator,
    "band ±": lambda s: _points(None if s.band is None else s.band / 2.0),
    "per row": lambda s: step_time(s.ns_per_row),
    "state": lambda s: f"{s.state_bytes} B" if s.state_bytes else "-",
    "process": lambda s: "-" if s.process_MB is None else f"{s.process_MB:.0f} MB",
}
NIS: Columns = {"mean NIS": lambda s: "-" if s.nis is None else f"{s.nis:.2g}"}
RUNS: Columns = {"runs": lambda s: str(s.runs)}  # of one's own suite: some lack runs
PAPER = ("estimator", "runs", "hard runs", "worst", "easy runs", f"against {AGAINST} [95 %]")


def table_of(found: Sequence[Standing], columns: Columns, text: tuple[int, ...] = (0,)) -> Table:
    """A row for each standing."""
    return Table(list(columns), [[read(s) for read in columns.values()] for s in found], text)


def suite_tables(found: Sequence[Standing]) -> tuple[Table, Table]:
    """Of one's own run: how estimators stand, and their bands and costs."""
    return table_of(found, COLUMNS | RUNS, (1,)), table_of(found, BAND_COLUMNS | NIS)


def choice_of(found: Sequence[Standing]) -> str:
    """Which estimator to choose, and why: by its band first, then by its error.

    The interval score is least for a band that is as wide as it has to be; an estimator without a
    band leaves its user to guess how far it may be off.
    """
    ranked = [s for s in found if s.rank is not None]
    scored = sorted((s.interval_score, s.estimator, s) for s in ranked if s.interval_score)
    if not scored:
        return "No estimator states a band: nothing to choose by."
    best = scored[0][2]
    error = best.easy if best.hard is None else best.hard
    text = (
        f"To choose by: {best.estimator} has the least interval score, "
        f"{_points(best.interval_score)} points, with {_share(best.coverage)} of the rows inside "
        f"its band and {_points(error)} points of error"
    )
    if len(scored) > 1:
        text += f"; the next is {scored[1][1]}, {_points(scored[1][0])}"
    judged = [(s.hard, s.estimator, s) for s in ranked if s.hard is not None]
    least = min(judged)[2] if judged else best
    if least is not best:
        text += f"; the least error has {least.estimator}, {_points(least.hard)}, with " + (
            f"{_share(least.coverage)} inside" if least.coverage is not None else "no band"
        )
    bare = [s.estimator for s in ranked if s.interval_score is None]
    return text + (f". No band: {', '.join(bare)}." if bare else ".")


def run_of(row: Mapping[str, Any]) -> tuple[Any, ...]:
    """What two estimators have in common that did the same run."""
    return row["log"], row["fault"], row["start_error"], row["dt_s"]


def by_estimator(rows: Runs) -> dict[str, list[Mapping[str, Any]]]:
    """The runs of each estimator."""
    found: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault(str(row["estimator"]), []).append(row)
    return found


def standings(
    rows: Mapping[str, Runs], *, quick: bool = False, fewer: bool = False
) -> list[Standing]:
    """How estimators stand by their runs, the best first.

    Ranks are those of the means over logs. Runs of one log are not independent: the intervals are
    of logs drawn with replacement, the same for all estimators (cluster bootstrap: Field and Welsh
    2007, doi:10.1111/j.1467-9868.2007.00593.x).

    Parameters
    ----------
    rows : mapping     runs by estimator; a figure that is not known is None or NaN
    quick : bool       over the quick cut alone
    fewer : bool       those that lack runs are there too, without a rank
    """
    taken = {n: [r for r in own if r.get("quick") or not quick] for n, own in rows.items()}
    most = max((frozenset(map(run_of, own)) for own in taken.values()), key=len, default=None)
    whole = {n for n, own in taken.items() if own and frozenset(map(run_of, own)) == most}
    taken = {n: own for n, own in taken.items() if own and (fewer or n in whole)}
    hard = {n: [r for r in own if not r.get("easy")] for n, own in taken.items()}
    if not any(hard[n] for n in whole):  # nothing hard was asked: all is of the easy runs
        hard = taken
    judged = [n for n in taken if n in whole and not any(r["problem"] for r in taken[n])]
    logs = sorted({str(r["log"]) for n in judged for r in hard[n]})
    means = np.array(
        [[np.mean([r[FIGURE] for r in hard[n] if r["log"] == g]) for g in logs] for n in judged]
    ).reshape(len(judged), len(logs))
    places = _places(judged, means) if means.size else {}
    found = [_standing(n, taken[n], hard[n], *places.get(n, (None,) * 4)) for n in taken]
    return sorted(found, key=lambda s: (s.rank is None, s.rank or 0, s.estimator))


def _places(names: Sequence[str], means: FloatArray) -> dict[str, tuple[Any, ...]]:
    """Rank, its interval and the difference to `AGAINST`; means of shape (estimators, logs)."""
    logs = means.shape[1]
    draws = np.random.default_rng(SEED).integers(0, logs, (RESAMPLES, logs))
    mean, drawn = means.mean(axis=1), means[:, draws].mean(axis=2)
    order = 1 + np.argsort(np.argsort(drawn, axis=0), axis=0)
    low, high = np.percentile(order, SHARES, axis=1, method="nearest").astype(int)
    rank = 1 + np.argsort(np.argsort(mean))
    found = {}
    for k, name in enumerate(names):
        against = None
        if AGAINST in names and name != AGAINST:
            other = names.index(AGAINST)
            ends = (
                np.percentile(drawn[k] - drawn[other], SHARES)
                if logs >= FEWEST_LOGS
                else (None, None)
            )
            against = (float(mean[k] - mean[other]), *ends)
        of_ranks = (int(low[k]), int(high[k])) if logs >= FEWEST_LOGS else (None, None)
        found[name] = (int(rank[k]), *of_ranks, against)
    return found


def _standing(
    name: str,
    every: Runs,
    hard: Runs,
    rank: int | None,
    low: int | None,
    high: int | None,
    against: tuple[float, float | None, float | None] | None,
) -> Standing:
    good = [r for r in hard if not r["problem"]]
    times = [t for r in hard if (t := _known(r["convergence_s"])) is not None]
    ends = [r["soc_final_error"] for r in good]
    memory = [m for r in every if (m := _known(r.get("process_MB")))]
    return Standing(
        name, len(every), rank, low, high,
        mean_of([r for r in hard if not r.get("easy")]),
        mean_of([r for r in hard if r["fault"] == NONE]),
        mean_of([r for r in hard if r["fault"] != NONE]),
        _known(max((r["settled_max"] for r in good), default=None)),
        _known(np.mean(np.abs(ends) <= ENDED)) if ends else None,
        len(times) / len(hard) if hard else None,
        _known(np.median(times)) if times else None,
        against,
        sum(bool(r["problem"]) for r in every),
        mean_of([r for r in every if r.get("easy")]),
        mean_of(hard, "coverage_2sigma"),
        mean_of(hard, "band_width"),
        mean_of(hard, "interval_score"),
        mean_of(hard, "nis_mean"),
        mean_of([r for r in every if r["fault"] == NONE], "ns_per_step"),
        max((int(r.get("state_bytes") or 0) for r in every), default=0),
        max(memory, default=None),
    )  # fmt: skip


def mean_of(runs: Runs, figure: str = FIGURE) -> float | None:
    """Mean over logs of the means over their runs.

    None where a run could not be judged, or has no such figure.
    """
    logs: dict[str, list[float]] = {}
    for run in runs:
        value = _known(run.get(figure))
        if run["problem"] or value is None:
            return None
        logs.setdefault(run["log"], []).append(value)
    return float(np.mean([np.mean(own) for own in logs.values()])) if logs else None


def _known(value: Any) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None


def markdown(table: Table) -> list[str]:
    """Lines of Markdown, with one that is empty behind."""
    sides = ["---" if k in table.text else "---:" for k in range(len(table.head))]
    rows = [table.head, *table.rows]
    head, *body = ("| " + " | ".join(cells) + " |" for cells in rows)
    return [head, "|" + "|".join(sides) + "|", *body, ""]


def latex(found: Sequence[Standing], about: str) -> str:
    """A table for a paper (booktabs), with what it was made with."""
    table = table_of(found, {name: (COLUMNS | RUNS)[name] for name in PAPER})
    marks = str.maketrans({mark: rf"\{mark}" for mark in "&%_#${}"})
    head, *rows = (
        " & ".join(cell.translate(marks) for cell in cells) + r" \\"
        for cells in (table.head, *table.rows)
    )
    lines = [
        f"% {about}",
        "% Settled SOC RMSE in points, mean over logs. Differences: paired by log, 95 % of "
        f"{RESAMPLES} resamples of logs, seed {SEED}.",
        rf"\begin{{tabular}}{{l{'r' * (len(PAPER) - 1)}}}",
        r"\toprule", head, r"\midrule", *rows, r"\bottomrule", r"\end{tabular}", "",
    ]  # fmt: skip
    return "\n".join(lines)
