"""Accuracy on measured cells, on logs that no identification has seen, beside the targets.

python -m benchmarks.accuracy [--only panasonic,cold,leaf,a123,embedded] [--json]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.figures import Figure, Progress, missing, print_figures, report_json, write_json
from benchmarks.machine import describe_machine, machine_lines
from benchmarks.measured_data import HOW, data_folder
from benchmarks.speed import progress

PARTS = ("panasonic", "cold", "leaf", "a123", "embedded")


def main(arguments: list[str] | None = None) -> int:
    """Judge the cells asked for and print them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default=",".join(PARTS), help="comma-separated cells")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the table")
    parser.add_argument("-o", "--output", type=Path, help="write the JSON to this file as well")
    chosen = parser.parse_args(arguments)
    wanted = [part for part in PARTS if part in chosen.only.split(",")]
    if not wanted:
        parser.error(f"--only {chosen.only}: name at least one of {', '.join(PARTS)}")
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
    print_figures(
        figures,
        "Accuracy",
        [
            f"{met['met']} of {met['judged']} targets met",
            *machine_lines(machine),
            f"{report['seconds']:.0f} s",
        ],
    )
    return 0


def measure(parts: list[str], say: Progress) -> list[Figure]:
    """Figures of the cells, in order; a row that says so where the data are not there."""
    from benchmarks.accuracy_a123 import a123_figures
    from benchmarks.accuracy_cold import cold_figures
    from benchmarks.accuracy_embedded import embedded_figures
    from benchmarks.accuracy_leaf import leaf_figures
    from benchmarks.accuracy_panasonic import panasonic_figures

    measured = {
        "panasonic": panasonic_figures,
        "cold": cold_figures,
        "leaf": leaf_figures,
        "a123": a123_figures,
    }
    data = data_folder()
    figures: list[Figure] = []
    for part in parts:
        if part == "embedded":
            figures += embedded_figures(say)
        elif data is None:
            figures.append(
                missing(f"{part}: measured cell", "not measured", "", f"no measured data: {HOW}")
            )
        else:
            figures += measured[part](data, say)
    return figures


if __name__ == "__main__":
    sys.exit(main())
