"""A CAN bus through python-can, frames decoded with a database; SOC goes back on the same bus."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any

from cellwise.errors import InputError
from cellwise.live.samples import (
    FAILURES,
    POLL_S,
    Readings,
    Sample,
    Stray,
)
from cellwise.logs.files.format import need
from cellwise.logs.files.source import ReadOptions
from cellwise.logs.formats.can import FrameDecoder, can_database

# A voltage that has not come for so long is missing: charge is counted without it.
NO_VOLTAGE_S = 1.0
SAME_CLOCK_S = 3600.0


class CanStream:
    """Samples of a CAN bus, one for each voltage.

    Where only the voltage has stopped, samples without a voltage go on once a second.

    Parameters
    ----------
    place : str                 INTERFACE:CHANNEL of python-can: ``socketcan:can0``, ``virtual:...``
    options : ReadOptions       database, channels, pack
    sign : str                  ``charge-positive`` turns the current round
    cells : int                 voltages of so many cells, by the names of their signals; 0: none

    Raises
    ------
    InputError                  no database, no clear signals in it, a bus that cannot be opened
    """

    def __init__(self, place: str, options: ReadOptions, sign: str, cells: int = 0) -> None:
        interface, _, channel = place.partition(":")
        self.name = f"CAN {interface} {channel}"
        self._can = need("can", "a CAN bus", "python-can")
        self.database = can_database(options.dbc, f"frames of {self.name}")
        self._readings = Readings(options, sign, cells)
        self._decoder = FrameDecoder(
            self.database, f"'{options.dbc}'", options.channels, cells=cells
        )
        self.notices = self._decoder.notices
        try:
            if not channel:
                raise ValueError("no channel")
            self.bus = self._can.Bus(interface=interface, channel=channel)
        except Exception as error:  # every interface has errors of its own
            text = " ".join(str(error).split())[:160] or type(error).__name__
            raise InputError(
                f"no bus '{channel}' of python-can's interface '{interface}' ({text})",
                "a bus that is up",
                "Name the source can:INTERFACE:CHANNEL, e.g. can:socketcan:can0.",
            ) from error
        self._emitted_s = math.nan

    def __iter__(self) -> Iterator[Sample | Stray | None]:
        failures = 0
        while True:
            try:
                message = self.bus.recv(POLL_S)
            except self._can.CanError as error:
                failures += 1
                if failures > FAILURES:
                    raise InputError(
                        f"{self.name}, which fails again and again ({error})",
                        "a bus that is up",
                        "Check the interface and its cable.",
                    ) from error
                yield Stray("the bus failed")
                time.sleep(POLL_S)
                continue
            failures = 0
            yield None if message is None else self._take(message)

    def close(self) -> None:
        """Let go of the bus."""
        self.bus.shutdown()

    def _take(self, message: Any) -> Sample | Stray | None:
        key = (message.arbitration_id, message.is_extended_id)
        if key not in self._decoder.wanted or message.is_error_frame or message.is_remote_frame:
            return None
        values = self._decoder.values(key, bytes(message.data))
        if not values:
            return Stray("a frame that the database does not describe")
        stamp = float(message.timestamp)
        for one, value in values:
            self._readings.take(one.field, value, stamp)
        has_voltage = any(one.field == "voltage_V" for one, _ in values)
        if math.isnan(self._emitted_s):
            self._emitted_s = stamp
        late = self._readings.waiting and stamp - self._emitted_s > NO_VOLTAGE_S
        if not (has_voltage or late):
            return None
        self._emitted_s = stamp
        now_s = time.time()
        # A stamp of this machine's clock shows how long the frame has waited to be read.
        return self._readings.sample(stamp, stamp if 0.0 <= now_s - stamp < SAME_CLOCK_S else now_s)


class SocSender:
    """SOC into a signal of the database, sent on the bus that the samples come from.

    Parameters
    ----------
    stream : CanStream
    target : str            ``MESSAGE.SIGNAL``; one in ``%``, or up to more than 2, gets per cent

    Raises
    ------
    InputError              no such signal
    """

    def __init__(self, stream: CanStream, target: str) -> None:
        self._stream = stream
        self.sent = self.failed = 0
        message_name, _, signal_name = target.partition(".")
        there = {m.name: m for m in stream.database.messages}
        message: Any = there.get(message_name)
        signals = {s.name: s for s in message.signals} if message is not None else {}
        if signal_name not in signals:
            named = [f"{m.name}.{s.name}" for m in there.values() for s in m.signals]
            raise InputError(
                f"a signal to send '{target}', which is not in the database",
                "MESSAGE.SIGNAL of the database",
                f"Choose one of {', '.join(named[:12])}.",
            )
        self._message, self._signal = message, signals[signal_name]
        self._others = {n: _initial(s) for n, s in signals.items() if n != signal_name}
        low, high = self._signal.minimum, self._signal.maximum
        self._low = -math.inf if low is None else float(low)
        self._high = math.inf if high is None or high == low else float(high)
        percent = (self._signal.unit or "").strip() in ("%", "percent")
        self._factor = 100.0 if percent or 2.0 < self._high < math.inf else 1.0

    def send(self, soc: float) -> None:
        """Send; a bus that does not take the frame is counted, not fatal."""
        value = min(max(self._factor * soc, self._low), self._high)
        can = self._stream._can
        data = self._message.encode({**self._others, self._signal.name: value}, strict=False)
        frame = can.Message(
            arbitration_id=self._message.frame_id,
            is_extended_id=self._message.is_extended_frame,
            data=data,
        )
        try:
            self._stream.bus.send(frame, timeout=0.0)
            self.sent += 1
        except can.CanError:
            self.failed += 1


def _initial(signal: Any) -> float:
    """What the other signals of the message say."""
    value = signal.initial
    return float(value) if value is not None else float(signal.offset)
