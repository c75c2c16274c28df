"""Lines of text that hold one CAN frame each, as programs other than python-can's write them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import NamedTuple

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
