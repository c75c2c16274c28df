"""`python -m cellwise.printing [--check]`: print everything again, or say what differs."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from cellwise.printing.c.firmware import EVERYTHING, print_header, print_source
from cellwise.printing.formulas import theory_text

# The repository's root: files are named from there.
SOURCE = Path(__file__).resolve().parents[3]

PRINTED: dict[str, Callable[[], str]] = {
    "docs/theory.md": lambda: theory_text(SOURCE / "docs" / "theory.md"),
    "firmware_ref/cellwise_ekf.h": lambda: print_header(EVERYTHING),
    "firmware_ref/cellwise_ekf.c": lambda: print_source(EVERYTHING),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Write every printed file; with ``--check`` only compare, 1 where one differs."""
    parser = argparse.ArgumentParser(prog="python -m cellwise.printing", description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    options = parser.parse_args(arguments)
    differ = 0
    for name in PRINTED:
        path = SOURCE / name
        new = PRINTED[name]()
        if path.exists() and path.read_text(encoding="utf-8") == new:
            continue
        differ += 1
        sys.stdout.write(f"{name}{' differs' if options.check else ''}\n")
        if not options.check:
            path.write_text(new, encoding="utf-8")
    return 1 if options.check and differ else 0


if __name__ == "__main__":
    sys.exit(main())
