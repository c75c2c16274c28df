"""State to others: to a CAN bus, an autopilot or a broker, by its name in the command line."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from cellwise.errors import InputError
from cellwise.live.live_filter import Update
from cellwise.live.samples import Source
from cellwise.logs.files.source import ReadOptions

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
