"""cellwise benchmark."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from cellwise.cli.common import options, page_options, printing
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.benchmark.run_suite import BenchmarkResult

MOST_PROCESSES = 64


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
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
    options.add_data(p)
    text = "instead of the suite's: a name, or file.py:Name of your own; baselines always run"
    options.several(p, "--estimator", "E", text, default=None)
    options.count(p, "--processes", "N", "at once [2]", default=2)
    options.flag(p, "--fresh", "forget what an earlier run left in DIR")
    options.flag(p, "--no-page", "no index.html (it needs matplotlib)")
    options.flag(p, "--list", "suites that come with cellwise")
    page_options.add_figure_options(p)
    options.add_json(p)
    p.set_defaults(run=run_benchmark)


def run_benchmark(arguments: argparse.Namespace) -> None:
    """Run a suite, print the ranking, write table and page."""
    from cellwise.benchmark.run_suite import run_suite
    from cellwise.benchmark.suite import read_suite, with_estimators

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
    suite = read_suite(arguments.suite)
    if arguments.estimator:
        suite = with_estimators(suite, tuple(arguments.estimator))
    data = options.data_folder(arguments)
    with printing.working(suite.name) as follow:
        found = run_suite(
            suite,
            Path(arguments.output),
            data=data,
            processes=arguments.processes,
            fresh=arguments.fresh,
            page=not arguments.no_page,
            figures=page_options.figure_files(arguments),
            progress=lambda what, done, all_: follow(f"{what} ({done} of {all_})", done, all_),
        )
    if arguments.json:
        printing.print_json(found.to_dict())
        return
    print_benchmark(found)


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
        OVERVIEW_COLUMNS,
        coverage_text,
        fault_matrix,
        fault_rows,
        overviews,
    )

    rows = found.rows
    title = f"{found.suite.name}: runs without a fault"
    printing.record_table(title, overviews(rows), *OVERVIEW_COLUMNS)
    faults = fault_matrix(rows)
    if faults.labels:
        printing.table(
            f"{found.suite.name}: mean settled RMSE by fault, "
            f"start {100 * found.suite.fault_start_error:+.0f} points",
            ("fault, %", *faults.estimators),
            fault_rows(faults, printing.percent),
        )
        if coverage_text(rows):
            printing.say(coverage_text(rows))
    printing.say_notices(f"{r['estimator']}: {r['problem']}" for r in rows if r["problem"])
    plain = [row for row in rows if row["fault"] in ("", "none")]
    for one in differences(plain):
        printing.say(f"  {difference_text(one)}")
    taken = f", {found.resumed} of them from an earlier run" if found.resumed else ""
    printing.say(f"{len(rows)} runs{taken}: {found.parquet}")
    if found.page is not None:
        printing.say(f"page to open: {found.page}")
