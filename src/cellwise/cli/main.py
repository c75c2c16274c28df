"""The command line: arguments in, exit code out."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from cellwise.errors import InputError

REFUSED = 2
BUG = 1
INTERRUPTED = 130


def build_parser() -> argparse.ArgumentParser:
    """The parser of every command."""
    from importlib.metadata import version

    from cellwise.cli import (
        benchmarking,
        capacity_study,
        data,
        diagnosing,
        estimating,
        exporting,
        fleet,
        identifying,
        live,
        lives,
        logs,
        packs,
        studies,
    )

    parser = argparse.ArgumentParser(
        prog="cellwise",
        description="Battery cells: identify a model from laboratory tests, simulate it, "
        "estimate SOC.",
    )
    parser.add_argument("--version", action="version", version=f"cellwise {version('cellwise')}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    modules = (
        logs, identifying, estimating, live, diagnosing, packs, lives, exporting, studies,
        capacity_study, benchmarking, fleet, data,
    )  # fmt: skip
    for module in modules:
        module.add_commands(commands)
    for command in commands.choices.values():
        command.add_argument("--debug", action="store_true", help="show the traceback of an error")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Returns
    -------
    int       0 done; 2 the input or the arguments were refused; anything else is a bug
    """
    parsed = build_parser().parse_args(arguments)
    try:
        parsed.run(parsed)
    except InputError as error:
        if parsed.debug:
            raise
        print(f"cellwise {parsed.command}: {error}", file=sys.stderr)
        return REFUSED
    except KeyboardInterrupt:
        print("interrupted: nothing was written", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return 0
    except Exception as error:
        if parsed.debug:
            raise
        print(
            f"cellwise {parsed.command}: internal error, {error.__class__.__name__}: {error}\n"
            "This is a bug. Run again with --debug and report what it shows.",
            file=sys.stderr,
        )
        return BUG
    return 0
