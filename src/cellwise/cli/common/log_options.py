"""The logs that a command names, read as its options say."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from cellwise.cli.common import printing
from cellwise.data import datasets_folder, list_datasets
from cellwise.errors import InputError, MachineError
from cellwise.logs import CellLog, Stated, read_log
from cellwise.logs.files.format import SeveralLogsError
from cellwise.logs.files.source import ReadOptions
from cellwise.logs.gaps import cut_at_pauses
from cellwise.logs.stated import logs_of
from cellwise.workflows import served

if TYPE_CHECKING:
    from cellwise.identify import CellTests

Log = TypeVar("Log")
Made = TypeVar("Made")


def read(path: str | Stated, arguments: argparse.Namespace) -> CellLog:
    """Read a log as the arguments and what is stated behind its path say.

    Where no file has that name, an embedded data set may (`cellwise data list`).

    Raises
    ------
    InputError        options that are no numbers or no pairs; whatever `read_log` refuses
    """
    stated = _embedded(Stated.parse(path) if isinstance(path, str) else path)
    name = f"reading {Path(stated.path).name}"
    with printing.working(name) as follow:
        return read_log(stated, progress=partial(follow, name), **arguments_of_read(arguments))


def _embedded(stated: Stated) -> Stated:
    """The file of an embedded data set of that name, where there is no file of that name."""
    if not stated.path.isidentifier() or Path(stated.path).exists():
        return stated
    with suppress(InputError):  # an installation without its data: the file is what is missing
        files = {str(e["name"]): str(e["file"]) for e in list_datasets()}
        if stated.path in files:
            return replace(stated, path=str(datasets_folder() / files[stated.path]))
    return stated


def read_all(paths: Sequence[str], arguments: argparse.Namespace) -> tuple[CellLog, ...]:
    """The logs of files, folders and patterns.

    Raises
    ------
    InputError        as :func:`read`
    """
    return tuple(log for log, _ in read_each(paths, lambda one: read(one, arguments)))


def read_cut(paths: Sequence[str], arguments: argparse.Namespace) -> tuple[CellLog, ...]:
    """The same, cut where minutes passed that nobody counted: what lies behind is its own log.

    Raises
    ------
    InputError        as :func:`read`
    """
    return tuple(one for log in read_all(paths, arguments) for one in cut_at_pauses(log))


def read_each(paths: Sequence[str], read_one: Callable[[Stated], Log]) -> list[tuple[Log, Stated]]:
    """Each log of files, folders and patterns, with what is stated of it; one bar for all.

    Of a folder or a pattern, what is no log is left out, and said on standard error.

    Raises
    ------
    InputError        as ``read_one``, of a file that was named; of the others if none can be read
    MachineError      the machine failed to read one
    """
    places = [logs_of(path) for path in paths]
    count = sum(len(place.logs) for place in places)
    found: list[tuple[Log, Stated]] = []
    with printing.working("reading") as follow:
        for path, place in zip(paths, places, strict=True):
            unread, before = [], len(found)
            for one in place.logs:
                try:
                    found += _all_of(one, read_one)
                except MachineError:
                    raise
                except InputError as error:
                    if place.named:
                        raise
                    unread.append((one.path, error))
                follow("reading", len(found), count)
            if unread and len(found) == before:
                first = unread[0][1]
                raise InputError(
                    f"a folder or pattern '{path}' of {len(unread)} file(s), none of them a log "
                    "that can be read (the first: " + first.found + ")",
                    first.expected,
                    first.action,
                )
            for name, refusal in unread:
                printing.warn(f"left out of '{path}': '{Path(name).name}', " + refusal.found)
    return found


def each_that_serves(logs: Sequence[Log], do: Callable[[Log], Made]) -> list[Made]:
    """What is made of each log; one of several that is refused is left out and said.

    Raises
    ------
    InputError        as ``do``, of the first where none serves
    """
    return serving(served.each_that_serves(logs, do))


def serving(found: served.Served[Made]) -> list[Made]:
    """What was made; what was refused is said on standard error."""
    for one in found.refused:
        printing.warn(f"left out: {one.found}")
    return found.made


def _all_of(one: Stated, read_one: Callable[[Stated], Log]) -> list[tuple[Log, Stated]]:
    """The log of a file, or all of them where it holds several."""
    try:
        return [(read_one(one), one)]
    except SeveralLogsError as several:
        if not several.numbers:
            raise
        each = [replace(one, instance=k) for k in several.numbers]
    return [(read_one(nth), nth) for nth in each]


def test_logs(arguments: argparse.Namespace) -> CellTests:
    """The laboratory tests, those with a temperature of their own with it.

    Raises
    ------
    InputError        as :func:`read`
    """
    from cellwise.identify import CellTests

    def stated(paths: Sequence[str]) -> tuple[tuple[CellLog, float | None], ...]:
        found = read_each(paths, lambda one: read(one, arguments))
        return tuple((log, one.temperature_C) for log, one in found)

    return CellTests(
        hppc=stated(arguments.hppc),
        drive=stated(arguments.drive),
        ocv=read_all(arguments.ocv, arguments),
        capacity=read_all(arguments.capacity, arguments),
    )


def arguments_of_read(arguments: argparse.Namespace) -> dict[str, Any]:
    """The arguments as those of `read_log`.

    Raises
    ------
    InputError        options that are no numbers or no pairs
    """
    names = ("sign", "dbc", "partial", "decimal")
    said = {name: getattr(arguments, name) for name in names}
    return {**said, **pack_arguments(arguments), "series": _series(arguments.series)}


def read_options(arguments: argparse.Namespace) -> ReadOptions:
    """What the arguments say of a stream.

    Raises
    ------
    InputError        options that are no numbers or no pairs; what `ReadOptions` refuses
    """
    dbc = None if arguments.dbc is None else Path(arguments.dbc)
    return ReadOptions(series=_series(arguments.series), dbc=dbc, **pack_arguments(arguments))


def pack_arguments(arguments: argparse.Namespace) -> dict[str, Any]:
    """What the arguments say of a pack's log, as `read_pack` takes it.

    Raises
    ------
    InputError        options that are no pairs
    """
    return {
        "parallel": arguments.parallel,
        "channels": dict(_pair(text) for text in arguments.channel),
        "instance": arguments.instance,
    }


def _series(text: str) -> int | Literal["auto"]:
    if text == "auto":
        return "auto"
    try:
        return int(text)
    except ValueError:
        raise InputError(f"--series {text}", "a whole number, or auto", "Correct it.") from None


def _pair(text: str) -> tuple[str, str]:
    name, equals, column = text.partition("=")
    if not (equals and name.strip() and column.strip()):
        raise InputError(
            f"--channel {text}", "NAME=COLUMN", "Write e.g. --channel current_mA=I_pack."
        )
    return name.strip(), column.strip()
