"""CAN logs and the database of what frames hold: by python-can, or a text of its own."""

from __future__ import annotations

import io
import re
from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
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
    physical_values,
)

STANDARD_IDS = 0x800
LEAST_LINES = 2
SEARCHED_LINES = 60
_DAY_S = 86_400.0

_BYTES = r"(?P<data>(?:[0-9A-Fa-f]{2}[\s,]*)*)"


class Frame(NamedTuple):
    """One frame: its time [s], identifier, whether that is an extended one, its bytes."""

    time_s: float
    identifier: int
    extended: bool
    data: bytes


@dataclass(frozen=True)
class Layout:
    """How one program writes a frame.

    ``line`` has the groups ``time`` (none where it writes no times), ``id``, ``data`` and, where
    it marks extended identifiers, ``extended``; ``header`` is sought in the lines before.
    """

    name: str
    line: re.Pattern[str]
    seconds: Callable[[str], float] | None
    header: str = ""
    decimal_ids: str = ""  # a line that says that identifiers and bytes are decimal


def _clock_of_day(text: str) -> float:
    """``11:49:7:9650``: hours, minutes, seconds and tenths of milliseconds."""
    hours, minutes, seconds, parts = text.split(":")
    return 3600.0 * int(hours) + 60.0 * int(minutes) + int(seconds) + float(f"0.{parts}")


def _candump_time(text: str) -> float:
    """Seconds, or a date with a time."""
    if "-" in text or " " in text:
        return datetime.fromisoformat(text).timestamp()
    return float(text)


LAYOUTS = (
    Layout(
        "SavvyCAN CSV",
        re.compile(
            r"^(?P<time>-?\d+),(?:0x)?(?P<id>[0-9A-Fa-f]+),(?P<extended>true|false|0|1),"
            r"[^,]*,\d+,\d+,?" + _BYTES + r"$",
            re.I,
        ),
        lambda text: 1e-6 * int(text),
        header="Time Stamp,ID,Extended",
    ),
    Layout(
        "candump",
        re.compile(
            r"^\((?P<time>[^)]+)\)\s+\S+\s+(?:[RT]X\s+(?:[-BEL]+\s+)*)?(?P<id>[0-9A-Fa-f]{3,8})\s+"
            r"\[\d+\]\s+" + _BYTES + r"(?:'.*)?$"
        ),
        _candump_time,
    ),
    Layout(
        "candump without times",
        re.compile(r"^\S+\s+(?P<id>[0-9A-Fa-f]{3,8})\s+\[\d+\]\s+" + _BYTES + r"(?:'.*)?$"),
        None,
    ),
    Layout(
        "BUSMASTER log",
        re.compile(
            r"^(?P<time>\d+:\d+:\d+:\d+)\s+(?:Rx|Tx)\s+\d+\s+(?:0x)?(?P<id>[0-9A-Fa-f]+)\s+"
            r"(?P<extended>[sx])\s+\d+\s*(?P<data>(?:[0-9A-Fa-f]{1,3}\s*)*)$"
        ),
        _clock_of_day,
        header="***BUSMASTER",
        decimal_ids="***DEC***",
    ),
    Layout(
        "PCAN trace",
        re.compile(
            r"^\d+\)\s+(?P<time>[\d.]+)\s+(?:(?:Rx|Tx)\s+)?(?P<id>[0-9A-Fa-f]{3,8})\s+\d\s+"
            + _BYTES
            + r"$"
        ),
        lambda text: 1e-3 * float(text),
    ),
    Layout(
        "ASC rows",
        re.compile(
            r"^(?P<time>\d+\.\d+)\s+\d+\s+(?P<id>[0-9A-Fa-f]+)(?P<extended>x?)\s+(?:Rx|Tx)\s+d\s+"
            r"\d+\s+" + _BYTES + r"(?:\s*Length.*)?$"
        ),
        float,
    ),
)


def layout_of(lines: Iterable[str]) -> Layout | None:
    """The layout that most of the first lines have, at least two of them; None: no such log."""
    first = [line for line in lines if line.strip()][:SEARCHED_LINES]
    best, most = None, LEAST_LINES - 1
    for layout in LAYOUTS:
        if layout.header and not any(layout.header in line for line in first):
            continue
        count = sum(bool(layout.line.match(line.strip())) for line in first)
        if count > most:
            best, most = layout, count
    return best


def frames_of(lines: Iterable[str], layout: Layout) -> Iterator[Frame]:
    """The frames of a text's lines; others (comments, errors, remote frames) are passed over.

    Times of day go on after midnight.
    """
    base = 16
    days, before = 0.0, None
    for raw in lines:
        line = raw.strip()
        found = layout.line.match(line)
        if found is None:
            if layout.decimal_ids and layout.decimal_ids in line:
                base = 10
            continue
        seconds = 0.0 if layout.seconds is None else layout.seconds(found["time"])
        if layout.seconds is _clock_of_day:
            if before is not None and seconds < before - _DAY_S / 2:
                days += _DAY_S
            before = seconds
            seconds += days
        groups = found.groupdict()
        identifier = int(groups["id"], base)
        mark = (groups.get("extended") or "").casefold()
        extended = mark in ("true", "1", "x") if "extended" in groups else _is_long(groups["id"])
        cells = re.split(r"[\s,]+", groups["data"].strip(" \t,")) if groups["data"].strip() else []
        yield Frame(seconds, identifier, extended, bytes(int(cell, base) for cell in cells))


def _is_long(identifier: str) -> bool:
    """An identifier of eight digits, or one that is too large for a standard frame."""
    return len(identifier) == 8 or int(identifier, 16) >= STANDARD_IDS


_BLF = b"LOGG"
_CANDUMP = re.compile(r"\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]+#")
_ASC = re.compile(r"base\s+(hex|dec)\s+timestamps\s+(absolute|relative)", re.I)
_REPORT_EVERY = 50_000

Frames = dict[tuple[int, bool], tuple["array[float]", list[bytes]]]


def _kind(source: LogSource) -> str:
    """Reader of python-can for this content; empty if it is none of a CAN log."""
    if source.head.startswith(_BLF):
        return "BLFReader"
    lines = [line for line in source.first_lines[:40] if line]
    if not lines:
        return ""
    if lines[0].startswith(";$FILEVERSION"):
        return "TRCReader"
    if _CANDUMP.match(lines[0]):
        return "CanutilsLogReader"
    if any(_ASC.match(line) for line in lines[:5]):
        return "ASCReader"
    return ""


def _text_layout(source: LogSource) -> Layout | None:
    """The layout of a text that python-can does not read."""
    return None if _kind(source) else layout_of(source.first_lines)


def _read(source: LogSource, known: Format) -> RawLog:
    layout = _text_layout(source)
    if layout is not None and layout.seconds is None:
        raise InputError(
            f"CAN frames without times in {source.where}",
            "frames with the time of each",
            "Record them with 'candump -L', or with times as 'candump -t a' writes them.",
        )
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
    for field, signal, unit in chosen:
        key: Any = signal.key[0]
        stamps, payloads = frames[key]
        values, whole = physical_values(messages[key], str(signal.key[1]), payloads)
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
        for count, frame in enumerate(_of_text(source) or _messages(source)):
            ids.add(frame.identifier)
            into = frames.get((frame.identifier, frame.extended))
            if into is not None:
                into[0].append(frame.time_s)
                into[1].append(frame.data)
            if count % _REPORT_EVERY == 0:
                source.report(count, max(count + 1, source.size // 16))
    return {key: found for key, found in frames.items() if found[1]}, ids


def _of_text(source: LogSource) -> Iterator[Frame] | None:
    """Frames of a text that python-can does not read; None of another file."""
    layout = _text_layout(source)
    if layout is None:
        return None
    lines = io.TextIOWrapper(source.open(), encoding="utf-8", errors="replace")
    return frames_of(lines, layout)


def _messages(source: LogSource) -> Iterator[Frame]:
    can = need("can", "a CAN log", "python-can")
    kind = _kind(source)
    stream: Any = source.open()
    if kind != "BLFReader":
        stream = io.TextIOWrapper(stream, encoding="utf-8", errors="replace")
    with stream:
        reader = getattr(can, kind)(stream)
        if kind == "BLFReader" and not source.gzipped and reader.file_size > source.size:
            raise damaged(source, "CAN log", f"{source.size} of {reader.file_size} bytes")
        for message in reader:
            if not (message.is_error_frame or message.is_remote_frame):
                yield Frame(
                    message.timestamp,
                    message.arbitration_id,
                    message.is_extended_id,
                    bytes(message.data),
                )


CAN_LOG = Format(
    name="can-log",
    matches=lambda source: bool(_kind(source)),
    channels=CHOSEN,
    read=_read,
    sign="discharge-positive",
    uses_dbc=True,
    isolated=True,
)

CAN_TEXT = replace(
    CAN_LOG, name="can-text", matches=lambda source: _text_layout(source) is not None
)
