"""The command line of a benchmark whose figures stand beside targets: parts, table, JSON."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.figures import Figure, Progress, print_figures, report_json, write_json
from benchmarks.machine import describe_machine, machine_lines

Measure = Callable[[list[str], Progress], list[Figure]]


def judged_run(
    title: str,
    about: str,
    parts: tuple[str, ...],
    measure: Measure,
    arguments: list[str] | None = None,
) -> int:
    """Measure the parts asked for and print them with how many targets are met."""
    parser = argparse.ArgumentParser(description=about.splitlines()[0])
    parser.add_argument("--only", default=",".join(parts), help="comma-separated parts")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the table")
    parser.add_argument("-o", "--output", type=Path, help="write the JSON to this file as well")
    chosen = parser.parse_args(arguments)
    wanted = [part for part in parts if part in chosen.only.split(",")]
    if not wanted:
        parser.error(f"--only {chosen.only}: name at least one of {', '.join(parts)}")
    began = time.perf_counter()
    machine = describe_machine()
    figures = measure(wanted, progress())
    report = report_json(figures, machine, began)
    if chosen.output:
        write_json(chosen.output, report)
    if chosen.json:
        print(json.dumps(report))
        return 0
    met = report["targets"]
    lines = [f"{met['met']} of {met['judged']} targets met", *machine_lines(machine)]
    print_figures(figures, title, [*lines, f"{report['seconds']:.0f} s"])
    return 0


def progress() -> Progress:
    """Say on standard error what is being measured."""

    def say(what: str) -> None:
        print(f"  {what} ...", file=sys.stderr, flush=True)

    return say
