"""The firmware twin: cost on emulated cores and here, agreement with the float64 EKF, endurance.

python -m benchmarks.firmware [--only target,calls,host,agreement,endurance] [--json]
"""

import sys

from benchmarks.parts import judged_run

PARTS = {
    "target": ("benchmarks.firmware.cost", "target_figures", False),
    "calls": ("benchmarks.firmware.cost", "calls_figures", False),
    "host": ("benchmarks.firmware.cost", "host_figures", False),
    "agreement": ("benchmarks.firmware.agreement", "agreement_figures", True),
    "endurance": ("benchmarks.firmware.endurance", "endurance_figures", False),
}


def main(arguments: list[str] | None = None) -> int:
    """Measure the parts asked for and print them."""
    return judged_run(str(__doc__), PARTS, arguments)


if __name__ == "__main__":
    sys.exit(main())
