"""Print every source that follows from another: python -m cellwise.printing [--check]."""

from __future__ import annotations

import sys
from pathlib import Path

from cellwise.printing.firmware import print_header, print_source
from cellwise.printing.fixed_covariance import print_covariance

PACKAGE = Path(__file__).resolve().parents[1]
FIRMWARE = PACKAGE.parents[1] / "firmware_ref"


def printed() -> dict[Path, str]:
    """Every printed file with its text; what C follows from comes first."""
    return {
        PACKAGE / "estimate" / "fixed" / "covariance.py": print_covariance(),
        FIRMWARE / "cellwise_ekf.h": print_header(),
        FIRMWARE / "cellwise_ekf.c": print_source(),
    }


def main(arguments: list[str]) -> int:
    """Write, or with ``--check`` compare: 1 where something differs."""
    differ = [path for path, text in printed().items() if path.read_text(encoding="utf-8") != text]
    for path in differ:
        sys.stdout.write(f"{path.relative_to(PACKAGE.parents[1])}\n")
        if "--check" not in arguments:
            path.write_text(printed()[path], encoding="utf-8")
    return int(bool(differ) and "--check" in arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
