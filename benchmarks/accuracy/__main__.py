"""Accuracy on measured cells, on logs that no identification has seen, beside the targets.

python -m benchmarks.accuracy [--only panasonic,cold,leaf,lfp,power] [--json]
"""

import sys

from benchmarks.parts import judged_run

PARTS = {
    name: (f"benchmarks.accuracy.{name}", f"{name}_figures", True)
    for name in ("panasonic", "cold", "leaf", "lfp", "power")
}


def main(arguments: list[str] | None = None) -> int:
    """Judge the cells asked for and print them."""
    return judged_run(str(__doc__), PARTS, arguments)


if __name__ == "__main__":
    sys.exit(main())
