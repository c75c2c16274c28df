"""cellwise benchmark."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from cellwise.cli.common import page_options, printing
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.benchmark.run_suite import BenchmarkResult
    from cellwise.benchmark.suite import Suite

MOST_PROCESSES = 64


def add_commands(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command that judges estimators."""
    p = commands.add_parser(
        "benchmark", help="estimators x logs x start errors x sensor faults, yours among them"
    )
    p.add_argument(
        "suite",
        nargs="?",
        default="embedded",
        metavar="SUITE",
        help="a TOML file, or embedded, leo, flight, panasonic, a123, public-1 [embedded]",
    )
    p.add_argument("-o", "--output", default="benchmark", metavar="DIR", help="[benchmark]")
    p.add_argument("--data", metavar="DIR", help="folder of the measured cells [$CELLWISE_DATA]")
    p.add_argument(
        "--estimator",
        action="append",
        metavar="E",
        help="instead of the suite's: a name, or file.py:Name of your own; baselines always run",
    )
    p.add_argument("--processes", type=int, default=2, metavar="N", help="at once [2]")
    p.add_argument("--fresh", action="store_true", help="forget what an earlier run left in DIR")
    p.add_argument("--no-page", action="store_true", help="no index.html (it needs matplotlib)")
    p.add_argument("--list", action="store_true", help="suites that come with cellwise")
    page_options.add_figure_options(p)
    printing.add_json(p)
    p.set_defaults(run=run_benchmark)


def run_benchmark(arguments: argparse.Namespace) -> None:
    """Run a suite, print the ranking, write table and page."""
    from cellwise.benchmark.run_suite import run_suite

    if arguments.list:
        list_suites(arguments.json)
        return
    if not 1 <= arguments.processes <= MOST_PROCESSES:
        raise InputError(
            f"--processes {arguments.processes}", f"1 to {MOST_PROCESSES}", "Give e.g. 2."
        )
    page_options.check_page_options(arguments)
    if arguments.no_page and arguments.figures:
        raise InputError("--figures with --no-page", "one of them", "Leave --no-page away.")
    suite = _chosen(arguments)
    folder = arguments.data or os.environ.get("CELLWISE_DATA")
    data = None if not folder else Path(folder)
    if data is not None and not data.is_dir():
        raise InputError(f"no folder '{data}'", "the folder of measured cells", "Correct --data.")
    with printing.bar() as progress:
        task = progress.add_task(suite.name, total=None)
        found = run_suite(
            suite,
            Path(arguments.output),
            data=data,
            processes=arguments.processes,
            fresh=arguments.fresh,
            page=not arguments.no_page,
            figures=page_options.figure_files(arguments),
            progress=lambda what, done, total: progress.update(
                task, description=f"{what} ({done} of {total})", completed=done, total=total
            ),
        )
    if arguments.json:
        printing.print_json(found.to_dict())
        return
    print_benchmark(found)


def _chosen(arguments: argparse.Namespace) -> Suite:
    from cellwise.benchmark.suite import read_suite, with_estimators

    suite = read_suite(arguments.suite)
    if arguments.estimator:
        suite = with_estimators(suite, tuple(arguments.estimator))
    return suite


def list_suites(as_json: bool) -> None:
    """Shipped suites with what they are."""
    from cellwise.benchmark.suite import read_suite, shipped_suites

    suites = [read_suite(name) for name in shipped_suites()]
    if as_json:
        shown = [
            {"name": s.name, "about": s.about, "logs": [g.shown for g in s.logs]} for s in suites
        ]
        printing.print_json({"suites": shown})
        return
    for suite in suites:
        printing.say(f"{suite.name}: {suite.about}")


def print_benchmark(found: BenchmarkResult) -> None:
    """A benchmark for people: overview, faults, what could not be judged."""
    from cellwise.benchmark.paper_tables import difference_text, differences
    from cellwise.report.benchmark.overview import (
        OVERVIEW_HEAD,
        coverage_text,
        fault_matrix,
        overview_row,
        overviews,
    )

    rows = found.rows
    printing.table(
        f"{found.suite.name}: runs without a fault",
        OVERVIEW_HEAD,
        [overview_row(o) for o in overviews(rows)],
    )
    faults = fault_matrix(rows)
    if faults.labels:
        printing.table(
            f"{found.suite.name}: mean settled RMSE by fault, "
            f"start {100 * found.suite.fault_start_error:+.0f} points",
            ("fault, %", *faults.estimators),
            [
                (label, *(printing.percent(float(v)) for v in faults.values[:, k]))
                for k, label in enumerate(faults.labels)
            ],
        )
        if coverage_text(rows):
            printing.say(coverage_text(rows))
    for text in dict.fromkeys(f"{r['estimator']}: {r['problem']}" for r in rows if r["problem"]):
        printing.say(f"  ! {text}")
    plain = [row for row in rows if row["fault"] in ("", "none")]
    for one in differences(plain):
        printing.say(f"  {difference_text(one)}")
    taken = f", {found.resumed} of them from an earlier run" if found.resumed else ""
    printing.say(f"{len(rows)} runs{taken}: {found.parquet}")
    if found.page is not None:
        printing.say(f"page to open: {found.page}")
