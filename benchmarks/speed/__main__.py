"""Speed of simulation, filter and identification, beside others in the same run.

python -m benchmarks.speed [--only simulate,filter,pulse,file] [--full] [--json]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

from benchmarks.figures import Figure, Progress, print_figures, report_json, write_json
from benchmarks.judged_run import progress
from benchmarks.machine import describe_machine, machine_lines
from benchmarks.measured_data import data_folder

PARTS = ("simulate", "filter", "pulse", "file")


def main(arguments: list[str] | None = None) -> int:
    """Run the parts asked for and print them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default=",".join(PARTS), help="comma-separated parts")
    parser.add_argument(
        "--full", action="store_true", help="slow references over 36,000 samples too"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the table")
    parser.add_argument("-o", "--output", type=Path, help="write the JSON to this file as well")
    chosen = parser.parse_args(arguments)
    wanted = [part for part in PARTS if part in chosen.only.split(",")]
    if not wanted:
        parser.error(f"--only {chosen.only}: name at least one of {', '.join(PARTS)}")
    began = time.perf_counter()
    machine = describe_machine()
    figures = measure(wanted, progress(), full=chosen.full)
    report = report_json(figures, machine, began)
    if chosen.output:
        write_json(chosen.output, report)
    if chosen.json:
        print(json.dumps(report))
    else:
        print_figures(figures, "Speed", [*machine_lines(machine), f"{report['seconds']:.0f} s"])
    return 0


def measure(parts: list[str], say: Progress, *, full: bool = False) -> list[Figure]:
    """Figures of the parts, in order."""
    from benchmarks.speed.file_to_tables import file_figures
    from benchmarks.speed.filters import filter_figures
    from benchmarks.speed.pulse_fits import pulse_figures
    from benchmarks.speed.simulation import simulate_figures

    data = data_folder()
    figures: list[Figure] = []
    for part in parts:
        if part == "simulate":
            figures += simulate_figures(data, say, full=full)
        elif part == "filter":
            figures += filter_figures(data, say)
        elif part == "pulse":
            figures += pulse_figures(data, say)
        else:
            figures += file_figures(say)
    return figures


if __name__ == "__main__":
    sys.exit(main())
