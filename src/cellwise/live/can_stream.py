"""A CAN bus through python-can, frames decoded with a database; SOC goes back on the same bus."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

from cellwise.errors import InputError
from cellwise.live.samples import (
    FAILURES,
    POLL_S,
    Readings,
    Sample,
    Stray,
    cell_number,
)
from cellwise.logs.files.columns import Unit
from cellwise.logs.files.format import need
from cellwise.logs.files.source import ReadOptions
from cellwise.logs.formats.vehicle_signals import (
    UNITS,
    Signal,
    can_database,
    choose_signals,
    frame_values,
    limits_of,
)

# A voltage that has not come for so long is missing: charge is counted without it.
NO_VOLTAGE_S = 1.0
SAME_CLOCK_S = 3600.0

Key = tuple[int, bool]


class Wanted(NamedTuple):
    """A signal of a frame: for which field or cell, its unit, what the database allows."""

    field: str | int
    name: str
    unit: Unit
    low: float
    high: float


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
        self._messages: dict[Key, Any] = {
            (m.frame_id, m.is_extended_frame): m for m in self.database.messages
        }
        self._wanted, self.notices = self._choose(options)
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

    def _choose(self, options: ReadOptions) -> tuple[dict[Key, list[Wanted]], list[str]]:
        """The wanted signals of each frame."""
        signals = [
            Signal(f"{message.name}.{s.name}", s.unit or "", (key, s))
            for key, message in self._messages.items()
            for s in message.signals
        ]
        of_cells = self._cell_signals(signals)
        others = [s for s in signals if s.key not in {c.key for c, _ in of_cells}]
        chosen, notices = choose_signals(others, options.channels, f"'{options.dbc}'")
        wanted: dict[Key, list[Wanted]] = {}
        for field, signal, unit in chosen:
            key: Any
            found: Any
            key, found = signal.key
            one = Wanted(field, found.name, unit, *limits_of(found))
            wanted.setdefault(key, []).append(one)
        for signal, position in of_cells:
            key, found = signal.key
            milli = UNITS["voltage_V"][signal.unit.strip().lower()]
            cell = Wanted(position, found.name, milli, -math.inf, math.inf)
            wanted.setdefault(key, []).append(cell)
        return wanted, notices

    def _cell_signals(self, signals: list[Signal]) -> list[tuple[Signal, int]]:
        """Signals of cells' voltages with their positions; refuses another number than asked."""
        if not self._readings.cells:
            return []
        volts = [s for s in signals if s.unit.strip().lower() in UNITS["voltage_V"]]
        numbered = [(s, n) for s in volts if (n := cell_number(s.short)) is not None]
        numbers = sorted({n for _, n in numbered})
        if len(numbers) != self._readings.cells or len(numbered) != len(numbers):
            raise InputError(
                f"signals of {len(numbers)} cells' voltages in the database",
                f"{self._readings.cells}, one for each cell, named like CellVoltage01 or VCell_1",
                "Correct the number of cells, or the names in the database.",
            )
        return [(s, numbers.index(n)) for s, n in numbered]

    def _take(self, message: Any) -> Sample | Stray | None:
        key = (message.arbitration_id, message.is_extended_id)
        wanted = self._wanted.get(key)
        if wanted is None or message.is_error_frame or message.is_remote_frame:
            return None
        values = frame_values(self._messages[key], bytes(message.data))
        if not values:
            return Stray("a frame that the database does not describe")
        stamp = float(message.timestamp)
        has_voltage = False
        for one in wanted:
            if one.name not in values:  # of another multiplexer
                continue
            value = float(values[one.name])
            if not one.low <= value <= one.high:
                value = math.nan
            self._readings.take(one.field, value * one.unit.factor + one.unit.offset, stamp)
            has_voltage |= one.field == "voltage_V"
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
