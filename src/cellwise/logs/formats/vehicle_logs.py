"""What vehicles record: PX4 ULog, ArduPilot dataflash, ASAM MDF, LeafSpy.

ULog and dataflash hold batteries by number, positive on discharge; MDF holds signals by unit and
name, each group on its own clock, or CAN frames that a DBC file describes.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import IO, Any

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.columns import KELVIN_OFFSET, TIDY_CHANNELS
from cellwise.logs.files.format import Format, chosen_battery, cut_off, library_at_work, need
from cellwise.logs.files.source import LogSource, RawLog
from cellwise.logs.files.tables import channels_of
from cellwise.logs.formats.column_maps import mapped
from cellwise.logs.formats.vehicle_signals import Series, Signal, aligned, choose_signals
from cellwise.notices import Code, Notice
from cellwise.typing import FloatArray
from cellwise.wording import arg

MAGIC = b"ULog\x01\x12\x35"
TOPIC = "battery_status"
_HEADER_BYTES = 3  # of a message; where one would begin, a file may end
# The code of "unknown", by the message's definition.
UNKNOWN = {
    "voltage_v": (-1.0, 0.0),
    "current_a": (-1.0,),
    "discharged_mah": (-1.0,),
    "temperature": (-1.0, KELVIN_OFFSET),
}


def _read_ulog(source: LogSource, known: Format) -> RawLog:
    pyulog = need("pyulog", "a PX4 ULog")
    with library_at_work(source, "ULog"), source.open() as stream:
        watched = _Watched(stream)
        log = pyulog.ULog(watched, [TOPIC])
    if watched.ended_within and not source.options.partial:
        raise cut_off(source, "ULog")
    found = {d.multi_id: d for d in log.data_list if d.name == TOPIC}
    if not found:
        with library_at_work(source, "ULog"), source.open() as stream:
            topics = sorted({d.name for d in pyulog.ULog(stream).data_list})
        raise InputError(
            f"no topic '{TOPIC}' in {source.where}, which has {len(topics)} topics "
            f"({', '.join(topics[:8])}{', ...' if len(topics) > 8 else ''})",
            "a log of a vehicle that measures its battery",
            "Record battery_status (SDLOG_PROFILE), or choose another log.",
        )
    volts = {k: f"{_typical(found[k].data):.1f} V" for k in sorted(found)}
    live = [k for k in volts if _is_measured(found[k].data)]
    chosen, notices = chosen_battery(volts, live, source)
    data = found[chosen].data
    arrays = {name: without_unknown(name, values) for name, values in data.items()}
    start = arrays["timestamp"][0] if arrays["timestamp"].size else 0.0
    arrays["timestamp"] = arrays["timestamp"] - start
    raw = channels_of(arrays, source, known, _cells(data))
    if watched.ended_within:
        text = "the ULog is cut off; it was read as far as it goes"
        notices.append(Notice(Code.FILE_CUT_OFF, text))
    if log.file_corruption:
        text = "the ULog is damaged in places; what could not be read was passed over"
        notices.append(Notice(Code.FILE_DAMAGED, text))
    return RawLog(_measured(raw.channels), (*raw.notices, *notices), raw.cells)


class _Watched:
    """A file that remembers whether it ended within what was asked of it."""

    def __init__(self, file: IO[bytes]) -> None:
        self.file = file
        self.ended_within = False

    def read(self, size: int = -1) -> bytes:
        """As of a file."""
        data = self.file.read(size)
        if len(data) < size and (data or size != _HEADER_BYTES):
            self.ended_within = True
        return data

    def __getattr__(self, name: str) -> Any:
        return getattr(self.file, name)


def _is_measured(data: dict[str, Any]) -> bool:
    connected = np.any(data["connected"]) if "connected" in data else True
    current = without_unknown("current_a", data.get("current_a", np.array([-1.0])))
    voltage = without_unknown("voltage_v", data.get("voltage_v", np.array([0.0])))
    return bool(connected and np.any(np.isfinite(current)) and np.any(np.isfinite(voltage)))


def _typical(data: dict[str, Any]) -> float:
    return float(np.median(data["voltage_v"])) if len(data.get("voltage_v", ())) else 0.0


def without_unknown(name: str, values: Any) -> FloatArray:
    """Values with the code of "unknown" as NaN."""
    array: FloatArray = np.asarray(values, dtype=np.float64)
    for mark in UNKNOWN.get(name, ()):
        array = np.where(np.isclose(array, mark), np.nan, array)
    return array


def _measured(channels: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Channels without the optional ones that hold nothing or zero throughout: not measured."""
    optional = ("temperature_C", "charge_Ah")
    return {f: x for f, x in channels.items() if f not in optional or np.nan_to_num(x).any()}


def _cells(data: dict[str, Any]) -> int | None:
    counts = np.asarray(data.get("cell_count", ()))
    return int(counts[-1]) if counts.size and counts[-1] > 0 else None


PX4_ULOG = mapped(
    "px4-ulog",
    matches=lambda source: source.head.startswith(MAGIC),
    read=_read_ulog,
    instances=True,
    isolated=True,
)


_DATAFLASH = b"\xa3\x95\x80"
_DATAFLASH_TEXT = re.compile(rb"\s*FMT,\s*128,\s*89,\s*FMT")
# Message to the battery it is of; None: the message says it itself.
_MESSAGES: dict[str, int | None] = {"BAT": None, "BAT2": 1, "CURR": 0, "CUR2": 1, "CURR2": 1}
_INSTANCE = ("Inst", "Instance", "I")
_CENTI = ("Volt", "VoltR", "Curr", "Volt2")
_INTEGERS = "bBhHiIqQ"


def _read_dataflash(source: LogSource, known: Format) -> RawLog:
    reader = need("pymavlink.DFReader", "an ArduPilot dataflash log")
    with library_at_work(source, "dataflash log"):
        text = not source.head.startswith(_DATAFLASH)
        log = (reader.DFReader_text if text else reader.DFReader_binary)(str(source.path))
        there = {f.name: f for f in log.formats.values()}
        wanted = [name for name in _MESSAGES if name in there]
        whole = text or _is_whole(log)
        rows = _battery_rows(log, wanted, source) if whole or source.options.partial else {}
        log.close()
    if not (whole or source.options.partial):
        raise cut_off(source, "dataflash log")
    batteries = sorted({battery for _, battery in rows})
    if not batteries:
        raise InputError(
            f"no battery message in {source.where}, whose messages are "
            f"{', '.join(sorted(there)[:12]) or 'none'}",
            "BAT or CURR messages",
            "Log with a battery monitor (BATT_MONITOR), or choose another log.",
        )
    chosen, notices = chosen_battery(dict.fromkeys(batteries, ""), batteries, source)
    # BAT stands beside the older messages where a log has both.
    name = next(n for n in wanted if (n, chosen) in rows)
    arrays = _columns(there[name], rows[name, chosen])
    raw = channels_of(arrays, source, known)
    notices = [*raw.notices, *notices]
    if not whole:
        said = "the dataflash log is cut off; it was read as far as it goes"
        notices.append(Notice(Code.FILE_CUT_OFF, said))
    channels = _measured(raw.channels)
    channels["time_s"] = channels["time_s"] - channels["time_s"][0]
    return RawLog(channels, tuple(notices))


def _is_whole(log: Any) -> bool:
    """No message reaches beyond the end of the file."""
    ends = [
        starts[-1] + log.formats[kind].len
        for kind, starts in enumerate(log.offsets)
        if len(starts) and kind in log.formats
    ]
    return bool(ends) and max(ends) <= log.data_len


def _battery_rows(
    log: Any, wanted: Sequence[str], source: LogSource
) -> dict[tuple[str, int], list[list[float]]]:
    """Every battery message's values, by message and battery."""
    rows: dict[tuple[str, int], list[list[float]]] = {}
    if not wanted:
        return rows
    while (message := log.recv_match(type=list(wanted))) is not None:
        name = message.get_type()
        battery = _MESSAGES[name]
        if battery is None:
            field = next((f for f in _INSTANCE if f in message._fieldnames), None)
            battery = int(getattr(message, field)) if field else 0
        rows.setdefault((name, battery), []).append(
            [getattr(message, field) for field in message._fieldnames]
        )
        source.report(int(log.percent * source.size / 100.0), source.size)
    return rows


def _columns(layout: Any, rows: list[list[float]]) -> dict[str, FloatArray]:
    """Columns by name; old firmware counts volts and amperes in hundredths."""
    numbers = (int, float)
    table = np.array([[x if isinstance(x, numbers) else np.nan for x in row] for row in rows])
    columns = {}
    for k, (name, code) in enumerate(zip(layout.columns, layout.format, strict=False)):
        values = table[:, k]
        columns[name] = 0.01 * values if name in _CENTI and code in _INTEGERS else values
    return columns


ARDUPILOT_DATAFLASH = mapped(
    "ardupilot-dataflash",
    matches=lambda source: (
        source.head.startswith(_DATAFLASH) or _DATAFLASH_TEXT.match(source.head) is not None
    ),
    read=_read_dataflash,
    instances=True,
    isolated=True,
)


_MDF = (b"MDF     ", b"UnFinMF ")
_FRAMES = "CAN_DataFrame"
_BUSES = ("CAN_", "LIN_")  # groups of frames, as the standard names them


def _read_mdf(source: LogSource, known: Format) -> RawLog:
    asammdf = need("asammdf", "an ASAM MDF file")
    with library_at_work(source, "MDF file"):
        file: Any = asammdf.MDF(source.path)
        signals = _signals(file)
    with file:
        if source.options.dbc is not None:
            with library_at_work(source, "MDF file"):
                file = file.extract_bus_logging({"CAN": [(str(source.options.dbc), 0)]})
                signals = _signals(file)
            if not signals:
                raise InputError(
                    f"no frame of {source.where} in the database '{source.options.dbc}'",
                    "the database of these frames",
                    "Choose another DBC file, or omit " + arg("dbc", letter="...") + ".",
                )
        elif (signals or _has_frames(file)) and all(_of_a_bus(s.name) for s in signals):
            raise InputError(
                f"CAN frames only in {source.where}",
                "the database that describes them",
                "Give it with " + arg("dbc", letter="FILE.dbc") + ".",
            )
        chosen, notices = choose_signals(signals, source.options.channels, source.where)
        with library_at_work(source, "MDF file"):
            series = {}
            for field, signal, unit in chosen:
                group, index = signal.key
                read = file.get(group=group, index=index, ignore_invalidation_bits=False)
                values = np.asarray(read.samples, dtype=np.float64)
                series[field] = Series(
                    np.asarray(read.timestamps, dtype=np.float64), unit.convert(values)
                )
    channels, noted = aligned(series, source.where)
    return RawLog(channels, (*notices, *noted))


def _of_a_bus(name: str) -> bool:
    """A field of a frame (``CAN_ErrorFrame.ID``, ``0.CAN_DataFrame``), which is no measurement."""
    return any(part.startswith(_BUSES) for part in name.split("."))


def _has_frames(file: Any) -> bool:
    return any(c.name.startswith(_BUSES) for group in file.groups for c in group.channels)


def _signals(file: Any) -> list[Signal]:
    """Every channel of numbers but the clocks; a name that occurs twice goes with its group."""
    found = []
    for group, content in enumerate(file.groups):
        master = file.masters_db.get(group)
        for index, channel in enumerate(content.channels):
            if index != master and not channel.name.startswith(f"{_FRAMES}."):
                unit = file.get_channel_unit(group=group, index=index) or ""
                found.append((channel.name, unit, (group, index)))
    count = Counter(name for name, _, _ in found)
    return [
        Signal(name if count[name] == 1 else f"{key[0]}.{name}", unit, key)
        for name, unit, key in found
    ]


ASAM_MDF = Format(
    name="asam-mdf",
    matches=lambda source: source.head.startswith(_MDF),
    channels=TIDY_CHANNELS,
    read=_read_mdf,
    sign="discharge-positive",
    uses_dbc=True,
    isolated=True,
)
