"""The command line: arguments in, exit code out."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from types import FrameType

from cellwise.cli.common.options import check_overwriting
from cellwise.cli.common.parser import REFUSED, CommandParser
from cellwise.cli.common.printing import worded
from cellwise.cli.common.usage import add_commands, listed_commands
from cellwise.errors import InputError

BUG = 1
INTERRUPTED = 130
# What stands at the beginning of a first hour: the kernels of all of them are compiled beside it.
COMPUTING = ("demo", "identify", "simulate", "replay", "diagnose")


def build_parser() -> CommandParser:
    """The parser of every command."""
    from importlib.metadata import version

    parser = CommandParser(
        prog="cellwise",
        usage="cellwise [-h] [--version] COMMAND ...   (of one: COMMAND -h)",
        description=listed_commands(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        add_help=False,
    )
    quiet = argparse.SUPPRESS  # the usage names them
    parser.add_argument("-h", "--help", action="help", help=quiet)
    text = f"cellwise {version('cellwise')}"
    parser.add_argument("--version", action="version", version=text, help=quiet)
    add_commands(parser)
    return parser


def _parsed(parser: CommandParser, arguments: Sequence[str] | None) -> argparse.Namespace:
    """The arguments; an option that no command has is refused with the one it is like."""
    parsed, unknown = parser.parse_known_args(arguments)
    if unknown:
        commands = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
        commands.choices[parsed.command].refuse_unknown(unknown)
    return parsed


@contextmanager
def watched() -> Iterator[list[int]]:
    """Interrupts so far; what cannot be raised after one is not printed either.

    One inside the import of a compiled library or a compiler's callback may come out as any error,
    or as none that can be caught.
    """
    struck: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield struck  # signals are the main thread's
        return

    def strike(number: int, frame: FrameType | None) -> None:
        struck.append(number)
        raise KeyboardInterrupt

    before, hook = signal.signal(signal.SIGINT, strike), sys.unraisablehook
    sys.unraisablehook = lambda error: None if struck else hook(error)
    try:
        yield struck
    finally:
        signal.signal(signal.SIGINT, before)
        if not struck:  # else what is torn down at exit would be printed
            sys.unraisablehook = hook


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Returns
    -------
    int       0 done; 2 the input or the arguments were refused; 130 interrupted; anything else is a
              bug
    """
    with watched() as struck:
        try:
            parsed = _parsed(build_parser(), arguments)
            code, said = _run(parsed)
            sys.stdout.flush()
        except KeyboardInterrupt:
            code, said = INTERRUPTED, "interrupted"
        except BrokenPipeError:
            sys.stderr.close()
            return 0
        except OSError as error:  # of standard output alone: those of files were refused
            sys.stdout = None  # not to be tried again at exit
            code, said = REFUSED, str(_of_system(error, "standard output"))
        if struck:
            code, said = INTERRUPTED, "interrupted; no file was left half written"
        if said:
            print(f"cellwise: {said}" if code == INTERRUPTED else said, file=sys.stderr)
        return code


def _run(parsed: argparse.Namespace) -> tuple[int, str]:
    """Exit code of a command, and what is to be said of an error."""
    try:
        check_overwriting(parsed)
        if parsed.command in COMPUTING and not parsed.debug:
            from cellwise.first_use import begin

            begin()  # in a process of its own, where nothing has been compiled yet
        module, function = parsed.call
        getattr(import_module(f"cellwise.cli.{module}"), function)(parsed)
    except (BrokenPipeError, KeyboardInterrupt):
        raise
    except Exception as error:
        if parsed.debug:
            raise
        refusal = _refusal(error)
        if refusal is not None:
            return REFUSED, f"cellwise {parsed.command}: {worded(refusal.text)}"
        return BUG, (
            f"cellwise {parsed.command}: internal error, {error.__class__.__name__}: {error}\n"
            "This is a bug. Run again with --debug and report what it shows."
        )
    return 0, ""


def _refusal(error: Exception) -> InputError | None:
    """What was refused, in the end by the machine; None for a bug."""
    if isinstance(error, InputError):
        return error
    if isinstance(error, OSError) and error.errno is not None:
        return _of_system(error, str(error.filename or "standard output"))
    if isinstance(error, MemoryError):
        found, expected = "an input that needs more memory than there is", "one that fits"
        return InputError(found, expected, "Give a smaller one, or more memory.")
    if isinstance(error, RecursionError):
        found, expected = "an input that is nested too deeply", "a file that cellwise wrote"
        return InputError(found, expected, "Check which file was given.")
    return None


def _of_system(error: OSError, what: str) -> InputError:
    """The refusal of a file or device that the system refused."""
    return InputError(
        f"{what} that the system refused ({error.strerror or error})",
        "a place that can be read or written, with space left",
        "Check its name, permissions and space, or choose another one.",
    )
