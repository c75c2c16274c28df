"""Speed of simulation, filter and identification, beside others in the same run.

python -m benchmarks.speed [--only simulate,filter,file] [--full] [--json]
"""

import sys

from benchmarks.parts import judged_run

PARTS = {
    "simulate": ("benchmarks.speed.simulation", "simulate_figures", False),
    "filter": ("benchmarks.speed.filters", "filter_figures", False),
    "file": ("benchmarks.speed.file_to_tables", "file_figures", False),
}


def main(arguments: list[str] | None = None) -> int:
    """Run the parts asked for and print them."""
    slow = "slow references over 36,000 samples too"
    return judged_run(str(__doc__), PARTS, arguments, full=slow)


if __name__ == "__main__":
    sys.exit(main())
