"""Streams, and where state is sent, by their names in the command line; JSON lines."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

from cellwise.errors import InputError
from cellwise.live.live_filter import Update
from cellwise.live.samples import STDIN, ObjectReader, Pieces, Sample, Source, Stray
from cellwise.logs.files.source import NOTHING_SAID, ReadOptions

LONGEST_LINE = 65_536  # bytes; what goes on for longer is no line
WAYS = "stdin, json:FILE, can:INTERFACE:CHANNEL, ulog:FILE (- for standard input), mavlink:LINK, "
WAYS += "mqtt://HOST/TOPIC, ble:DEVICE"


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
    name : str              ``stdin``, ``json:FILE``, ``can:INTERFACE:CHANNEL``, ``ulog:FILE``,
                            ``mavlink:LINK``, ``mqtt://HOST/TOPIC``, ``ble:DEVICE``; a FILE
                            of ``-`` is standard input
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
        one = "`instance=...` for a stream of one battery"
        raise InputError(one, "ulog:... or mavlink:...", "Omit it.")
    if cells and kind == "ulog":
        raise InputError("cells of a pack in a ULog stream", "json:... or can:...", "Omit them.")
    if name in ("stdin", STDIN):
        return JsonLines(Pieces(STDIN), options, sign, cells)
    if kind == "json" and rest:
        return JsonLines(Pieces(rest, follow=follow), options, sign, cells)
    if kind == "can" and rest.count(":") >= 1:
        from cellwise.live.can_stream import CanStream

        interface, _, channel = rest.partition(":")
        return CanStream(interface, channel, options, sign, cells)
    if kind == "ulog" and rest:
        from cellwise.live.ulog_stream import UlogStream

        return UlogStream(Pieces(rest, follow=follow), options, sign)
    if kind == "mavlink" and rest:
        from cellwise.live.mavlink import MavlinkStream

        return MavlinkStream(rest, options, sign, cells)
    if kind in ("mqtt", "mqtts"):
        from cellwise.live.mqtt import MqttStream

        return MqttStream(name, options, sign, cells)
    if kind == "ble" and rest:
        from cellwise.live.ble import BleStream

        return BleStream(rest, options, sign, cells)
    raise InputError(f"a source '{name}'", f"one of {WAYS}", "Name where the samples come from.")


class JsonLines:
    """``{"time_s": 12.5, "current_A": 1.2, "voltage_V": 3.91, "temperature_C": 25}`` per line."""

    def __init__(self, pieces: Pieces, options: ReadOptions, sign: str, cells: int = 0) -> None:
        self.name = f"JSON lines from {pieces.name}"
        self._pieces = pieces
        self._reader = ObjectReader(options, sign, cells)

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
                    yield self._read(line, arrived_s)
            if len(kept) > LONGEST_LINE:
                kept = b""
                yield Stray("a line without an end")
        if kept.strip():
            yield self._read(kept, time.time())

    def close(self) -> None:
        """Close what was opened."""
        self._pieces.close()

    def _read(self, line: bytes, arrived_s: float) -> Sample | Stray:
        try:
            found = json.loads(line)
        except (ValueError, RecursionError):
            return Stray("not JSON")
        return self._reader.read(found, arrived_s)


EVERY_S = 1.0
BUS_EVERY_S = 0.1
Row = Callable[[Update], Mapping[str, Any]]


class Sender(Protocol):
    """What is sent rows of `cellwise live`."""

    def send(self, row: Mapping[str, Any]) -> None:
        """One row."""
        ...

    def close(self) -> None:
        """Let go of whatever is open."""
        ...


class Sending:
    """Rows to a sender, at most one in ``every_s`` of this machine's time."""

    def __init__(self, sender: Sender, every_s: float) -> None:
        self._sender, self._every_s = sender, every_s
        self._sent_s = float("-inf")
        self.close = sender.close

    def take(self, update: Update, row: Row) -> None:
        """Send the row of an update if it is time."""
        now_s = time.monotonic()
        if now_s - self._sent_s >= self._every_s:
            self._sent_s = now_s
            self._sender.send(row(update))


class OnBus:
    """SOC alone, into one signal of a CAN bus."""

    def __init__(self, take: Callable[[float, float], None]) -> None:
        self._take = take

    def take(self, update: Update, row: Row) -> None:
        """Send if it is time, by the clock at which samples arrive."""
        self._take(update.info.soc, update.sample.arrived_s)

    def close(self) -> None:
        """The bus is the source's."""


def sender_to(
    name: str, every_s: float | None, source: Source, options: ReadOptions, least_A: float
) -> Sending | OnBus:
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
    if kind == "mavlink":
        from cellwise.live.mavlink import MavlinkSender

        sender = MavlinkSender(place, source, options, least_A)
        return Sending(sender, EVERY_S if every_s is None else every_s)
    if kind in ("mqtt", "mqtts"):
        from cellwise.live.mqtt import MqttSender

        return Sending(MqttSender(name), EVERY_S if every_s is None else every_s)
    from cellwise.live.can_stream import CanStream, SocSender

    if not isinstance(source, CanStream):
        raise InputError(
            f"a bus signal '{name}' to send to, and a source that is no CAN bus",
            "mavlink:LINK, mqtt://HOST/PACK, or a source can:INTERFACE:CHANNEL",
            "Omit it, or name the bus.",
        )
    return OnBus(SocSender(source, name, BUS_EVERY_S if every_s is None else every_s).send)
