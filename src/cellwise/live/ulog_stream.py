"""A ULog as it is written or sent: batteries of PX4, message by message.

The library for whole files cannot read one that is not finished. Messages are laid out as the ULog
format says (https://docs.px4.io/main/en/dev_log/ulog_file_format.html): two bytes of length, one
of type, the body. A battery's messages are found by how each of them begins: length, type and
number, so that what is lost or damaged between them does no harm.
"""

from __future__ import annotations

import math
import re
import struct
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from cellwise.live.samples import Pieces, Readings, Sample
from cellwise.logs.files.source import ReadOptions
from cellwise.logs.formats.vehicle_logs import TOPIC, without_unknown

HEAD = struct.Struct("<HB")
LONGEST = HEAD.size + 65_535  # of a message
TYPES = {
    **{f"{sign}int{8 * n}_t": f"<{sign or 'i'}{n}" for sign in ("", "u") for n in (1, 2, 4, 8)},
    "float": "<f4",
    "double": "<f8",
    "bool": "?",
    "char": "S1",
}
FIELD = re.compile(r"(\w+)(?:\[(\d+)\])? (\w+)")
FIELDS = {"current_A": "current_a", "voltage_V": "voltage_v", "temperature_C": "temperature"}
NEEDED = ("timestamp", "voltage_v", "current_a")
_DEFINED = re.compile(rb"(..)F(?=%b:)" % TOPIC.encode(), re.DOTALL)
_ADDED = re.compile(rb"(..)A(.)(..)%b" % TOPIC.encode(), re.DOTALL)


class UlogStream:
    """Samples of one battery of a ULog that is still being written."""

    def __init__(self, pieces: Pieces, options: ReadOptions, sign: str, cells: int = 0) -> None:
        self.name = f"ULog from {pieces.name}"
        self._pieces = pieces
        self._readings = Readings(options, sign, cells)
        self._instance = options.instance
        self._layout: np.dtype[Any] | None = None
        self._batteries: dict[bytes, int] = {}  # number of a message to instance

    def __iter__(self) -> Iterator[Sample | None]:
        kept = b""
        for piece in self._pieces:
            if not piece:
                yield None
                continue
            kept += piece
            arrived_s, read = time.time(), 0
            self._define(kept)
            for instance, body, end in self._messages(kept):
                read = end
                sample = self._battery(instance, body, arrived_s)
                if sample is not None:
                    yield sample
            kept = kept[max(read, len(kept) - LONGEST) :]

    def close(self) -> None:
        """Close what was opened."""
        self._pieces.close()

    def _define(self, data: bytes) -> None:
        """Take up what the bytes say of the battery's messages."""
        for found in _DEFINED.finditer(data):
            end = found.end() + int.from_bytes(found[1], "little")
            if end <= len(data):
                fields = data[found.end() + len(TOPIC) + 1 : end].decode("ascii", "replace")
                self._layout = layout_of(fields)
        for found in _ADDED.finditer(data):
            if int.from_bytes(found[1], "little") == 3 + len(TOPIC):  # no longer name
                self._batteries[found[3]] = found[2][0]

    def _messages(self, data: bytes) -> Iterator[tuple[int, np.void, int]]:
        """Instance, fields and end of the whole messages of batteries in some bytes."""
        if self._layout is None or not self._batteries:
            return
        size = self._layout.itemsize
        begins = re.escape(HEAD.pack(2 + size, ord("D")))
        numbers = b"|".join(map(re.escape, self._batteries))
        at = 0
        for found in re.finditer(begins + b"(" + numbers + b")", data):
            if found.start() >= at and found.end() + size <= len(data):
                at = found.end() + size
                body = np.frombuffer(data, self._layout, 1, found.end())[0]
                yield self._batteries[found[1]], body, at

    def _battery(self, instance: int, body: np.void, arrived_s: float) -> Sample | None:
        known = {f: _known(name, body) for f, name in FIELDS.items()}
        if self._instance is None:
            # The first battery that is connected and measured.
            if _known("connected", body) == 0.0 or math.isnan(known["voltage_V"]):
                return None
            self._instance = instance
        if instance != self._instance:
            return None
        time_s = 1e-6 * float(body["timestamp"])
        for field, value in known.items():
            self._readings.take(field, value, time_s)
        return self._readings.sample(time_s, arrived_s)


def layout_of(fields: str) -> np.dtype[Any] | None:
    """The battery's fields of a definition ``type name;type name;...``.

    None where one that is needed is not there or a type is not a plain one.
    """
    parts = [(name, kind, int(count or 1)) for kind, count, name in FIELD.findall(fields)]
    while parts and parts[-1][0].startswith("_padding"):  # at the end it is not written
        parts.pop()
    names = [name for name, _, _ in parts]
    if not all(name in names for name in NEEDED) or any(k not in TYPES for _, k, _ in parts):
        return None
    return np.dtype([(n, TYPES[k]) if c == 1 else (n, TYPES[k], c) for n, k, c in parts])


def _known(name: str, body: np.void) -> float:
    """A value, NaN for the code of "unknown" or where the message has it not."""
    there = name in (body.dtype.names or ())
    return float(without_unknown(name, body[name])) if there else math.nan
