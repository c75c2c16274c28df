"""Parts of a benchmark and their cases: measured one by one, and the command line around them."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path

from benchmarks.figures import (
    Figure,
    Progress,
    describe_machine,
    machine_lines,
    missing,
    print_figures,
    report_json,
)
from benchmarks.measured_data import HOW, data_folder
from cellwise.files import write_atomically

Part = tuple[str, str, bool]  # module and function of figures(data, say), whether it needs data
BenchmarkCase = tuple[str, Callable[[], list[Figure]]]  # its name, and what measures it


def each_case(cases: Iterable[BenchmarkCase], say: Progress) -> list[Figure]:
    """Figures of every case, in order; one that breaks off is one row that says why."""
    figures: list[Figure] = []
    for name, run in cases:
        say(name)
        try:
            figures += run()
        except Exception as error:  # the other cases are measured all the same
            figures.append(broken_off(name, error))
    return figures


def broken_off(name: str, error: Exception) -> Figure:
    """The row of a case that broke off."""
    why = f"{type(error).__name__}: {error}"
    return Figure(name, "broke off", None, "", note=why, failed=True)


def measure(
    parts: Mapping[str, Part], wanted: Iterable[str], say: Progress, **switches: bool
) -> list[Figure]:
    """Figures of the parts wanted, in order; a row that says so where there are no data."""
    data = data_folder()
    figures: list[Figure] = []
    for name in wanted:
        module, function, needs_data = parts[name]
        if needs_data and data is None:
            figures.append(missing(name, "not measured", "", f"no measured cells: {HOW}"))
            continue
        run = partial(_run, module, function, data, say, switches)
        figures += each_case([(name, run)], say)
    return figures


def _run(
    module: str, function: str, data: Path | None, say: Progress, switches: dict[str, bool]
) -> list[Figure]:
    found: list[Figure] = getattr(import_module(module), function)(data, say, **switches)
    return found


def chosen_parts(
    parser: argparse.ArgumentParser, parts: Mapping[str, Part], only: str
) -> list[str]:
    """The parts that ``--only`` names, in the benchmark's order; an error where it names none."""
    names = only.split(",")
    wanted = [part for part in parts if part in names]
    if not wanted or set(names) - set(parts):
        parser.error(f"--only {only}: name at least one of {', '.join(parts)}, and nothing else")
    return wanted


def judged_run(
    about: str, parts: Mapping[str, Part], arguments: list[str] | None = None, **switches: str
) -> int:
    """The command line of a benchmark: measures the parts asked for, prints table or JSON.

    Each of ``switches`` (name and help) is a keyword of every part. The exit code is 1 where a
    case broke off.
    """
    parser = argparse.ArgumentParser(description=about.splitlines()[0])
    parser.add_argument("--only", default=",".join(parts), help="comma-separated parts")
    for name, help_ in switches.items():
        parser.add_argument(f"--{name}", action="store_true", help=help_)
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the table")
    parser.add_argument("-o", "--output", type=Path, help="write the JSON to this file as well")
    chosen = parser.parse_args(arguments)
    wanted = chosen_parts(parser, parts, chosen.only)
    began = time.perf_counter()
    machine = describe_machine()
    figures = measure(parts, wanted, say_so, **{name: getattr(chosen, name) for name in switches})
    report = report_json(figures, machine, began)
    if chosen.output:
        write_atomically(chosen.output, json.dumps(report, indent=1) + "\n")
    if chosen.json:
        print(json.dumps(report))
        return int(any(f.failed for f in figures))
    met = report["targets"]
    lines = [f"{met['met']} of {met['judged']} targets met"] if met["judged"] else []
    notes = [*lines, *machine_lines(machine), f"{report['seconds']:.0f} s"]
    print_figures(figures, about.splitlines()[0], notes)
    return int(any(f.failed for f in figures))


def say_so(what: str) -> None:
    """Say on standard error what is being measured."""
    print(f"  {what} ...", file=sys.stderr, flush=True)
