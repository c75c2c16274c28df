"""The firmware twin: cost on emulated cores and here, agreement with the float64 EKF, endurance.

python -m benchmarks.firmware [--only target,host,agreement,endurance] [--json]
"""

from __future__ import annotations

import sys

from benchmarks.figures import Figure, Progress, judged_run, missing
from benchmarks.measured_data import HOW, data_folder

PARTS = ("target", "host", "agreement", "endurance")


def main(arguments: list[str] | None = None) -> int:
    """Measure the parts asked for and print them."""
    return judged_run("Firmware", __doc__, PARTS, measure, arguments)


def measure(parts: list[str], say: Progress) -> list[Figure]:
    """Figures of the parts, in order; a row that says so where something is not there."""
    from benchmarks.firmware.agreement import agreement_figures
    from benchmarks.firmware.cost import host_figures, target_figures
    from benchmarks.firmware.endurance import endurance_figures

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
