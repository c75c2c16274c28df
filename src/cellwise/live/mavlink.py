"""MAVLink: an autopilot's battery over UDP, TCP, a serial line or from a tlog, and state back.

``BATTERY_STATUS`` (https://mavlink.io/en/messages/common.html#BATTERY_STATUS) carries no time of
its own: a sample has that of its arrival, in a tlog the one that was recorded with it.
"""

from __future__ import annotations

import math
import os
import struct
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from cellwise.errors import InputError
from cellwise.estimate.status import INNOVATION_REJECTED, OUT_OF_RANGE, Status
from cellwise.live.samples import POLL_S, Readings, Sample, Source, Stray
from cellwise.logs.files.format import need
from cellwise.logs.files.source import ReadOptions
from cellwise.wording import arg

INFO = ("BATTERY_INFO", "SMART_BATTERY_INFO")  # the first one has replaced the second
# BATTERY_INFO where the library's dialects do not have it: its number, the protocol's checksum of
# its fields, and the fields that come first on the wire.
UNKNOWN_INFO, INFO_EXTRA, INFO_FIELDS = "UNKNOWN_372", 26, struct.Struct("<40x4x5B")
# Codes of "unknown", by the messages' definitions.
NO_VOLTAGE_MV, NO_CURRENT_CA, NO_TEMPERATURE_CDEG = 65_535, -1, 32_767
MOST_VOLTAGES = 14  # of cells in one message
BEAT_S = 1.0  # of a component, by the protocol
# Flags of a filter for which its SOC is not to be relied upon.
UNRELIABLE = Status.CURRENT_LOST | Status.VOLTAGE_LOST | Status.STATE_RESET | Status.GATE_RECOVERY


def connect(place: str, source_system: int = 1) -> Any:
    """A link of pymavlink, on which this program is the vehicle's component "battery".

    Parameters
    ----------
    place : str           ``udpin:HOST:PORT``, ``udpout:...``, ``tcp:...``, a serial port (a speed
                          behind a comma), a tlog
    source_system : int   the vehicle's number

    Raises
    ------
    InputError            the library is missing, or the place cannot be opened
    """
    os.environ.setdefault("MAVLINK20", "1")  # the library's own switch: faults need version 2
    mavutil = need("pymavlink.mavutil", "MAVLink")
    device, _, baud = place.partition(",")
    try:
        if Path(place).is_file():  # a tlog; what `mavlink_connection` opens stumbles over damage
            mavutil.set_dialect("ardupilotmega")
            return mavutil.mavlogfile(place)
        return mavutil.mavlink_connection(
            device,
            baud=int(baud or 57_600),
            source_system=source_system,
            source_component=mavutil.mavlink.MAV_COMP_ID_BATTERY,
            dialect="ardupilotmega",
        )
    except Exception as error:  # each kind of link has errors of its own
        text = " ".join(str(error).split())[:160] or type(error).__name__
        raise InputError(
            f"no MAVLink at '{place}' ({text})",
            "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, SERIAL,BAUD or a tlog",
            "Check the port, and that no other program listens there.",
        ) from error


def battery_info(frame: bytes) -> tuple[int, int] | None:
    """Battery and cells in series of a BATTERY_INFO frame of version 2; None for a damaged one."""
    ends = 10 + frame[1]
    check = need("pymavlink.generator.mavcrc", "MAVLink").x25crc(frame[1:ends])
    check.accumulate(bytes([INFO_EXTRA]))
    if check.crc != int.from_bytes(frame[ends : ends + 2], "little"):
        return None
    # Zeros at the end of what is said are left out of it.
    fields = INFO_FIELDS.unpack_from(frame[10:ends].ljust(INFO_FIELDS.size, b"\0"))
    return int(fields[0]), int(fields[-1])


class MavlinkStream:
    """Samples of one battery of a vehicle.

    The first battery with a voltage is read, else number ``instance``. ``BATTERY_INFO`` states the
    cells in series: ``series='auto'`` takes them from there, another number is refused.

    Parameters
    ----------
    place : str             as :func:`connect`
    options : ReadOptions   pack, instance
    sign : str              ``charge-positive`` turns the current round
    cells : int             voltages of so many cells; 0: none

    Raises
    ------
    InputError              nothing that can be opened
    """

    def __init__(self, place: str, options: ReadOptions, sign: str, cells: int = 0) -> None:
        self.name = f"MAVLink {place}"
        self.place = place
        self._options, self._sign, self._cells = options, sign, cells
        self._readings = None if options.series == "auto" else Readings(options, sign, cells)
        self.battery = options.instance
        self.last: Any = None  # BATTERY_STATUS of this battery
        self._ends = Path(place).is_file()
        self.link = connect(place)

    def __iter__(self) -> Iterator[Sample | Stray | None]:
        while True:
            try:
                message = self.link.recv_match(blocking=not self._ends, timeout=POLL_S)
            except (
                Exception
            ) as error:  # of a serial line that was pulled, of a connection that was closed
                raise InputError(
                    f"{self.name}, which has failed ({error})", "a link that is up", "Check it."
                ) from error
            if message is None and self._ends:
                return
            yield None if message is None else self._take(message)

    def close(self) -> None:
        """Let go of the link."""
        self.link.close()

    def _take(self, message: Any) -> Sample | Stray | None:
        kind = message.get_type()
        if kind == "BAD_DATA":
            return Stray("bytes of no MAVLink message")
        own = (self.link.mav.srcSystem, self.link.mav.srcComponent)
        if (message.get_srcSystem(), message.get_srcComponent()) == own:
            return None  # what this program has sent
        if kind in INFO:
            self._take_info(message.id, message.cells_in_series, kind)
        elif kind == UNKNOWN_INFO and (known := battery_info(message.get_msgbuf())):
            self._take_info(*known, INFO[0])
        return self._battery(message) if kind == "BATTERY_STATUS" else None

    def _take_info(self, battery: int, count: int, kind: str) -> None:
        """The cells in series, from the battery itself."""
        if count < 1 or self.battery not in (None, battery):
            return
        series = self._options.series
        if series == "auto":
            self._options = replace(self._options, series=count)
            self._readings = Readings(self._options, self._sign, self._cells)
        elif series != count:
            raise InputError(
                f"{kind} of {self.name} with {count} cells in series, {series} given",
                "the same number",
                "Give " + arg("series", count) + ", or `auto`.",
            )

    def _battery(self, message: Any) -> Sample | Stray | None:
        volts = [0.001 * v for v in message.voltages if v != NO_VOLTAGE_MV]
        volts += [0.001 * v for v in getattr(message, "voltages_ext", ()) if v not in (0, 65_535)]
        if self.battery is None and sum(volts) > 0.0:
            self.battery = int(message.id)
        if message.id != self.battery:
            return None
        self.last = message
        if self._readings is None:
            return Stray("a battery whose cells in series no BATTERY_INFO has stated yet")
        at_s = message._timestamp
        known_A = message.current_battery != NO_CURRENT_CA
        known_C = message.temperature != NO_TEMPERATURE_CDEG
        said: dict[str | int, float] = {
            "current_A": 0.01 * message.current_battery if known_A else math.nan,
            "voltage_V": sum(volts) if volts else math.nan,
            "temperature_C": 0.01 * message.temperature if known_C else math.nan,
        }
        if len(volts) == self._cells:
            said |= dict(enumerate(volts))
        for field, value in said.items():
            self._readings.take(field, value, at_s)
        return self._readings.sample(at_s, time.time() if self._ends else at_s)


class MavlinkSender:
    """SOC, remaining time and faults as the vehicle's component "battery" says them.

    ``BATTERY_STATUS`` has the number and the readings of the battery that is read; a heartbeat goes
    once a second. The charge state is OK, CHARGING, or UNHEALTHY where the filter has lost a sensor
    or started again: when a battery is low is the autopilot's own setting.

    Parameters
    ----------
    place : str             as :func:`connect`; that of the stream shares its link
    source : Source         where the samples come from
    options : ReadOptions   pack, where the source is no MAVLink
    least_A : float         more than this into a cell is charging [A]
    """

    def __init__(self, place: str, source: Source, options: ReadOptions, least_A: float) -> None:
        self._stream = source if isinstance(source, MavlinkStream) else None
        self._shared = self._stream is not None and self._stream.place == place
        self._link = self._stream.link if self._stream and self._shared else connect(place)
        self._options, self._least_A = options, least_A
        self._beat_s = -math.inf

    def send(self, row: Mapping[str, Any]) -> None:
        """One row of `cellwise live`."""
        mav, said = self._link.mav, need("pymavlink.dialects.v20.ardupilotmega", "MAVLink")
        battery, volts, more, current_cA, warm_cdeg = self._readings(row)
        now_s = time.monotonic()
        if now_s - self._beat_s >= BEAT_S:
            self._beat_s = now_s
            kind, none = said.MAV_TYPE_BATTERY, said.MAV_AUTOPILOT_INVALID
            mav.heartbeat_send(kind, none, 0, 0, said.MAV_STATE_ACTIVE)
        state = said.MAV_BATTERY_CHARGE_STATE_OK
        if row["status"] & UNRELIABLE:
            state = said.MAV_BATTERY_CHARGE_STATE_UNHEALTHY
        elif row["current_A"] < -self._least_A:
            state = said.MAV_BATTERY_CHARGE_STATE_CHARGING
        faults = (
            said.MAV_BATTERY_FAULT_DEEP_DISCHARGE * (row["soc"] <= 0.0)
            | said.MAV_BATTERY_FAULT_SPIKES * bool(row["status"] & INNOVATION_REJECTED)
            | said.MAV_BATTERY_FAULT_INCOMPATIBLE_VOLTAGE * bool(row["status"] & OUT_OF_RANGE)
        )
        left_s = math.inf if row.get("remaining_s") is None else float(row["remaining_s"])
        # 0: not known
        shown_s = max(round(left_s), 1) if math.isfinite(left_s) else 0
        percent = round(100.0 * min(max(row["soc"], 0.0), 1.0))
        mav.battery_status_send(
            battery, said.MAV_BATTERY_FUNCTION_ALL, said.MAV_BATTERY_TYPE_UNKNOWN, warm_cdeg,
            volts, current_cA, -1, -1, percent, shown_s, state,
            voltages_ext=more, fault_bitmask=faults,
        )  # fmt: skip

    def close(self) -> None:
        """Let go of a link of its own."""
        if not self._shared:
            self._link.close()

    def _readings(self, row: Mapping[str, Any]) -> tuple[int, list[int], list[int], int, int]:
        """Number, voltages, further voltages, current and temperature of the battery."""
        last = None if self._stream is None else self._stream.last
        if last is not None:
            self._link.mav.srcSystem = last.get_srcSystem()
            more = list(getattr(last, "voltages_ext", ())) or [0] * 4
            return last.id, list(last.voltages), more, last.current_battery, last.temperature
        cell_V, current_A = row["measured_voltage_V"], row["current_A"]
        series = 1 if self._options.series == "auto" else self._options.series
        mV = [round(1e3 * cell_V)] * series if math.isfinite(cell_V) else []
        if series > MOST_VOLTAGES:  # the sum, as for a pack whose cells nobody measures
            left = sum(mV)
            mV = [min(left - k, NO_VOLTAGE_MV - 1) for k in range(0, left, NO_VOLTAGE_MV - 1)]
        mV = mV[:MOST_VOLTAGES]
        volts = mV[:10] + [NO_VOLTAGE_MV] * (10 - len(mV[:10]))
        more = mV[10:] + [0] * (4 - len(mV[10:]))
        known_A = math.isfinite(current_A)
        current_cA = round(100.0 * current_A * self._options.parallel) if known_A else NO_CURRENT_CA
        temperature_C = float(row.get("temperature_C", math.nan))
        known_C = math.isfinite(temperature_C)
        return (
            0,
            volts,
            more,
            current_cA,
            round(100.0 * temperature_C) if known_C else NO_TEMPERATURE_CDEG,
        )
