"""What the printers of Python share: a head that says so, and the project's formatter."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

COMMAND = "python -m cellwise.printing"


def head(title: str, *more: str, source: str = "cellwise.cell.description") -> list[str]:
    """First lines of a printed Python module."""
    return [
        f'"""{title}',
        "",
        *more,
        *([""] if more else []),
        f"Printed from :mod:`{source}` by `{COMMAND}`; do not edit.",
        '"""',
        "",
        "from __future__ import annotations",
        "",
    ]


def wrapped_call(start: str, arguments: Sequence[str], end: str = "") -> list[str]:
    """``start(arguments)end`` in one line; :func:`formatted` breaks it."""
    return [f"{start}({', '.join(arguments)}){end}"]


def formatted(text: str) -> str:
    """A module's text as the project's formatter writes it."""
    command = [sys.executable, "-m", "ruff", "format", "--quiet", "-"]
    here = Path(__file__).parent  # the project's settings are found from there
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=True, cwd=here)
    return done.stdout
