"""`python -m generator OUT_DIR [NAME ...]`, run from the folder above this package."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from .generate import generate


def main() -> int:
    """Generate the named data sets, or all."""
    parser = argparse.ArgumentParser(prog="generator", description=__doc__)
    parser.add_argument("out_dir", type=Path, help="folder for files and catalogue")
    parser.add_argument("name", nargs="*", help="tests or cells; all without")
    arguments = parser.parse_args()

    def show(name: str, done: int, total: int) -> None:
        print(f"[{done}/{total}] {name}", file=sys.stderr)

    try:
        paths = generate(arguments.out_dir, arguments.name or None, show)
    except ValueError as error:
        parser.error(str(error))
    for path in paths:
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
