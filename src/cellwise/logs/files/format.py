"""Log formats: one record each, detected from the content, never from the file name."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import islice
from typing import Any, Literal

import numpy as np

from cellwise.errors import InputError, not_installed
from cellwise.logs.cell_log import CurrentMeaning
from cellwise.logs.files.columns import MOST_LISTED, Channel, folded
from cellwise.logs.files.source import LogSource, RawLog
from cellwise.notices import Code, Notice
from cellwise.wording import Option, arg

SignConvention = Literal["discharge-positive", "charge-positive"]
Reader = Callable[[LogSource, "Format"], RawLog]


@dataclass(frozen=True)
class Format:
    """One log format.

    Parameters
    ----------
    name : str                  what ``cellwise inspect`` calls it
    matches : callable          whether a file's first bytes are of this format
    channels : sequence         its column map
    read : callable             file and format to channels
    sign : str                  what its positive current means
    current_meaning : str       which interval the current of a row belongs to
    known : sequence of str     columns that belong to it and are not used; None: any may
    instances : bool            a file may hold several batteries
    uses_dbc : bool             a CAN database says what its frames hold
    isolated : bool             read by a library that does not withstand every file: in a process
                                of its own
    """

    name: str
    matches: Callable[[LogSource], bool]
    channels: Sequence[Channel]
    read: Reader
    sign: SignConvention
    current_meaning: CurrentMeaning = "interval_end"
    known: Sequence[str] | None = None
    instances: bool = False
    uses_dbc: bool = False
    isolated: bool = False


_OF_ACCESS = "Print its table: mdb-export FILE.res Channel_Normal_Table > FILE.csv (mdbtools)."
# Content that is given to a log reader by mistake, and what to do about it.
_OTHER_CONTENT = (
    (b"PK\x03\x04", "a zip archive or an Excel workbook", "Export the sheet as CSV, or unpack it."),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook", "Export the sheet as CSV."),
    (b"\x89HDF", "an HDF5 file", "Export time, current and voltage as CSV."),
    *(
        (b"\0\1\0\0Standard " + name, "an Access database (Arbin .res)", _OF_ACCESS)
        for name in (b"Jet DB", b"ACE DB")
    ),
    (b"BZh", "a bzip2 file", "Decompress it first."),
    (b"\xfd7zXZ", "an xz file", "Decompress it first."),
    (b"\x28\xb5\x2f\xfd", "a zstd file", "Decompress it first."),
    (b"\xff\xfe", "a file in UTF-16", "Save it as UTF-8."),
    (b"\xfe\xff", "a file in UTF-16", "Save it as UTF-8."),
)


def detect_format(source: LogSource, formats: Sequence[Format]) -> Format:
    """The first format whose content test the file passes.

    Raises
    ------
    InputError        none does, or the format has no use for what the user stated
    """
    _check_text_is_no_spectrum(source)
    for known in formats:
        if known.matches(source):
            _check_options(source, known)
            return known
    what, action = "content of no known format", "Export the log as CSV with a header line."
    for magic, kind, action_for in _OTHER_CONTENT:
        if source.head.startswith(magic):
            what, action = kind, action_for
    raise InputError(
        f"{what} in '{source.path}' (first bytes {source.head[:12]!r})",
        "a log in one of the formats: " + ", ".join(known.name for known in formats),
        action,
    )


# Names, folded, of what an impedance spectrum has in each row: a frequency and an impedance.
_FREQUENCY = re.compile(r"(?:f|fr[eé][qc]\w*|频率|周波数)\W*(?:hz\W*)?")
_IMPEDANCE = re.compile(
    r"\W*(?:(?:re|im|real|imag|phase|abs|mod)\w*\W*z(?![a-z]).*|\|z\|.*|.*impedan.*"
    r"|z\W*(?:re|im|mod|mag|ph|prime|[\"'′″`]).*|-?(?:real|imag)\w*(?:\W*ohms?\W*)?)"
)
FREQUENCIES = 20  # rows that are looked at
SPAN = 2.0  # of frequencies: those of a grid or of an inverter stay within


def check_no_spectrum(
    names: Sequence[str], values: Callable[[int], Iterable[Any]], where: str
) -> None:
    """Refuse a table whose rows are frequencies; the ``values`` of a column by its place.

    A log over time that holds one frequency, or none in most rows, is a log.

    Raises
    ------
    InputError        an impedance spectrum
    """
    places = [k for k, name in enumerate(names) if _FREQUENCY.fullmatch(folded(name))]
    of = next((name for name in names if _IMPEDANCE.fullmatch(folded(name))), None)
    if not places or of is None:
        return
    found = set()
    for value in islice(values(places[0]), FREQUENCIES):
        with suppress(TypeError, ValueError):
            found.add(float(value.replace(",", ".") if isinstance(value, str) else value))
    found.discard(0.0)
    if len(found) > 2 and max(found) > SPAN * min(found):
        raise InputError(
            f"an impedance spectrum in {where} (columns '{names[places[0]]}' and '{of}'), no log "
            "over time",
            "time, current and voltage of a cell",
            "Give the log of a test or of a drive; no command reads spectra.",
        )


def _check_text_is_no_spectrum(source: LogSource) -> None:
    lines = source.first_lines
    for k, line in enumerate(lines):
        if "f" in (small := line.casefold()) and ("z" in small or "imag" in small):
            delimiter = next((mark for mark in "\t;," if mark in line), None)
            rows = [text.split(delimiter) for text in lines[k:]]
            check_no_spectrum(
                [cell.strip() for cell in rows[0]],
                lambda at, rows=rows[1:]: (row[at] for row in rows if len(row) > at),  # type: ignore[misc]
                source.where,
            )


def _check_options(source: LogSource, known: Format) -> None:
    """Refuse what this format cannot follow."""
    options = source.options
    if options.instance is not None and not known.instances:
        raise InputError(
            f"an instance for {source.where}, whose format {known.name} holds one battery",
            "a log of several batteries",
            "Omit "
            + arg("instance", letter="...")
            + ", or choose the columns with "
            + arg("channels", letter="{...}")
            + ".",
        )
    if options.dbc is not None and not known.uses_dbc:
        raise InputError(
            f"a DBC file for {source.where}, whose format is {known.name}",
            "a log of CAN frames",
            "Omit " + arg("dbc", letter="...") + ".",
        )


def chosen_battery(
    batteries: Mapping[int, str], live: Sequence[int], source: LogSource
) -> tuple[int, list[Notice]]:
    """Which battery of a file that holds several is read, and a notice of the others.

    Parameters
    ----------
    batteries : mapping     number to how it is called or what it shows, for messages
    live : sequence         numbers of those that were measured; the first is read unless stated

    Raises
    ------
    InputError        no battery of the number that the user stated
    """
    stated = source.options.instance
    named = ", ".join(f"{k}: {text}" if text else f"{k}" for k, text in batteries.items())
    if stated is not None and stated not in batteries:
        raise InputError(
            f"no battery {stated} in {source.where}, which has {named}",
            "the number of a battery that is there",
            "Choose one of them with " + arg("instance", letter="K") + ".",
        )
    chosen = next(iter(live or batteries)) if stated is None else stated
    if len(batteries) < 2:
        return chosen, []
    text = f"{len(batteries)} batteries ({named}); read number {chosen}; "
    said = (text, Option("instance", letter="K"), " reads another")
    return chosen, [Notice(Code.SEVERAL_BATTERIES, said)]


def one_battery(raw: RawLog, source: LogSource, known: Format) -> RawLog:
    """Of a table with rows of several batteries in turn, those of one.

    Raises
    ------
    InputError        no battery of the number that the user stated
    """
    channels = dict(raw.channels)
    of = channels.pop("instance", None)
    if of is None:
        if any(c.field == "instance" for c in known.channels):
            chosen_battery({0: ""}, [0], source)
        return raw
    volts = channels.get("voltage_V", of)
    each = {int(k): np.abs(volts[of == k]) for k in np.unique(of[np.isfinite(of)]) if k % 1 == 0.0}
    named = {k: f"{np.nanmedian(v):.1f} V" for k, v in each.items() if np.isfinite(v).any()}
    if len(named) < 2 and source.options.instance is None:
        return replace(raw, channels=channels)
    live = [k for k in named if np.nanmedian(each[k]) > 0.0]
    chosen, notices = chosen_battery(named or {0: ""}, live, source)
    rows = {field: values[of == chosen] for field, values in channels.items()}
    return replace(raw, channels=rows if named else channels, notices=(*notices, *raw.notices))


class SeveralLogsError(InputError):
    """A file of several logs of which none was chosen; ``numbers`` are those of all of them."""

    def __init__(
        self, found: str, expected: str, action: str, numbers: tuple[int, ...] = ()
    ) -> None:
        super().__init__(found, expected, action)
        self.numbers = numbers

    def __reduce__(self) -> tuple[type[InputError], tuple[Any, ...]]:
        """What another process needs to raise it again."""
        return type(self), (self.found, self.expected, self.action, self.numbers)


def chosen_log(logs: Sequence[str], source: LogSource) -> int:
    """Which log of a file that holds several is read; ``logs`` are how they are called.

    Raises
    ------
    SeveralLogsError       the user chose none of them
    """
    stated = source.options.instance
    if len(logs) == 1 and stated is None:
        return 0
    if stated is not None and stated < len(logs):
        return stated
    shown = "; ".join(f"{k}: {name}" for k, name in enumerate(logs[:MOST_LISTED]))
    shown += f"; and {len(logs) - MOST_LISTED} more" if len(logs) > MOST_LISTED else ""
    raise SeveralLogsError(
        f"{len(logs)} logs in {source.where} ({shown})",
        "one of them" if stated is None else f"a number up to {len(logs) - 1}",
        "Choose one with "
        + arg("instance", letter="K")
        + " (of one file: LOG@instance=K); `cellwise history` and "
        "`cellwise identify` take all of them.",
        () if stated is not None else tuple(range(len(logs))),
    )


def damaged(source: LogSource, kind: str, reason: object) -> InputError:
    """The refusal of a file that its own library cannot read to the end."""
    text = " ".join(str(reason).split()).rstrip(".")[:200] or type(reason).__name__
    return InputError(
        f"a cut off or damaged {kind} {source.where} ({text})",
        "a complete file",
        "Copy it again, or have it written again.",
    )


@contextmanager
def without_late_errors() -> Iterator[None]:
    """Keep what cannot be raised (in a callback, in a destructor) from being printed."""
    hook = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    try:
        yield
    finally:
        sys.unraisablehook = hook


@contextmanager
def library_at_work(source: LogSource, kind: str) -> Iterator[None]:
    """Turn whatever a library raises on a damaged file into one refusal.

    These libraries check little: a file that was cut off ends in an index, a key, a struct or an
    assertion error. What they print meanwhile nobody hears: they work in a process of their own.
    """
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:
        raise damaged(source, kind, f"{type(error).__name__}: {error}") from error


def cut_off(source: LogSource, kind: str) -> InputError:
    """The refusal of a recording that ends within a message, as after a loss of power."""
    return InputError(
        f"a cut off {kind} {source.where}: it ends within a message",
        "a complete file",
        "Copy it again; if the recorder lost power, read what there is with "
        + arg("partial", True)
        + ".",
    )


def need(module: str, purpose: str, package: str = "") -> Any:
    """Import a library that not everybody needs.

    Parameters
    ----------
    module : str      what to import
    purpose : str     what is to be read, for the message
    package : str     its name in the registry, where that is another one

    Raises
    ------
    InputError        it is not installed
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        wanted = package or module.partition(".")[0]
        if error.name is not None and error.name.partition(".")[0] != module.partition(".")[0]:
            wanted += f" ({error.name} is missing)"
        raise not_installed(package or module.partition(".")[0], purpose, wanted) from None
