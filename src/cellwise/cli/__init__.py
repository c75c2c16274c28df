"""Commands: thin, no numerics."""

from __future__ import annotations

import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command: exit code as of :func:`cellwise.cli.command_line.main`.

    Here stands only what has to be there before anything is imported: an interrupt in the first
    half second is one line.
    """
    try:
        from cellwise.cli.command_line import main as run
    except KeyboardInterrupt:
        print("cellwise: interrupted", file=sys.stderr)
        return 130
    return run(arguments)
