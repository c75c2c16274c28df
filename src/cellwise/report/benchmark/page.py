"""The page of a benchmark: accuracy by estimator, log, fault and start, and its cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.report.benchmark.overview import (
    OVERVIEW_COLUMNS,
    Matrix,
    coverage_text,
    fault_matrix,
    fault_rows,
    healthy,
    log_matrix,
    mean_of,
    overviews,
    start_name,
    step_time,
)
from cellwise.report.page.markup import (
    EMPTY,
    MOST,
    Markup,
    bullets,
    details,
    escape,
    paragraph,
    record_table,
    table,
)
from cellwise.report.page.numerals import NONE, duration, listed, percent, plural, significant
from cellwise.report.page.picture import FigureFiles
from cellwise.report.page.section import Section, write_page

Rows = Sequence[Mapping[str, Any]]
TINTS = (0.01, 0.02, 0.05)  # of SOC: good, fair, poor; beyond is bad
FAULTS = (
    "Mean settled RMSE, every fault from the same start; green up to 1 %, red beyond 5 %. The "
    "fault is in what the filter sees, never in the reference."
)
MEANS = (
    "Settled: after the error has stayed within two points for ten minutes, over the second half "
    "of a log where it never did. Reference: the tester's counter, never what the filter saw. "
    "Inside 2σ: rows whose error the filter's own band holds, 95 % if it is consistent. Mean NIS: "
    "squared innovation over its variance, 1 if noise is as modelled."
)
STANDINGS = (
    "Settled SOC RMSE in points, mean over logs of the mean over hard runs: from the middle, under "
    "load, 30 points wrong, or with a fault; easy runs (the right start and nothing wrong) have a "
    "column of their own and no part in a rank. In brackets what holds 95 % over resampled logs. "
    "Ended within 3 points: share of runs whose last error is. Interval score: width of the "
    "band of two deviations and 40 times what lies outside, smaller is better."
)


class BenchmarkTable(NamedTuple):
    """Rows of a benchmark with their columns by name.

    ``parts`` are those of the leaderboard of a frozen suite, ``not_run`` names and reasons.
    """

    name: str
    about: str
    rows: Rows
    parts: Sequence[Mapping[str, Any]] = ()
    not_run: Sequence[tuple[str, str]] = ()


def benchmark_page(
    found: BenchmarkTable, path: str | Path, *, figures: str | Path | FigureFiles | None = None
) -> Path:
    """Write the page of a benchmark.

    Parameters
    ----------
    found : BenchmarkTable
    path, figures : as of `write_page`, whose errors it raises
    """
    if not found.rows:
        raise InputError("no row for the page", "at least one", "Run a suite first.")
    return write_page(
        path,
        benchmark_finding(found),
        f"Benchmark '{found.name}', by cellwise",
        benchmark_sections(found),
        {"suite": found.name, "rows": [dict(row) for row in found.rows]},
        lead=Markup(paragraph(found.about) + problems(found.rows)),
        figures=figures,
    )


def benchmark_finding(found: BenchmarkTable) -> str:
    """One line: who is first where a leaderboard has ranks, else the best and the last."""
    if found.parts and (first := found.parts[0]["first"]):
        part = found.parts[0]
        top = f"{part['names'][0]} is first of {len(part['names'])}, {100 * part['hard'][0]:.2f}"
        rest = f"; {listed(first[1:])} may be as good" if first[1:] else ""
        return f"{found.name}: {top} points of SOC on hard runs{rest}"
    ranked = [o for o in overviews(found.rows) if o.runs and o.settled == o.settled]
    if not ranked:
        return f"{found.name}: nothing could be judged"
    best, last = ranked[0], ranked[-1]
    text = f"{found.name}: {best.estimator} settles to {percent(best.settled)} of SOC"
    if last is not best:
        text += f", {last.estimator} to {percent(last.settled)}"
    robust = most_robust(fault_matrix(found.rows))
    if robust is not None:
        text += f"; with a fault {robust[0]} is best, {percent(robust[1])} at most"
    return text


def most_robust(matrix: Matrix) -> tuple[str, float] | None:
    """The estimator whose settled RMSE under its worst fault is the smallest, and that error."""
    known = [k for k, own in enumerate(matrix.values) if own.size > 1 and np.isfinite(own).all()]
    if not known:
        return None
    best = min(known, key=lambda k: float(np.max(matrix.values[k])))
    return matrix.estimators[best], float(np.max(matrix.values[best]))


def benchmark_sections(found: BenchmarkTable) -> list[Section]:
    """The parts of the page."""
    rows, logs, faults = found.rows, log_matrix(found.rows), fault_matrix(found.rows)
    by_log = table(
        ("log", *logs.estimators),
        fault_rows(logs, percent),
        caption="Settled RMSE of each log, mean over its starts, without a fault.",
        sortable=True,
    )
    best = record_table(overviews(rows), *OVERVIEW_COLUMNS, caption=MEANS)
    sections = [
        *standings_sections(found.parts, found.not_run),
        Section("overview", "Estimators, without a fault", (best, by_log), "Overview"),
    ]
    if len({row["start_error"] for row in healthy(rows)}) > 1:
        sections.append(Section("starts", "From a wrong start", (starts_table(rows),), "Starts"))
    if faults.labels:
        title = "With a fault that the filter does not know of"
        said = paragraph(coverage_text(rows)) if coverage_text(rows) else EMPTY
        sections.append(Section("faults", title, (fault_table(faults), said), "Faults"))
    sections.append(Section("rows", "Every run", (every_row(rows),), "Rows"))
    return sections


def fault_table(matrix: Matrix) -> Markup:
    """Numbers on tinted fields, faults downwards, estimators across."""

    def tinted(value: float) -> Markup:
        tint = 1 + sum(value > limit for limit in TINTS)
        shown = escape(percent(value))
        return Markup(f'<span class="tint-{tint}">{shown}</span>') if value == value else shown

    head = ("fault", *matrix.estimators)
    return table(head, fault_rows(matrix, tinted), caption=FAULTS, sortable=True)


def starts_table(rows: Rows) -> Markup:
    """From each start: how long until within two points, and the settled error."""
    chosen = healthy(rows)

    def shown(error: float, name: str) -> str:
        own = [r for r in chosen if r["estimator"] == name and r["start_error"] == error]
        times = np.array([r["convergence_s"] for r in own], dtype=np.float64)
        reached = times[np.isfinite(times)]
        if not own:
            return NONE
        after = duration(float(np.median(reached))) if reached.size else "never"
        part = f" in {reached.size} of {times.size}" if 0 < reached.size < times.size else ""
        return f"{after}{part}, {percent(mean_of(own, 'settled_rmse'))}"

    return record_table(
        sorted({float(row["start_error"]) for row in chosen}),
        ("start", start_name),
        *(
            (o.estimator, lambda error, name=o.estimator: shown(error, name))
            for o in overviews(rows)
        ),
        caption="Median time until the error stays within two points for ten minutes, over the "
        "runs that get there; then the settled RMSE.",
    )


def every_row(rows: Rows) -> Markup:
    """All rows behind a click, the first ones where there are very many."""
    more = f", the first {MOST.runs} here, all in the data block" if len(rows) > MOST.runs else ""
    figures = record_table(
        rows[: MOST.runs],
        ("cell", lambda row: row["cell"]),
        ("log", lambda row: row["log"]),
        ("estimator", lambda row: row["estimator"]),
        ("fault", lambda row: row["fault"]),
        ("start", lambda row: f"{100 * row['start_error']:+.0f}"),
        ("settled RMSE", lambda row: percent(row["settled_rmse"])),
        ("settled max", lambda row: percent(row["settled_max"])),
        ("RMSE", lambda row: percent(row["soc_rmse"])),
        ("within 2 points after", lambda row: duration(row["convergence_s"])),
        ("last 10 % SOC", lambda row: percent(row["low_soc_rmse"])),
        ("inside 2σ", lambda row: percent(row["coverage_2sigma"], 1)),
        ("NIS", lambda row: significant(row["nis_mean"], 2)),
        ("per step", lambda row: step_time(row["ns_per_step"])),
        ("problem", lambda row: row["problem"]),
        text_columns=(0, 1, 2, 3, 13),
    )
    return details(f"{plural(len(rows), 'run')}{more}", figures)


def problems(rows: Rows) -> Markup:
    """What could not be judged, and why."""
    bad = [row for row in rows if row["problem"]]
    if not bad:
        return EMPTY
    text = dict.fromkeys(f"{row['estimator']}: {row['problem']}" for row in bad)
    return Markup(
        paragraph(f"{plural(len(bad), 'run')} of {len(rows)} not judged:")
        + bullets(list(text)[:8], "notices")
    )


def standings_sections(
    parts: Sequence[Mapping[str, Any]], not_run: Sequence[tuple[str, str]] = ()
) -> list[Section]:
    """A section for each part of a leaderboard, as `cellwise.benchmark.leaderboard` makes them."""
    said = bullets([f"{name}: {why}" for name, why in not_run], "notices")
    sections = []
    for k, part in enumerate(parts):
        blocks = (
            table(part["head"], part["cells"], caption=STANDINGS, text_columns=(1,)),
            table(part["band_head"], part["bands"], text_columns=(0, 7, 8)),
            Markup(paragraph("Not run:") + said) if said and k == 0 else EMPTY,
        )
        sections.append(Section(f"standings-{k}", part["title"], blocks, part["title"]))
    return sections


def standings_page(suite: str, parts: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """The leaderboard alone, as a page."""
    title = f"Leaderboard '{suite}', by cellwise"
    return write_page(path, title, title, standings_sections(parts), {"suite": suite})
