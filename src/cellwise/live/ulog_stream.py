"""A ULog as it is written or sent: batteries of PX4, message by message.

The library for whole files cannot read one that is not finished. Messages are laid out as the ULog
format says (https://docs.px4.io/main/en/dev_log/ulog_file_format.html): two bytes of length, one
of type, the body. Where bytes are lost, reading goes on at the next battery message.
"""

from __future__ import annotations

import math
import re
import struct
import time
from collections.abc import Iterator
from typing import NamedTuple

from cellwise.live.samples import Pieces, Readings, Sample, Stray
from cellwise.logs.files.source import ReadOptions
from cellwise.logs.formats.vehicle_logs import MAGIC, TOPIC, UNKNOWN

HEADER_BYTES = 16
HEAD = struct.Struct("<HB")
KINDS = frozenset(b"FABIMPQADLCSOR")
LONGEST = {ord("D"): 8192}  # a message longer than this is a length that was damaged
TYPES = {
    "int8_t": "b", "uint8_t": "B", "int16_t": "h", "uint16_t": "H", "int32_t": "i",
    "uint32_t": "I", "int64_t": "q", "uint64_t": "Q", "float": "f", "double": "d", "bool": "?",
    "char": "c",
}  # fmt: skip
FIELD = re.compile(r"(\w+)(?:\[(\d+)\])? (\w+)")
FIELDS = {"current_A": "current_a", "voltage_V": "voltage_v", "temperature_C": "temperature"}
WANTED = ("timestamp", "connected", *FIELDS.values())
NEEDED = ("timestamp", "voltage_v", "current_a")


class Layout(NamedTuple):
    """Where in a battery message each wanted field stands, and its length in bytes."""

    places: dict[str, tuple[struct.Struct, int]]
    size: int


class UlogStream:
    """Samples of one battery of a ULog that is still being written."""

    def __init__(self, pieces: Pieces, options: ReadOptions, sign: str, cells: int = 0) -> None:
        self.name = f"ULog from {pieces.name}"
        self._pieces = pieces
        self._readings = Readings(options, sign, cells)
        self._instance = options.instance
        self._layout: Layout | None = None
        self._batteries: dict[int, int] = {}  # message id to instance

    def __iter__(self) -> Iterator[Sample | Stray | None]:
        kept = b""
        begun = False
        for piece in self._pieces:
            if not piece:
                yield None
                continue
            kept += piece
            if not begun:
                if len(kept) < HEADER_BYTES:
                    continue
                if kept.startswith(MAGIC):
                    kept = kept[HEADER_BYTES:]
                begun = True
            arrived_s = time.time()
            read = 0
            for kind, body, end in self._messages(kept):
                read = end
                sample = self._take(kind, body, arrived_s)
                if sample is not None:
                    yield sample
            kept = kept[read:]

    def close(self) -> None:
        """Close what was opened."""
        self._pieces.close()

    def _messages(self, data: bytes) -> Iterator[tuple[int, bytes, int]]:
        """Kind, body and end of the whole messages of some bytes; kind 0 for what was lost.

        One after another: what the first ones define helps to find a way out of later damage.
        """
        at = 0
        while len(data) - at >= HEAD.size:
            size, kind = HEAD.unpack_from(data, at)
            end = at + HEAD.size + size
            if kind not in KINDS or size > LONGEST.get(kind, 65_535):
                at = self._next(data, at + 1)
                yield 0, b"", at
            elif end <= len(data):
                body = data[at + HEAD.size : end]
                at = end
                yield kind, body, at
            else:
                at = self._next(data, at + 1, whole=True)
                if not at:
                    return
                yield 0, b"", at

    def _next(self, data: bytes, start: int, *, whole: bool = False) -> int:
        """Where the next battery message may begin; at the end of the data where there is none.

        With ``whole`` only one that is there to its end counts, and 0 says that there is none: a
        long length that was damaged must not swallow what follows.
        """
        places = []
        for number in self._batteries:
            size = 2 + (self._layout.size if self._layout else 0)
            at = data.find(HEAD.pack(size, ord("D")) + struct.pack("<H", number), start)
            if at >= 0 and (not whole or at + HEAD.size + size <= len(data)):
                places.append(at)
        if whole:
            return min(places, default=0)
        return min(places, default=max(len(data) - HEAD.size - 1, start))

    def _take(self, kind: int, body: bytes, arrived_s: float) -> Sample | Stray | None:
        if kind == 0:
            return Stray("bytes of no ULog message")
        if kind == ord("F"):
            self._define(body)
        elif kind == ord("A") and body[3:].decode("ascii", "replace") == TOPIC:
            self._batteries[int.from_bytes(body[1:3], "little")] = body[0]
        elif kind == ord("D"):
            return self._battery(body, arrived_s)
        return None

    def _define(self, body: bytes) -> None:
        name, _, fields = body.decode("ascii", "replace").partition(":")
        if name == TOPIC:
            self._layout = layout_of(fields)

    def _battery(self, body: bytes, arrived_s: float) -> Sample | Stray | None:
        instance = self._batteries.get(int.from_bytes(body[:2], "little"))
        layout = self._layout
        if instance is None or layout is None:
            return None
        if self._instance is not None and instance != self._instance:
            return None
        if len(body) < 2 + layout.size:
            return Stray("a battery message that is too short")
        values = {n: float(s.unpack_from(body, at)[0]) for n, (s, at) in layout.places.items()}
        if self._instance is None:
            # The first battery that is connected and measured.
            if not values.get("connected", 1.0) or math.isnan(_known("voltage_v", values)):
                return None
            self._instance = instance
        time_s = 1e-6 * values["timestamp"]
        for field, name in FIELDS.items():
            self._readings.take(field, _known(name, values), time_s)
        return self._readings.sample(time_s, arrived_s)


def layout_of(fields: str) -> Layout | None:
    """Places of the battery's fields in a definition ``type name;type name;...``.

    None where one that is needed is not there or a type is not a plain one.
    """
    places: dict[str, tuple[struct.Struct, int]] = {}
    at = 2  # behind the message's id
    end = 0
    for kind, count, name in FIELD.findall(fields):
        if kind not in TYPES:
            return None
        one = struct.Struct("<" + TYPES[kind])
        if name in WANTED and not count:
            places[name] = one, at
        at += one.size * int(count or 1)
        if not name.startswith("_padding"):
            end = at  # padding at the end is not written
    return Layout(places, end - 2) if all(name in places for name in NEEDED) else None


def _known(name: str, values: dict[str, float]) -> float:
    """A value, NaN for the code of "unknown"."""
    value = values.get(name, math.nan)
    marks = UNKNOWN.get(name, ())
    return math.nan if any(abs(value - mark) < 1e-6 for mark in marks) else value
