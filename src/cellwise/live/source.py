"""Streams, and where state is sent, by their names in the command line; JSON lines."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from importlib import import_module
from typing import Any

from cellwise.errors import InputError
from cellwise.live.live_filter import Update
from cellwise.live.samples import STDIN, ObjectReader, Pieces, Readings, Sample, Source, Stray
from cellwise.logs.files.source import HEAD_BYTES, NOTHING_SAID, ReadOptions
from cellwise.wording import arg

WAYS = "stdin, json:FILE, csv:FILE, can:INTERFACE:CHANNEL, ulog:FILE (- for standard input), "
WAYS += "mavlink:LINK, mqtt://HOST/TOPIC, ble:DEVICE"

# By the word before the colon: the module and the class of a stream.
STREAMS = {
    "json": ("source", "JsonLines"),
    "csv": ("source", "JsonLines"),
    "can": ("can_stream", "CanStream"),
    "ulog": ("ulog_stream", "UlogStream"),
    "mavlink": ("mavlink", "MavlinkStream"),
    "mqtt": ("mqtt", "MqttStream"),
    "mqtts": ("mqtt", "MqttStream"),
    "ble": ("ble", "BleStream"),
}


def open_source(
    name: str,
    options: ReadOptions = NOTHING_SAID,
    sign: str = "auto",
    *,
    follow: bool = False,
    cells: int = 0,
) -> Source:
    """A stream by its name in the command line.

    Parameters
    ----------
    name : str              ``stdin``, ``json:FILE``, ``csv:FILE``, ``can:INTERFACE:CHANNEL``,
                            ``ulog:FILE``, ``mavlink:LINK``, ``mqtt://HOST/TOPIC``,
                            ``ble:DEVICE``; a FILE of ``-`` is standard input
    options : ReadOptions   pack, channels, instance, database
    sign : str              ``charge-positive`` turns the current round
    follow : bool           wait for more at a file's end
    cells : int             voltages of so many cells of a pack, too; 0: none

    Raises
    ------
    InputError              none of these, or what it names cannot be opened
    """
    kind, _, rest = name.partition(":")
    if options.dbc is not None and kind != "can":
        raise InputError("a DBC file for a stream without CAN frames", "can:...", "Omit it.")
    if options.instance is not None and kind not in ("ulog", "mavlink"):
        one = arg("instance", letter="...") + " for a stream of one battery"
        raise InputError(one, "ulog:... or mavlink:...", "Omit it.")
    if cells and kind == "ulog":
        raise InputError("cells of a pack in a ULog stream", "json:... or can:...", "Omit them.")
    if name in ("stdin", STDIN):
        kind, rest = "json", STDIN
    if kind not in STREAMS or not rest:
        raise InputError(
            f"a source '{name}'", f"one of {WAYS}", "Name where the samples come from."
        )
    module, made = STREAMS[kind]
    place: str | Pieces = name if kind.startswith("mqtt") else rest
    if kind in ("json", "csv", "ulog"):
        place = Pieces(rest, follow=follow)
    stream: Source = getattr(import_module(f"cellwise.live.{module}"), made)(
        place, options, sign, cells
    )
    return stream


class JsonLines:
    """``{"time_s": 12.5, "current_A": 1.2, "voltage_V": 3.91, "temperature_C": 25}`` per line.

    Or rows of a table below a header of the same names, between commas, semicolons or tabs.
    """

    def __init__(self, pieces: Pieces, options: ReadOptions, sign: str, cells: int = 0) -> None:
        self.name = f"lines from {pieces.name}"
        self._pieces = pieces
        self._reader = ObjectReader(Readings(options, sign, cells), options.channels)
        self._header: list[str] = []
        self._delimiter = ""

    @property
    def note(self) -> str | None:
        """What is to be said of the samples' time."""
        return self._reader.note

    def __iter__(self) -> Iterator[Sample | Stray | None]:
        kept = b""
        for piece in self._pieces:
            if not piece:
                yield None
                continue
            *lines, kept = (kept + piece).split(b"\n")
            arrived_s = time.time()
            for line in lines:
                if line.strip():
                    yield from self._read(line, arrived_s)
            if len(kept) > HEAD_BYTES:  # what goes on for longer is no line
                kept = b""
                yield Stray("a line without an end")
        if kept.strip():
            yield from self._read(kept, time.time())

    def close(self) -> None:
        """Close what was opened."""
        self._pieces.close()

    def _read(self, line: bytes, arrived_s: float) -> Iterator[Sample | Stray]:
        """The sample of a line; none of a header."""
        try:
            if not line.lstrip().startswith(b"{") and (found := self._row(line)) is not None:
                yield from (self._reader.read(one, arrived_s) for one in found)
                return
            yield self._reader.read(json.loads(line), arrived_s)
        except (ValueError, RecursionError):
            yield Stray("neither JSON nor a row below a header of names")

    def _row(self, line: bytes) -> list[dict[str, Any]] | None:
        """A row of a table as an object, none of its header; None: no part of one."""
        text = line.decode("utf-8", errors="replace").lstrip("\ufeff")
        delimiter = self._delimiter or max(";\t,", key=text.count)
        cells = [cell.strip().strip('"') for cell in text.split(delimiter)]
        if sum(map(self._reader.knows, cells)) > 1:
            self._header, self._delimiter = cells, delimiter
            return []
        if not self._header or len(cells) != len(self._header):
            return None
        return [dict(zip(self._header, map(_value, cells), strict=True))]


def _value(cell: str) -> float | str | None:
    """A number, with a decimal point or comma; None of an empty cell, else the text."""
    with suppress(ValueError):
        return float(cell.replace(",", ".")) if cell else None
    return cell


EVERY_S = 1.0
BUS_EVERY_S = 0.1
Row = Callable[[Update], Mapping[str, Any]]


class Sending:
    """What is known after a sample to whoever is sent it, at most once in ``every_s``."""

    def __init__(
        self, send: Callable[[Update, Row], None], close: Callable[[], None], every_s: float
    ) -> None:
        self._send, self.close, self._every_s = send, close, every_s
        self._sent_s = float("-inf")

    def take(self, update: Update, row: Row) -> None:
        """Send if it is time, by this machine's clock."""
        now_s = time.monotonic()
        if now_s - self._sent_s >= self._every_s:
            self._sent_s = now_s
            self._send(update, row)


def sender_to(
    name: str, every_s: float | None, source: Source, options: ReadOptions, least_A: float
) -> Sending:
    """Where state goes, by its name.

    Parameters
    ----------
    name : str               ``mavlink:LINK``, ``mqtt://HOST/PACK``, ``MESSAGE.SIGNAL`` of the bus
    every_s : float or None  seconds between; None: 1, on a bus 0.1
    source : Source          where the samples come from
    options : ReadOptions    of the source: the pack
    least_A : float          more than this into a cell is charging [A]

    Raises
    ------
    InputError               none of these, or what it names cannot be opened
    """
    kind, _, place = name.partition(":")
    sender: Any
    if kind == "mavlink":
        from cellwise.live.mavlink import MavlinkSender

        sender = MavlinkSender(place, source, options, least_A)
    elif kind in ("mqtt", "mqtts"):
        from cellwise.live.mqtt import MqttSender

        sender = MqttSender(name)
    else:
        from cellwise.live.can_stream import CanStream, SocSender

        if not isinstance(source, CanStream):
            raise InputError(
                f"a bus signal '{name}' to send to, and a source that is no CAN bus",
                "mavlink:LINK, mqtt://HOST/PACK, or a source can:INTERFACE:CHANNEL",
                "Omit it, or name the bus.",
            )
        bus = SocSender(source, name)
        every_s = BUS_EVERY_S if every_s is None else every_s
        return Sending(lambda update, _: bus.send(update.info.soc), lambda: None, every_s)
    every_s = EVERY_S if every_s is None else every_s
    return Sending(lambda update, row: sender.send(row(update)), sender.close, every_s)
