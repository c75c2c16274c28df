"""What is printed, and where it goes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cellwise.printing.c.firmware import print_header, print_source
from cellwise.printing.formulas import theory_text

# The repository's root: files are named from there.
SOURCE = Path(__file__).resolve().parents[3]

PRINTED: dict[str, Callable[[], str]] = {
    "docs/theory.md": lambda: theory_text(SOURCE / "docs" / "theory.md"),
    "firmware_ref/cellwise_ekf.h": print_header,
    "firmware_ref/cellwise_ekf.c": print_source,
}


def printed(name: str) -> str:
    """The text of one of them."""
    return PRINTED[name]()
