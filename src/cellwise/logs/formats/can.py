"""CAN logs and the database of what frames hold, by python-can and cantools; SavvyCAN's by hand."""

from __future__ import annotations

import io
import re
from array import array
from collections.abc import Iterator
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.format import Format, damaged, library_at_work, need
from cellwise.logs.files.source import LogSource, RawLog
from cellwise.logs.formats.vehicle_signals import (
    CHOSEN,
    Series,
    Signal,
    aligned,
    can_database,
    choose_signals,
    frame_values,
    physical_values,
)


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
    database = _database(source)
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
    messages = {(m.frame_id, m.is_extended_frame): m for m in database.messages}
    signals = [
        Signal(f"{messages[key].name}.{s.name}", s.unit or "", (key, s.name))
        for key in sorted(frames)
        for s in messages[key].signals
    ]
    chosen, notices = choose_signals(signals, source.options.channels, source.where)
    series: dict[str, Series] = {}
    wanted: dict[Any, None] = dict.fromkeys(signal.key[0] for _, signal, _ in chosen)
    decoded = {
        key: [frame_values(messages[key], data) for data in frames[key][1]] for key in wanted
    }
    for field, signal, unit in chosen:
        key: Any = signal.key[0]
        stamps, payloads = frames[key]
        known_signal = messages[key].get_signal_by_name(str(signal.key[1]))
        values, whole = physical_values(known_signal, decoded[key])
        if not whole.any():
            raise InputError(
                f"frames of {len(payloads[0])} byte(s) in {source.where}: '{signal.name}' "
                f"needs {messages[key].length} in '{source.options.dbc}'",
                "the database of this log",
                "Choose another DBC file.",
            )
        outside = int(np.count_nonzero(np.isnan(values)))
        if outside == values.size:
            raise InputError(
                f"no value of '{signal.name}' in {source.where} within the range that "
                f"'{source.options.dbc}' gives",
                "the database of this log",
                "Choose another DBC file.",
            )
        if outside:
            notices.append(f"{outside} value(s) of '{signal.name}' outside its range left out")
        series[field] = Series(np.frombuffer(stamps, np.float64)[whole], unit.convert(values))
    start = min(float(samples.time_s[0]) for samples in series.values())
    series = {field: Series(s.time_s - start, s.values) for field, s in series.items()}
    channels, noted = aligned(series, source.where)
    return RawLog(channels, (*notices, *noted))


def _database(source: LogSource) -> Any:
    return can_database(source.options.dbc, f"CAN frames in {source.where}")


def _frames(source: LogSource, database: Any) -> tuple[Frames, set[int]]:
    """Stamps and payloads of the frames that the database describes, and all ids that occur."""
    frames: Frames = {
        (m.frame_id, m.is_extended_frame): (array("d"), []) for m in database.messages
    }
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
    channels=CHOSEN,
    read=_read,
    sign="discharge-positive",
    uses_dbc=True,
    isolated=True,
)
