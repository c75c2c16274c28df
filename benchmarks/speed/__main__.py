"""Speed of simulation, filter and identification, beside others in the same run.

python -m benchmarks.speed [--only simulate,filter,file] [--full] [--json]
"""

from __future__ import annotations

import sys

from benchmarks.figures import Figure, Progress, judged_run
from benchmarks.measured_data import data_folder

PARTS = ("simulate", "filter", "file")


def main(arguments: list[str] | None = None) -> int:
    """Run the parts asked for and print them."""
    slow = "slow references over 36,000 samples too"
    return judged_run("Speed", str(__doc__), PARTS, measure, arguments, full=slow)


def measure(parts: list[str], say: Progress, *, full: bool = False) -> list[Figure]:
    """Figures of the parts, in order."""
    from benchmarks.speed.file_to_tables import file_figures
    from benchmarks.speed.filters import filter_figures
    from benchmarks.speed.simulation import simulate_figures

    data = data_folder()
    figures: list[Figure] = []
    for part in parts:
        if part == "simulate":
            figures += simulate_figures(data, say, full=full)
        elif part == "filter":
            figures += filter_figures(data, say)
        else:
            figures += file_figures(say)
    return figures


if __name__ == "__main__":
    sys.exit(main())
