"""Commands: thin, no numerics."""

from __future__ import annotations

TYPE_CHECKING = False  # `typing` takes longer than what stands here
if TYPE_CHECKING:
    from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command: exit code as of :func:`cellwise.cli.command_line.main`.

    Here stands only what has to be there before anything is imported. As a program (no
    ``arguments``), what an interrupt meets before a command runs and after it, imports and what is
    torn down at exit, would be printed as an error of theirs: there it ends the program at once.
    """
    # Without the enumerations of `signal`, whose import an interrupt would meet as well.
    import _signal as signal  # type: ignore[import-not-found]
    import sys

    if arguments is None and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        from cellwise.cli.command_line import main as run

        return run(arguments)
    except KeyboardInterrupt:  # where `run` begins and ends
        print("cellwise: interrupted", file=sys.stderr)
        return 130
