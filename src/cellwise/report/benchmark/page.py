"""The page of a benchmark: accuracy by estimator, log and fault, and its cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cellwise.errors import InputError
from cellwise.report.benchmark.overview import (
    OVERVIEW_COLUMNS,
    coverage_text,
    fault_matrix,
    fault_rows,
    log_matrix,
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
from cellwise.report.benchmark.standings import standings_sections
from cellwise.report.page.markup import (
    EMPTY,
    MOST,
    Markup,
    bullets,
    details,
    paragraph,
    record_table,
    table,
)
from cellwise.report.page.numerals import duration, percent, plural, significant
from cellwise.report.page.picture import FigureFiles
from cellwise.report.page.section import Section, write_page

MEANS = (
    "Settled: after the error has stayed within two points for ten minutes, over the second half "
    "of a log where it never did. Reference: the tester's counter, never what the filter saw. "
    "Inside 2σ: rows whose error the filter's own band holds, 95 % if it is consistent. Mean NIS: "
    "squared innovation over its variance, 1 if noise is as modelled."
)


class BenchmarkTable(NamedTuple):
    """Rows of a benchmark with their columns by name, and SOC errors over time of some rows.

    ``entries`` are the leaderboard's of a frozen suite, ``not_run`` names and reasons.
    """

    name: str
    about: str
    rows: Sequence[Mapping[str, Any]]
    curves: Mapping[int, Mapping[str, Sequence[float]]]
    entries: Sequence[Mapping[str, Any]] = ()
    not_run: Sequence[tuple[str, str]] = ()


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
    faults, starts = fault_matrix(rows), start_matrix(rows)
    best = record_table(overviews(rows), *OVERVIEW_COLUMNS, caption=MEANS)
    blocks = (best, log_picture(log_matrix(rows)))
    sections = [
        *standings_sections(found.entries, found.not_run),
        Section("overview", "Estimators, without a fault", blocks, "Overview"),
        Section("starts", "From a wrong start", (start_picture(rows, starts),), "Starts"),
    ]
    if faults.labels:
        text = coverage_text(rows)
        table_of_faults = table(
            ("fault", *faults.estimators), fault_rows(faults, percent), caption="Mean settled RMSE."
        )
        robust = (fault_picture(faults), table_of_faults, paragraph(text) if text else EMPTY)
        title = "With a fault that the filter does not know of"
        sections.append(Section("faults", title, robust, "Faults"))
    warm = temperature_picture(rows)
    if warm is not None:
        sections.append(Section("temperature", "Over temperature", (warm,), "Temperature"))
    curves = curve_pictures(rows, found.curves)
    if curves:
        sections.append(Section("curves", "SOC error over time", curves, "Curves"))
    sections.append(Section("rows", "Every run", (every_row(rows),), "Rows"))
    return sections


def every_row(rows: Sequence[Mapping[str, Any]]) -> Markup:
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
