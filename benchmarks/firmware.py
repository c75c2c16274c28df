"""The firmware twin: cost on emulated cores and here, agreement with the float64 EKF, endurance.

python -m benchmarks.firmware [--only target,host,agreement,endurance] [--json]
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

PARTS = ("target", "host", "agreement", "endurance")


def main(arguments: list[str] | None = None) -> int:
    """Measure the parts asked for and print them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default=",".join(PARTS), help="comma-separated parts")
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
        "Firmware",
        [
            f"{met['met']} of {met['judged']} targets met",
            *machine_lines(machine),
            f"{report['seconds']:.0f} s",
        ],
    )
    return 0


def measure(parts: list[str], say: Progress) -> list[Figure]:
    """Figures of the parts, in order; a row that says so where something is not there."""
    from benchmarks.firmware_agreement import agreement_figures
    from benchmarks.firmware_cost import host_figures, target_figures
    from benchmarks.firmware_endurance import endurance_figures

    figures: list[Figure] = []
    for part in parts:
        if part == "target":
            figures += target_figures(say)
        elif part == "host":
            figures += host_figures(say)
        elif part == "endurance":
            figures += endurance_figures(say)
        else:
            data = data_folder()
            figures += (
                [missing("agreement", "measured cell", "", f"no measured data: {HOW}")]
                if data is None
                else agreement_figures(data, say)
            )
    return figures


if __name__ == "__main__":
    sys.exit(main())
