"""CAN logs and the database of what frames hold, by python-can and cantools; SavvyCAN's by hand."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Collection, Iterator, Mapping
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
    cell_signals,
    choose_signals,
)
from cellwise.notices import Code, Notice
from cellwise.wording import arg


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
        raise InputError(
            of,
            "the database that describes them",
            "Give it with " + arg("dbc", letter="FILE.dbc") + ".",
        )
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
Frame = tuple[float, Key, bytes]  # its time [s] before, its bytes behind


class Wanted(NamedTuple):
    """A signal of a frame: for which field, or cell from 0 on; its unit, what it may be."""

    field: str | int
    signal: Signal
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
    cells : int             so many cells' voltages, too, by the names of their signals

    Raises
    ------
    InputError              no clear signals, another number of cells
    """

    def __init__(
        self,
        database: Any,
        where: str,
        channels: Mapping[str, str],
        keys: Collection[Key] | None = None,
        cells: int = 0,
    ) -> None:
        self.messages: dict[Key, Any] = messages_of(database)
        signals = [
            Signal(f"{self.messages[key].name}.{s.name}", s.unit or "", (key, s.name))
            for key in sorted(self.messages if keys is None else keys)
            for s in self.messages[key].signals
        ]
        of_cells = cell_signals(signals, cells) if cells else []
        chosen, self.notices = choose_signals(
            [s for s in signals if s not in of_cells], channels, where
        )
        volts = SIGNAL_UNITS["voltage_V"]
        asked: list[tuple[str | int, Signal, Unit]] = [
            *chosen, *((k, s, volts[s.folded_unit]) for k, s in enumerate(of_cells))
        ]  # fmt: skip
        self.wanted: dict[Key, list[Wanted]] = {}
        for field, signal, unit in asked:
            key: Any
            key, name = signal.key
            limits = _limits_of(self.messages[key].get_signal_by_name(name))
            self.wanted.setdefault(key, []).append(Wanted(field, signal, unit, *limits))

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
            if one.signal.short in found:
                value = float(found[one.signal.short])
                value = value if one.low <= value <= one.high else math.nan
                values.append((one, value * one.unit.factor + one.unit.offset))
        return values


def messages_of(database: Any) -> dict[Key, Any]:
    """The messages of a database by what their frames are known by."""
    return {(m.frame_id, m.is_extended_frame): m for m in database.messages}


def _limits_of(signal: Any) -> tuple[float, float]:
    """Between what the database allows a signal of cantools to be, half a digit more each way."""
    low, high = signal.minimum, signal.maximum
    if low is None or high is None or not low < high:
        return -math.inf, math.inf
    slack = 0.5 * abs(float(signal.scale))
    return float(low) - slack, float(high) + slack


_BLF = b"LOGG"
_SAVVYCAN = "Time Stamp,ID,Extended"
# (stamp) can0 1F0 [8] 00 ... | (stamp) can0 1F0#00... | 7) 12.3 Rx 01F0 8 00 ...
_CANDUMP = re.compile(r"(?:\([\d .:-]+\)\s+)?\w+\s+[0-9A-F]{3,8}(?:\s+\[\d+\]|#)|\d+\)\s+[\d.]+\s")
_ASC = re.compile(
    r"base\s+(?:hex|dec)\s+timestamps|\d+\.\d+\s+\d+\s+[0-9A-F]+x?\s+[RT]x\s+d\s", re.I
)
_REPORT_EVERY = 50_000


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
    dbc = source.options.dbc
    database = can_database(dbc, f"CAN frames in {source.where}")
    frames, ids = _frames(source, messages_of(database))
    if not frames:
        seen = ", ".join(f"0x{i:X}" for i in sorted(ids)[:8])
        there = ", ".join(f"0x{m.frame_id:X} {m.name}" for m in database.messages[:8])
        raise InputError(
            f"no frame in {source.where} that '{dbc}' describes (frames "
            f"{seen or '-'}{', ...' if len(ids) > 8 else ''}; the database has {there or 'none'})",
            "the database of this log",
            "Choose another DBC file.",
        )
    decoder = FrameDecoder(database, source.where, source.options.channels, frames)
    notices = decoder.notices
    samples: dict[Wanted, list[tuple[float, float]]] = {
        one: [] for wanted in decoder.wanted.values() for one in wanted
    }
    for key in decoder.wanted:
        for at_s, data in frames[key]:
            for one, value in decoder.values(key, data):
                samples[one].append((at_s, value))
    start = min((found[0][0] for found in samples.values() if found), default=0.0)
    series: dict[str, Series] = {}
    for one, found in samples.items():
        times, values = np.array(found).reshape(-1, 2).T
        outside = int(np.count_nonzero(np.isnan(values)))
        if outside == values.size:
            of: Any = one.signal.key[0]
            raise InputError(
                f"no value of '{one.signal.name}' in {source.where} within the range that '{dbc}' "
                f"gives (frames of {len(frames[of][0][1])} byte(s), its message has "
                f"{decoder.messages[of].length})",
                "the database of this log",
                "Choose another DBC file.",
            )
        if outside:
            text = f"{outside} value(s) of '{one.signal.name}' outside its range left out"
            notices.append(Notice(Code.SIGNAL_OUTSIDE, text))
        series[str(one.field)] = Series(times - start, values)
    channels, noted = aligned(series, source.where)
    return RawLog(channels, (*notices, *noted))


def _frames(
    source: LogSource, wanted: Collection[Key]
) -> tuple[dict[Key, list[tuple[float, bytes]]], set[int]]:
    """Times and bytes of the frames that are wanted, and all identifiers that occur."""
    frames: dict[Key, list[tuple[float, bytes]]] = {}
    ids: set[int] = set()
    with library_at_work(source, "CAN log"):
        for count, (at_s, key, data) in enumerate(_messages(source)):
            ids.add(key[0])
            if key in wanted:
                frames.setdefault(key, []).append((at_s, data))
            if count % _REPORT_EVERY == 0:
                source.report(count, max(count + 1, source.size // 16))
    return frames, ids


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
            yield m.timestamp, (m.arbitration_id, m.is_extended_id), bytes(m.data)


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
        yield seconds, (found.frame_id, found.is_extended_frame), found.data


def _of_savvycan(lines: Iterator[str]) -> Iterator[Frame]:
    """Time stamp [us], identifier, extended, direction, bus, length, bytes in hex."""
    next(lines, None)
    for line in filter(str.strip, lines):
        stamp, identifier, extended, _, _, _, *data = line.strip().rstrip(",").split(",")
        key = int(identifier, 16), extended.casefold() in ("true", "1")
        yield 1e-6 * int(stamp), key, bytes(int(byte, 16) for byte in data if byte.strip())


CAN_LOG = Format(
    name="can-log",
    matches=lambda source: bool(_reader(source)),
    channels=TIDY_CHANNELS,
    read=_read,
    sign="discharge-positive",
    uses_dbc=True,
    isolated=True,
)
