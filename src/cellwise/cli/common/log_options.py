"""What every command that takes a LOG lets a user say about it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cellwise.cli.common import printing
from cellwise.errors import InputError
from cellwise.logs import CellLog, Stated
from cellwise.logs.files.source import ReadOptions

LOG_HELP = (
    "a table of text or parquet, or a native file; @-20 or @temperature_C=-20,soc0=1 behind it "
    "says what is known of it"
)


def add_log_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say how a log is to be read."""
    group = add_pack_options(parser, "; auto: as the log states")
    group.add_argument(
        "--partial",
        action="store_true",
        help="read a recording that was cut off, as far as it goes",
    )
    group.add_argument(
        "--decimal",
        choices=("auto", ".", ","),
        default="auto",
        metavar="C",
        help="decimal sign of a text, . or , [by its first rows]",
    )


def add_pack_options(parser: argparse.ArgumentParser, series: str = "") -> argparse._ArgumentGroup:
    """Add the options of a log and a stream alike: sign, pack, channels, database."""
    printing.add_sign(parser)
    group = parser.add_argument_group("packs and native logs")
    group.add_argument(
        "--series",
        default="1",
        metavar="N",
        help=f"cells in series, to read a pack as its mean cell{series} [1]",
    )
    _add_channels(group)
    group.add_argument("--dbc", metavar="FILE", help="database of the frames of a CAN log")
    return group


def read(path: str, arguments: argparse.Namespace) -> CellLog:
    """Read a log as the arguments and what is stated behind its path say.

    Raises
    ------
    InputError        options that are no numbers or no pairs; whatever `read_log` refuses
    """
    return printing.read(path, **arguments_of_read(arguments))


def read_with_temperature(
    texts: list[str], arguments: argparse.Namespace
) -> tuple[tuple[CellLog, float | None], ...]:
    """Logs, each with its stated temperature [degC] or None, as `TestLogs` takes them.

    Raises
    ------
    InputError        as :func:`read`
    """
    return tuple((read(text, arguments), Stated.parse(text).temperature_C) for text in texts)


def parse_soc0(text: str) -> float | None:
    """``auto`` as None, else the number.

    Raises
    ------
    InputError        neither
    """
    if text == "auto":
        return None
    try:
        return float(text)
    except ValueError:
        raise InputError(
            f"--soc0 {text}", "auto or a fraction from 0 to 1", "Correct it."
        ) from None


def start_of(stated: float | None, given: float | None, option: str = "--soc0") -> float | None:
    """The start that is asked for; None where the log's own stated one holds, or none is known.

    Raises
    ------
    InputError        an option that contradicts what is stated of the log
    """
    if stated is None:
        return given
    if given is not None and given != stated:
        raise InputError(
            f"{option} {given:g} for a log whose initial SOC is stated as {stated:g}",
            "one initial SOC",
            f"Leave out {option}, or what is stated behind the @.",
        )
    return None


def arguments_of_read(arguments: argparse.Namespace) -> dict[str, Any]:
    """The arguments as those of `read_log`.

    Raises
    ------
    InputError        options that are no numbers or no pairs
    """
    reading = {"partial": arguments.partial, "decimal": arguments.decimal}
    return {"sign": arguments.sign, **_stated(arguments), **reading}


def read_options(arguments: argparse.Namespace) -> ReadOptions:
    """What the arguments say of a stream.

    Raises
    ------
    InputError        options that are no numbers or no pairs; what `ReadOptions` refuses
    """
    stated = _stated(arguments)
    if stated["dbc"] is not None:
        stated["dbc"] = Path(stated["dbc"])
    return ReadOptions(**stated)


def add_cells_options(parser: argparse.ArgumentParser) -> None:
    """Add what `pack_arguments` reads, and the sign."""
    printing.add_sign(parser)
    _add_channels(parser)


def _add_channels(parser: argparse._ActionsContainer) -> None:
    parser.add_argument("--parallel", default="1", metavar="N", help="cells in parallel [1]")
    parser.add_argument(
        "--channel",
        action="append",
        default=[],
        metavar="NAME=COLUMN",
        help="which column or signal is which, e.g. current_mA=I_pack; NAME gives the unit",
    )
    parser.add_argument("--instance", metavar="K", help="which battery of several, from 0")


def pack_arguments(arguments: argparse.Namespace) -> dict[str, Any]:
    """What the arguments say of a pack's log, as `read_pack` takes it.

    Raises
    ------
    InputError        options that are no numbers or no pairs
    """
    instance = arguments.instance
    return {
        "parallel": _count("--parallel", arguments.parallel),
        "channels": dict(_pair(text) for text in arguments.channel),
        "instance": None if instance is None else _count("--instance", instance),
    }


def _stated(arguments: argparse.Namespace) -> dict[str, Any]:
    instance = arguments.instance
    return {
        "series": "auto" if arguments.series == "auto" else _count("--series", arguments.series),
        "parallel": _count("--parallel", arguments.parallel),
        "channels": dict(_pair(text) for text in arguments.channel),
        "instance": None if instance is None else _count("--instance", instance),
        "dbc": arguments.dbc,
    }


def _count(option: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise InputError(f"{option} {text}", "a whole number", "Correct it.") from None


def _pair(text: str) -> tuple[str, str]:
    name, equals, column = text.partition("=")
    if not (equals and name.strip() and column.strip()):
        raise InputError(
            f"--channel {text}", "NAME=COLUMN", "Write e.g. --channel current_mA=I_pack."
        )
    return name.strip(), column.strip()
