"""Accuracy on measured cells, on logs that no identification has seen, beside the targets.

python -m benchmarks.accuracy [--only panasonic,leaf,lfp,power] [--json]
"""

from __future__ import annotations

import sys

from benchmarks.figures import Figure, Progress, judged_run, missing
from benchmarks.measured_data import HOW, data_folder

PARTS = ("panasonic", "leaf", "lfp", "power")


def main(arguments: list[str] | None = None) -> int:
    """Judge the cells asked for and print them."""
    return judged_run("Accuracy", __doc__, PARTS, measure, arguments)


def measure(parts: list[str], say: Progress) -> list[Figure]:
    """Figures of the cells, in order; a row that says so where the data are not there."""
    from benchmarks.accuracy.leaf import leaf_figures
    from benchmarks.accuracy.lfp import lfp_figures
    from benchmarks.accuracy.panasonic import panasonic_figures
    from benchmarks.accuracy.power import power_figures

    measured = {
        "panasonic": panasonic_figures,
        "leaf": leaf_figures,
        "lfp": lfp_figures,
        "power": power_figures,
    }
    data = data_folder()
    figures: list[Figure] = []
    for part in parts:
        if data is None:
            figures.append(
                missing(f"{part}: measured cell", "not measured", "", f"no measured data: {HOW}")
            )
        else:
            figures += measured[part](data, say)
    return figures


if __name__ == "__main__":
    sys.exit(main())
