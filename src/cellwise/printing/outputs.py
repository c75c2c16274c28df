"""What is printed, and where it goes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cellwise.printing.c.firmware import print_header, print_source
from cellwise.printing.derivatives import derivatives_text, part_derivatives_text
from cellwise.printing.formulas import theory_text
from cellwise.printing.text import formatted

# The repository's root: files are named from there.
SOURCE = Path(__file__).resolve().parents[3]

PRINTED: dict[str, Callable[[], str]] = {
    "src/cellwise/cell/derivative_kernels.py": derivatives_text,
    "src/cellwise/identify/refinement/derivative_kernels.py": part_derivatives_text,
    "docs/theory.md": lambda: theory_text(SOURCE / "docs" / "theory.md"),
    "firmware_ref/cellwise_ekf.h": print_header,
    "firmware_ref/cellwise_ekf.c": print_source,
}


def printed(name: str) -> str:
    """The text of one of them, Python as the project's formatter writes it."""
    text = PRINTED[name]()
    return formatted(text) if name.endswith(".py") else text
