"""The page of a benchmark: accuracy by estimator, log and fault, and its cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cellwise.errors import InputError
from cellwise.report.benchmark.overview import (
    OVERVIEW_HEAD,
    Matrix,
    coverage_text,
    fault_matrix,
    log_matrix,
    overview_row,
    overviews,
    start_matrix,
    step_time,
)
from cellwise.report.benchmark.pictures import (
    curve_pictures,
    fault_picture,
    log_picture,
    start_picture,
    temperature_picture,
)
from cellwise.report.page.markup import EMPTY, Markup, bullets, details, paragraph, table
from cellwise.report.page.numerals import duration, percent, plural, significant
from cellwise.report.page.picture import FigureFiles
from cellwise.report.page.section import Section, write_page

MOST_ROWS = 2000
MEANS = (
    "Settled: after the error has stayed within two points for ten minutes, over the second half "
    "of a log where it never did. Reference: the tester's counter, never what the filter saw. "
    "Inside 2σ: rows whose error the filter's own band holds, 95 % if it is consistent. Mean NIS: "
    "squared innovation over its variance, 1 if noise is as modelled."
)


class BenchmarkTable(NamedTuple):
    """Rows of a benchmark with their columns by name, and SOC errors over time of some rows."""

    name: str
    about: str
    rows: Sequence[Mapping[str, Any]]
    curves: Mapping[int, Mapping[str, Sequence[float]]]


def benchmark_page(
    found: BenchmarkTable, path: str | Path, *, figures: str | Path | FigureFiles | None = None
) -> Path:
    """Write the page of a benchmark.

    Parameters
    ----------
    found : BenchmarkTable
    path : str or Path            of the HTML file; it appears whole or not at all
    figures : folder or FigureFiles   for the same pictures as PNG and SVG files

    Raises
    ------
    InputError        no row; matplotlib is missing; the path cannot be written
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
    """One line: the best estimator and the best baseline."""
    ranked = [o for o in overviews(found.rows) if o.runs and o.settled == o.settled]
    if not ranked:
        return f"{found.name}: nothing could be judged"
    best, last = ranked[0], ranked[-1]
    text = (
        f"{found.name}: {best.estimator} settles to {percent(best.settled)} of SOC "
        f"(worst {percent(best.worst)}) in {plural(best.runs, 'run')}"
    )
    if last is not best:
        text += f", {last.estimator} to {percent(last.settled)}"
    return text


def benchmark_sections(found: BenchmarkTable) -> list[Section]:
    """The parts of the page."""
    rows = found.rows
    faults, logs, starts = fault_matrix(rows), log_matrix(rows), start_matrix(rows)
    sections = [
        Section(
            "overview",
            "Estimators, without a fault",
            (
                table(OVERVIEW_HEAD, [overview_row(o) for o in overviews(rows)], caption=MEANS),
                log_picture(logs),
            ),
            "Overview",
        ),
        Section("starts", "From a wrong start", (start_picture(rows, starts),), "Starts"),
    ]
    if faults.labels:
        sections.append(
            Section(
                "faults",
                "With a fault that the filter does not know of",
                (fault_picture(faults), matrix_table(faults), _coverage(rows)),
                "Faults",
            )
        )
    warm = temperature_picture(rows)
    if warm is not None:
        sections.append(Section("temperature", "Over temperature", (warm,), "Temperature"))
    curves = curve_pictures(rows, found.curves)
    if curves:
        sections.append(Section("curves", "SOC error over time", curves, "Curves"))
    sections.append(Section("rows", "Every run", (every_row(rows),), "Rows"))
    return sections


def matrix_table(matrix: Matrix) -> Markup:
    """Mean settled RMSE by fault, a row per fault."""
    body = [
        (label, *(percent(float(v)) for v in matrix.values[:, k]))
        for k, label in enumerate(matrix.labels)
    ]
    return table(("fault", *matrix.estimators), body, caption="Mean settled RMSE.")


def _coverage(rows: Sequence[Mapping[str, Any]]) -> Markup:
    text = coverage_text(rows)
    return Markup(paragraph(text)) if text else EMPTY


def every_row(rows: Sequence[Mapping[str, Any]]) -> Markup:
    """All rows behind a click, the first ones where there are very many."""
    shown = [
        (
            row["cell"],
            row["log"],
            row["estimator"],
            row["fault"],
            f"{100 * row['start_error']:+.0f}",
            percent(row["settled_rmse"]),
            percent(row["settled_max"]),
            percent(row["soc_rmse"]),
            duration(row["convergence_s"]),
            percent(row["low_soc_rmse"]),
            percent(row["coverage_2sigma"], 1),
            significant(row["nis_mean"], 2),
            step_time(row["ns_per_step"]),
            row["problem"],
        )
        for row in rows[:MOST_ROWS]
    ]
    head = (
        "cell", "log", "estimator", "fault", "start", "settled RMSE", "settled max", "RMSE",
        "within 2 points after", "last 10 % SOC", "inside 2σ", "NIS", "per step", "problem",
    )  # fmt: skip
    more = f", the first {MOST_ROWS} here, all in the data block" if len(rows) > MOST_ROWS else ""
    inside = table(head, shown, text_columns=(0, 1, 2, 3, 13))
    return details(f"{plural(len(rows), 'run')}{more}", inside)


def problems(rows: Sequence[Mapping[str, Any]]) -> Markup:
    """What could not be judged, and why."""
    bad = [row for row in rows if row["problem"]]
    if not bad:
        return EMPTY
    text = dict.fromkeys(f"{row['estimator']}: {row['problem']}" for row in bad)
    return Markup(
        paragraph(f"{plural(len(bad), 'run')} of {len(rows)} not judged:")
        + bullets(list(text)[:8], "notices")
    )
