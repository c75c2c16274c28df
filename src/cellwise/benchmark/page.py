"""The page of a benchmark: who stands where, by log, start and fault, and every run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellwise.benchmark.faults import NONE
from cellwise.benchmark.leaderboard import Standings
from cellwise.benchmark.package_rows import NotRun
from cellwise.benchmark.standings import (
    Standing,
    Table,
    by_estimator,
    choice_of,
    standings,
    suite_tables,
)
from cellwise.benchmark.suite import Suite
from cellwise.errors import InputError
from cellwise.report.page import style
from cellwise.report.page.markup import (
    EMPTY,
    Markup,
    bullets,
    escape,
    paragraph,
    table,
)
from cellwise.report.page.numerals import listed, percent, plural
from cellwise.report.page.picture import Figures, pictured
from cellwise.report.page.section import Blocks, Section, write_page

Row = Mapping[str, Any]
Rows = Sequence[Row]
TINTS = (0.01, 0.02, 0.05)  # of SOC: good, fair, poor; beyond is bad
STANDINGS = (
    "Settled SOC RMSE in points, mean over logs of the mean over hard runs: from the middle, under "
    "load, 30 points wrong, or with a fault; easy runs (the right start and nothing wrong) have a "
    "column of their own and no part in a rank. Settled: after the error has stayed within two "
    "points for ten minutes, over the second half of a log where it never did. In brackets what "
    "holds 95 % over resampled logs; an estimator that lacks runs has no rank. Ended within 3 "
    "points: share of runs whose last error is. Interval score: width of the band and 40 times "
    "what lies outside, smaller is better. Inside 2σ: rows whose error the filter's own band "
    "holds, 95 % if it is consistent. The truth is the tester's counter, never what the "
    "filter saw."
)
BANDS = "Mean NIS: squared innovation over its variance, 1 if noise is as modelled."
ROWS = (
    "Every run with all its figures stands in results.csv and results.parquet beside this page, "
    "and in the block for machines."
)
TABLES = (STANDINGS, BANDS)


def own_part(rows: Rows) -> Standings:
    """The standings of the rows as they are."""
    found = standings(by_estimator(rows), fewer=True)
    title = f"{plural(len(found), 'estimator')}, {plural(len(rows), 'run')}"
    return Standings(title, found, suite_tables(found))


class Division(NamedTuple):
    """A figure of every estimator by what the rows are divided by."""

    key: str
    title: str
    caption: str
    rows: Rows
    of: Callable[[Row], str]
    figure: str = "settled_rmse"


def divisions(rows: Rows) -> list[Division]:
    """By log, start and fault; those of which there is one alone are left out."""
    judged = [row for row in rows if not row["problem"]]
    healthy = [row for row in judged if row["fault"] == NONE]
    starts = {(r["log"], r["start_error"]) for r in judged if r["fault"] != NONE}
    same = [r for r in judged if (r["log"], r["start_error"]) in starts]
    found = [
        Division("logs", "By log", "Without a fault, mean over its starts.", healthy, log_name),
        Division("starts", "By start", "Without a fault, mean over logs.", healthy, start_name),
        Division("faults", "By fault", FAULTS, same, lambda row: str(row["fault"])),
        Division(
            "inside", "Rows inside 2σ by fault", "", same, lambda row: str(row["fault"]),
            "coverage_2sigma",
        ),
    ]  # fmt: skip
    return [d for d in found if d.key == "logs" or len(set(map(d.of, d.rows))) > 1]


FAULTS = (
    "Every fault from the same start. It is in what the filter sees, never in the reference, and "
    "no filter knows of it."
)


def division_table(division: Division, shown: Callable[[float], str] = percent) -> Table:
    """Means of the figure, an estimator in each column; NaN where nothing was run."""
    names = list(by_estimator(division.rows))
    cells: dict[str, dict[str, list[float]]] = {}
    for row in division.rows:
        own = cells.setdefault(division.of(row), {}).setdefault(str(row["estimator"]), [])
        own += [row[division.figure]] * bool(np.isfinite(row[division.figure]))
    rows = [
        [label, *(shown(float(np.mean(own[n])) if own.get(n) else math.nan) for n in names)]
        for label, own in cells.items()
    ]
    return Table(["", *names], rows)


def log_name(row: Row) -> str:
    """Log and cell of a row."""
    return f"{row['log']} ({row['cell']})"


def start_name(row: Row) -> str:
    """A start error in points."""
    error = row["start_error"]
    return f"{100.0 * error:+.0f} points".replace("-", "−") if error else "right start"


def benchmark_page(
    suite: Suite,
    rows: Rows,
    path: str | Path,
    parts: Sequence[Standings] = (),
    *,
    figures: Figures = None,
) -> Path:
    """Write the page of a benchmark.

    Parameters
    ----------
    suite : Suite
    rows : of mapping             its runs, with the columns by name
    parts : of Part               of a frozen suite's leaderboard; none: the rows' own standings
    path, figures : as of `write_page`, whose errors it raises
    """
    if not rows:
        raise InputError("no row for the page", "at least one", "Run a suite first.")
    parts = parts or (own_part(rows),)
    sections = standings_sections(parts, suite.not_run)
    for one in divisions(rows):
        division = division_table(one, percent if one.key == "inside" else tinted)
        text = table(*division[:2], caption=one.caption, sortable=True)
        sections.append(Section(one.key, one.title, (text,)))
    sections.append(Section("rows", "Every run", (paragraph(ROWS),)))
    return write_page(
        path,
        benchmark_finding(suite.name, parts[0]),
        f"Benchmark '{suite.name}', by cellwise",
        sections,
        {"suite": suite.name, "rows": [dict(row) for row in rows]},
        lead=Markup(paragraph(suite.about or f"suite {suite.name}") + problems(rows)),
        figures=figures,
    )


def benchmark_finding(name: str, part: Standings) -> str:
    """One line: who is first, and who may be as good."""
    ranked = [s for s in part.found if s.rank is not None]
    if not ranked:
        return f"{name}: nothing could be judged"
    best, rest = ranked[0], [s.estimator for s in ranked[1:] if s.low in (1, None)]
    figure = best.easy if best.hard is None else best.hard
    text = f"{name}: {best.estimator} is first of {len(ranked)}, {100 * (figure or 0.0):.2f} points"
    more = f"; {listed(rest)} may be as good" if rest else ""
    return f"{text} of SOC on {'easy' if best.hard is None else 'hard'} runs{more}"


def tinted(value: float) -> Markup:
    """A number on a field that says how good it is."""
    shown = escape(percent(value))
    tint = 1 + sum(value > limit for limit in TINTS)
    return shown if math.isnan(value) else Markup(f'<span class="tint-{tint}">{shown}</span>')


def problems(rows: Rows) -> Markup:
    """What could not be judged, and why."""
    bad = [row for row in rows if row["problem"]]
    text = list(dict.fromkeys(f"{row['estimator']}: {row['problem']}" for row in bad))
    said = paragraph(f"{plural(len(bad), 'run')} of {len(rows)} not judged:")
    return Markup(said + bullets(text[:8], "notices")) if bad else EMPTY


@pictured(
    "standings", "Settled RMSE over hard runs (dot), and the largest settled error of any (bar)."
)
def standings_picture(part: Standings) -> style.Figure:
    """Every estimator that has a rank."""
    found = _pictured(part)
    hard, worst = ([100.0 * getattr(s, k) for s in found] for k in ("hard", "worst"))
    text = f"Hard runs: {min(hard):.2f} to {max(hard):.2f} points RMS"
    return style.dots_on_bars([s.estimator for s in found], hard, worst, text, "SOC error [points]")


def _pictured(part: Standings) -> list[Standing]:
    return [s for s in part.found if None not in (s.rank, s.hard, s.worst)]


def standings_sections(parts: Sequence[Standings], not_run: Sequence[NotRun] = ()) -> list[Section]:
    """A section for each part."""
    said = bullets([f"{one.name}: {one.why}" for one in not_run], "notices")
    left = Markup(paragraph("Not run:") + said) if said else EMPTY
    sections = []
    for k, part in enumerate(parts):
        pictures = [standings_picture(part)] if _pictured(part) else []
        tables = (
            table(one.head, one.rows, caption=text, text_columns=one.text)
            for one, text in zip(part.tables, TABLES, strict=True)
        )
        key = f"standings-{k}"
        shown = (p._replace(key=key) for p in pictures)
        why = paragraph(choice_of(part.found))
        blocks: Blocks = (why, *shown, *tables, EMPTY if k else left)
        sections.append(Section(key, part.title, blocks))
    return sections


def standings_page(suite: str, parts: Sequence[Standings], path: Path) -> Path:
    """The leaderboard alone, as a page."""
    about = f"Leaderboard '{suite}', by cellwise"
    finding = benchmark_finding(suite, parts[0])
    return write_page(path, finding, about, standings_sections(parts), {"suite": suite})
