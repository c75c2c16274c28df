"""CAN logs and the database of what frames hold, by python-can and cantools; SavvyCAN's by hand."""

from __future__ import annotations

import io
import math
import re
from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.columns import TIDY_CHANNELS, Unit
from cellwise.logs.files.format import Format, damaged, library_at_work, need
from cellwise.logs.files.source import LogSource, RawLog
from cellwise.logs.formats.vehicle_signals import (
    SIGNAL_UNITS,
    Series,
    Signal,
    aligned,
    choose_signals,
)


def can_database(path: Path | None, of: str) -> Any:
    """A database of cantools.

    Parameters
    ----------
    path : Path or None     what the user gave
    of : str                whose frames it describes, for the message

    Raises
    ------
    InputError              none was given, or the file is no such database
    """
    cantools = need("cantools", "a CAN log")
    if path is None:
        raise InputError(of, "the database that describes them", "Give it with `dbc=FILE.dbc`.")
    try:
        return cantools.database.load_file(str(path), strict=False)
    except Exception as error:  # parsers of four formats raise what they like
        text = " ".join(str(error).split())[:160]
        raise InputError(
            f"a file that is no CAN database, '{path}' ({text})",
            "a DBC, ARXML, KCD or SYM file",
            "Choose the database of this log.",
        ) from error


Key = tuple[int, bool]  # of a frame: its identifier, whether that is an extended one


class Wanted(NamedTuple):
    """A signal of a frame: for which field, or cell from 0 on; its unit, what it may be."""

    field: str | int
    name: str
    unit: Unit
    low: float
    high: float


class FrameDecoder:
    """The battery's signals in CAN frames.

    Parameters
    ----------
    database : cantools database
    where : str             for messages
    channels : mapping      tidy name, which gives the unit, to the signal's name
    keys : collection       frames to look for them in; None: all of the database
    cells : sequence        signals of cells' voltages, in order

    Raises
    ------
    InputError              no clear signals
    """

    def __init__(
        self,
        database: Any,
        where: str,
        channels: Mapping[str, str],
        keys: Collection[Key] | None = None,
        cells: Sequence[Signal] = (),
    ) -> None:
        self.messages: dict[Key, Any] = messages_of(database)
        signals = signals_of(database, self.messages if keys is None else keys)
        others = [s for s in signals if s not in cells]
        chosen, self.notices = choose_signals(others, channels, where)
        units = SIGNAL_UNITS["voltage_V"]
        asked: list[tuple[str | int, Signal, Unit]] = [
            *chosen, *((k, s, units[s.unit.strip().lower()]) for k, s in enumerate(cells))
        ]  # fmt: skip
        self.wanted: dict[Key, list[Wanted]] = {}
        for field, signal, unit in asked:
            key: Any
            key, name = signal.key
            found = self.messages[key].get_signal_by_name(name)
            wanted = Wanted(field, found.name, unit, *_limits_of(found))
            self.wanted.setdefault(key, []).append(wanted)

    def values(self, key: Key, data: bytes) -> list[tuple[Wanted, float]]:
        """What a frame says, NaN outside the range that the database gives ("not available").

        Nothing of a frame that the database does not describe, or, of a multiplexed message, that
        does not hold the signals.
        """
        try:
            found = self.messages[key].decode(data, decode_choices=False)
        except Exception:  # what a short or broken frame raises is not one thing
            return []
        values = []
        for one in self.wanted[key]:
            if one.name in found:
                value = float(found[one.name])
                value = value if one.low <= value <= one.high else math.nan
                values.append((one, value * one.unit.factor + one.unit.offset))
        return values


def messages_of(database: Any) -> dict[Key, Any]:
    """The messages of a database by what their frames are known by."""
    return {(m.frame_id, m.is_extended_frame): m for m in database.messages}


def signals_of(database: Any, keys: Collection[Key]) -> list[Signal]:
    """The signals of some frames; their key is the frame's and their own name."""
    messages = messages_of(database)
    return [
        Signal(f"{messages[key].name}.{s.name}", s.unit or "", (key, s.name))
        for key in sorted(keys)
        for s in messages[key].signals
    ]


def _limits_of(signal: Any) -> tuple[float, float]:
    """Between what the database allows a signal of cantools to be, half a digit more each way."""
    low, high = signal.minimum, signal.maximum
    if low is None or high is None or not low < high:
        return -math.inf, math.inf
    slack = 0.5 * abs(float(signal.scale))
    return float(low) - slack, float(high) + slack


class Frame(NamedTuple):
    """One frame: its time [s], identifier, whether that is an extended one, its bytes."""

    time_s: float
    identifier: int
    extended: bool
    data: bytes


_BLF = b"LOGG"
_SAVVYCAN = "Time Stamp,ID,Extended"
# (stamp) can0 1F0 [8] 00 ... | (stamp) can0 1F0#00... | 7) 12.3 Rx 01F0 8 00 ...
_CANDUMP = re.compile(r"(?:\([\d .:-]+\)\s+)?\w+\s+[0-9A-F]{3,8}(?:\s+\[\d+\]|#)|\d+\)\s+[\d.]+\s")
_ASC = re.compile(
    r"base\s+(?:hex|dec)\s+timestamps|\d+\.\d+\s+\d+\s+[0-9A-F]+x?\s+[RT]x\s+d\s", re.I
)
_REPORT_EVERY = 50_000

Frames = dict[tuple[int, bool], tuple["array[float]", list[bytes]]]


def _reader(source: LogSource) -> str:
    """What reads this content: of python-can, ``cantools``, ``SavvyCAN``; empty: no CAN log."""
    if source.head.startswith(_BLF):
        return "BLFReader"
    lines = [line for line in source.first_lines[:40] if line]
    if any(line.startswith(_SAVVYCAN) for line in lines[:1]):
        return "SavvyCAN"
    if any(line.startswith(";$FILEVERSION") for line in lines[:1]):
        return "TRCReader"
    if any(_ASC.match(line) for line in lines[:5]):
        return "ASCReader"
    return "cantools" if sum(bool(_CANDUMP.match(line)) for line in lines) > 1 else ""


def _read(source: LogSource, known: Format) -> RawLog:
    database = can_database(source.options.dbc, f"CAN frames in {source.where}")
    frames, ids = _frames(source, database)
    if not frames:
        seen = ", ".join(f"0x{i:X}" for i in sorted(ids)[:8])
        there = ", ".join(f"0x{m.frame_id:X} {m.name}" for m in database.messages[:8])
        raise InputError(
            f"no frame in {source.where} that '{source.options.dbc}' describes (frames "
            f"{seen or '-'}{', ...' if len(ids) > 8 else ''}; the database has {there or 'none'})",
            "the database of this log",
            "Choose another DBC file.",
        )
    options = source.options
    decoder = FrameDecoder(database, source.where, options.channels, frames)
    notices = decoder.notices
    series: dict[str, Series] = {}
    for key, wanted in decoder.wanted.items():
        stamps, payloads = frames[key]
        found: dict[str, tuple[list[float], list[float]]] = {str(w.field): ([], []) for w in wanted}
        for at_s, data in zip(stamps, payloads, strict=True):
            for one, value in decoder.values(key, data):
                found[str(one.field)][0].append(at_s)
                found[str(one.field)][1].append(value)
        for one in wanted:
            times, values = map(np.array, found[str(one.field)])
            outside = int(np.count_nonzero(np.isnan(values)))
            if outside == values.size:
                raise InputError(
                    f"no value of '{one.name}' in {source.where} within the range that "
                    f"'{options.dbc}' gives (frames of {len(payloads[0])} byte(s), its message "
                    f"has {decoder.messages[key].length})",
                    "the database of this log",
                    "Choose another DBC file.",
                )
            if outside:
                name = f"{decoder.messages[key].name}.{one.name}"
                notices.append(f"{outside} value(s) of '{name}' outside its range left out")
            series[str(one.field)] = Series(times, values)
    start = min(float(samples.time_s[0]) for samples in series.values())
    series = {field: Series(s.time_s - start, s.values) for field, s in series.items()}
    channels, noted = aligned(series, source.where)
    return RawLog(channels, (*notices, *noted))


def _frames(source: LogSource, database: Any) -> tuple[Frames, set[int]]:
    """Stamps and payloads of the frames that the database describes, and all ids that occur."""
    frames: Frames = {key: (array("d"), []) for key in messages_of(database)}
    ids: set[int] = set()
    with library_at_work(source, "CAN log"):
        for count, frame in enumerate(_messages(source)):
            ids.add(frame.identifier)
            into = frames.get((frame.identifier, frame.extended))
            if into is not None:
                into[0].append(frame.time_s)
                into[1].append(frame.data)
            if count % _REPORT_EVERY == 0:
                source.report(count, max(count + 1, source.size // 16))
    return {key: found for key, found in frames.items() if found[1]}, ids


def _messages(source: LogSource) -> Iterator[Frame]:
    """The frames of a log; others (comments, errors, remote frames) are passed over."""
    reader = _reader(source)
    if reader == "BLFReader":
        with source.open() as stream:
            yield from _of_python_can(source, stream, reader)
        return
    with io.TextIOWrapper(source.open(), encoding="utf-8", errors="replace") as lines:
        if reader == "SavvyCAN":
            yield from _of_savvycan(lines)
        elif reader == "cantools":
            yield from _of_cantools(source, lines)
        else:
            yield from _of_python_can(source, lines, reader)


def _of_python_can(source: LogSource, stream: Any, name: str) -> Iterator[Frame]:
    reader = getattr(need("can", "a CAN log", "python-can"), name)(stream)
    if name == "BLFReader" and not source.gzipped and reader.file_size > source.size:
        raise damaged(source, "CAN log", f"{source.size} of {reader.file_size} bytes")
    for m in reader:
        if not (m.is_error_frame or m.is_remote_frame):
            yield Frame(m.timestamp, m.arbitration_id, m.is_extended_id, bytes(m.data))


def _of_cantools(source: LogSource, lines: Any) -> Iterator[Frame]:
    logreader = need("cantools.logreader", "a CAN log")
    for found in logreader.Parser(lines):
        at = found.timestamp
        if at is None:
            raise InputError(
                f"CAN frames without times in {source.where}",
                "frames with the time of each",
                "Record them with 'candump -L', or with times as 'candump -t a' writes them.",
            )
        seconds = at.timestamp() if isinstance(at, datetime) else at.total_seconds()
        yield Frame(seconds, found.frame_id, found.is_extended_frame, found.data)


def _of_savvycan(lines: Iterator[str]) -> Iterator[Frame]:
    """Time stamp [us], identifier, extended, direction, bus, length, bytes in hex."""
    next(lines, None)
    for line in filter(str.strip, lines):
        stamp, identifier, extended, _, _, _, *data = line.strip().rstrip(",").split(",")
        yield Frame(
            1e-6 * int(stamp),
            int(identifier, 16),
            extended.casefold() in ("true", "1"),
            bytes(int(byte, 16) for byte in data if byte.strip()),
        )


CAN_LOG = Format(
    name="can-log",
    matches=lambda source: bool(_reader(source)),
    channels=TIDY_CHANNELS,
    read=_read,
    sign="discharge-positive",
    uses_dbc=True,
    isolated=True,
)
