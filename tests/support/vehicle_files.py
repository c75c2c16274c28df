"""Logs of vehicles: ULog and dataflash written from their specifications, CAN and MDF by the
libraries' own writers."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

ULOG_HEADER = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
BATTERY_FIELDS = (
    "uint64_t timestamp;float voltage_v;float current_a;float discharged_mah;float temperature;"
    "int32_t cell_count;bool connected;"
)

DBC = """VERSION ""

BU_: BMS

BO_ 256 BMS_Pack: 8 BMS
 SG_ PackCurrent : 0|16@1- (0.01,0) [-300|300] "A" BMS
 SG_ PackVoltage : 23|16@0+ (0.1,0) [0|0] "V" BMS
 SG_ Alive : 32|4@1+ (1,0) [0|0] "" BMS

BO_ 512 BMS_Thermal: 3 BMS
 SG_ BatteryTemp : 0|8@1- (1,-40) [0|0] "degC" BMS
 SG_ MaxCurrentAllowed : 8|16@1+ (0.1,0) [0|0] "A" BMS

BO_ 2566844672 Other: 8 BMS
 SG_ MotorVoltage : 0|16@1+ (0.1,0) [0|0] "V" BMS
"""


def ulog_message(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<H", len(body)) + kind + body


def write_ulog(
    path: Path,
    batteries: Sequence[dict[str, np.ndarray]],
    *,
    cells: int = 4,
    topic: str = "battery_status",
    start_s: float = 20.0,
) -> Path:
    """A ULog with one instance of ``battery_status`` per battery; channels are the pack's own."""
    parts = [ULOG_HEADER, ulog_message(b"F", f"{topic}:{BATTERY_FIELDS}".encode())]
    for k in range(len(batteries)):
        parts.append(ulog_message(b"A", struct.pack("<BH", k, k) + topic.encode()))
    events = []
    for k, c in enumerate(batteries):
        for row in range(c["time_s"].size):
            body = struct.pack(
                "<HQffffi?",
                k,
                round(1e6 * (c["time_s"][row] + start_s)),
                c["voltage_V"][row],
                c["current_A"][row],
                1e3 * c["ampere_hours"][row],
                c["temperature_C"][row],
                cells,
                True,
            )
            events.append((c["time_s"][row], ulog_message(b"D", body)))
    parts += [message for _, message in sorted(events, key=lambda event: event[0])]
    path.write_bytes(b"".join(parts))
    return path


FORMAT_SIZE = {"Q": "Q", "f": "f", "B": "B", "I": "I", "h": "h", "H": "H", "c": "h", "b": "b"}


def dataflash_format(kind: int, name: str, code: str, columns: str, length: int = 0) -> bytes:
    length = length or 3 + struct.calcsize("<" + "".join(FORMAT_SIZE[x] for x in code))
    said = kind, length, name.encode(), code.encode(), columns.encode()
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", *said)


def dataflash_message(kind: int, code: str, *values: float) -> bytes:
    packed = struct.pack("<" + "".join(FORMAT_SIZE[x] for x in code), *values)
    return b"\xa3\x95" + bytes([kind]) + packed


CHANNELS = ("time_s", "voltage_V", "current_A", "ampere_hours", "temperature_C")
# Of each form: names of its messages, their columns and types, their values in a row of CHANNELS.
DATAFLASH = {
    "instances": (
        ("BAT",), "TimeUS,Inst,Volt,VoltR,Curr,CurrTot,Temp", "QBfffff",
        lambda k, t, v, i, q, warm: (round(1e6 * (t + 5)), k, v, v, i, 1e3 * q, warm),
    ),
    "two messages": (
        ("BAT", "BAT2"), "TimeUS,Volt,Curr,CurrTot,Temp", "Qffff",
        lambda k, t, v, i, q, warm: (round(1e6 * (t + 5)), v, i, 1e3 * q, warm),
    ),
    "old": (
        ("CURR",), "TimeMS,Throttle,Volt,Curr,Vcc,CurrTot,Volt2", "IhhhHfh",
        lambda k, t, v, i, q, warm: (
            round(1e3 * (t + 5)), 0, round(100 * v), round(100 * i), 5000, 1e3 * q, 0
        ),
    ),
}  # fmt: skip


def write_dataflash(path: Path, batteries: Sequence[dict[str, np.ndarray]], form: str) -> Path:
    """``BAT`` with instances, ``BAT`` and ``BAT2``, or the old ``CURR`` in hundredths."""
    messages, columns, code, values = DATAFLASH[form]
    parts = [dataflash_format(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 89)]
    parts += [dataflash_format(150 + k, n, code, columns) for k, n in enumerate(messages)]
    events = []
    for k, c in enumerate(batteries):
        kind = 150 + min(k, len(messages) - 1)
        for row in zip(*(c[name] for name in CHANNELS), strict=True):
            events.append((row[0], dataflash_message(kind, code, *values(k, *row))))
    parts += [message for _, message in sorted(events, key=lambda event: event[0])]
    path.write_bytes(b"".join(parts))
    return path


def write_dbc(path: Path, text: str = DBC) -> Path:
    path.write_text(text)
    return path


def can_messages(c: dict[str, np.ndarray], start_s: float = 1_700_000_000.0):
    """Pack frames at every row, temperature at every tenth, a strange frame between."""
    import can
    import cantools

    database = cantools.database.load_string(DBC)

    def frame(at_s: float, identifier: int, data: bytes) -> can.Message:
        return can.Message(
            timestamp=start_s + at_s, arbitration_id=identifier, data=data, is_extended_id=False
        )

    def said(at_s: float, name: str, **signals: float) -> can.Message:
        message = database.get_message_by_name(name)
        return frame(at_s, message.frame_id, message.encode(signals, strict=False))

    rows = zip(*(c[n] for n in ("time_s", "current_A", "voltage_V", "temperature_C")), strict=True)
    for k, (t, i, v, warm) in enumerate(rows):
        yield said(t, "BMS_Pack", PackCurrent=i, PackVoltage=v, Alive=k % 16)
        if k % 10 == 0:
            yield said(t + 1e-3, "BMS_Thermal", BatteryTemp=warm, MaxCurrentAllowed=200.0)
        yield frame(t + 2e-3, 0x7DF, bytes([k % 256]))


def write_can(path: Path, c: dict[str, np.ndarray], kind: str) -> Path:
    """By python-can's writer of that kind (``blf``, ``asc``, ``log``, ``trc``)."""
    import can

    made = path.with_name(f"made.{kind}")
    with can.Logger(str(made)) as logger:
        for message in can_messages(c):
            logger.on_message_received(message)
    made.rename(path)
    return path


def write_mdf(
    path: Path, groups: Sequence[Sequence[tuple[str, str, np.ndarray, np.ndarray]]]
) -> Path:
    """An MDF 4 file by asammdf; a group is (name, unit, time, values) of channels of one clock."""
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        for group in groups:
            file.append([Signal(v, t, name=name, unit=unit) for name, unit, t, v in group])
        file.save(path.with_suffix(".mf4"), overwrite=True)
    path.with_suffix(".mf4").rename(path)
    return path


def write_mdf_frames(path: Path, c: dict[str, np.ndarray]) -> Path:
    """An MDF 4 file of raw CAN frames (bus logging) by asammdf."""
    from asammdf import MDF, Signal
    from asammdf.blocks import v4_constants
    from asammdf.blocks.source_utils import Source

    messages = list(can_messages(c, 0.0))
    fields = {"BusChannel": "u1", "ID": "<u4", "IDE": "u1", "DLC": "u1", "DataLength": "u1"}
    kinds = [(f"CAN_DataFrame.{name}", kind) for name, kind in fields.items()]
    frames = np.zeros(len(messages), [*kinds, ("CAN_DataFrame.DataBytes", "(8,)u1")])
    frames["CAN_DataFrame.BusChannel"] = 1
    for k, message in enumerate(messages):
        frames["CAN_DataFrame.ID"][k] = message.arbitration_id
        frames["CAN_DataFrame.DLC"][k] = frames["CAN_DataFrame.DataLength"][k] = message.dlc
        data = np.frombuffer(bytes(message.data), np.uint8)
        frames["CAN_DataFrame.DataBytes"][k, : data.size] = data
    bus = Source("CAN", "CAN", "", v4_constants.SOURCE_BUS, v4_constants.BUS_TYPE_CAN)
    time = np.array([message.timestamp for message in messages])
    with MDF(version="4.10") as file:
        file.append(Signal(frames, time, name="CAN_DataFrame", source=bus), common_timebase=True)
        file.groups[-1].channel_group.flags = (
            v4_constants.FLAG_CG_BUS_EVENT | v4_constants.FLAG_CG_PLAIN_BUS_EVENT
        )
        file.save(path.with_suffix(".mf4"), overwrite=True)
    path.with_suffix(".mf4").rename(path)
    return path
