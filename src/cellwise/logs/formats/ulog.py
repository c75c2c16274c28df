"""PX4 ULog: the topic ``battery_status``, one instance per battery, discharge positive."""

from __future__ import annotations

from typing import IO, Any

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.format import Format, cut_off, library_at_work, need
from cellwise.logs.files.named_columns import channels_of
from cellwise.logs.files.source import LogSource, RawLog
from cellwise.logs.formats.column_maps import mapped
from cellwise.typing import FloatArray

MAGIC = b"ULog\x01\x12\x35"
TOPIC = "battery_status"
_HEADER_BYTES = 3  # of a message; where one would begin, a file may end
# The code of "unknown", by the message's definition.
UNKNOWN = {
    "voltage_v": (-1.0, 0.0),
    "current_a": (-1.0,),
    "discharged_mah": (-1.0,),
    "temperature": (-1.0, -273.15),
}


def _read(source: LogSource, known: Format) -> RawLog:
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
    chosen, notices = _choose(found, source)
    data = found[chosen].data
    arrays = {name: _without_unknown(name, values) for name, values in data.items()}
    start = arrays["timestamp"][0] if arrays["timestamp"].size else 0.0
    arrays["timestamp"] = arrays["timestamp"] - start
    raw = channels_of(arrays, source, known, _cells(data))
    if watched.ended_within:
        notices.append("the ULog is cut off; it was read as far as it goes")
    if log.file_corruption:
        notices.append("the ULog is damaged in places; what could not be read was passed over")
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


def _choose(found: dict[int, Any], source: LogSource) -> tuple[int, list[str]]:
    """The battery that was asked for, else the first that is connected and measured."""
    stated = source.options.instance
    if stated is not None and stated not in found:
        raise InputError(
            f"no battery {stated} in {source.where}, but {', '.join(map(str, sorted(found)))}",
            "the number of a battery that is there",
            "Choose one of them with `instance=K`.",
        )
    live = [k for k in sorted(found) if _is_measured(found[k].data)]
    chosen = stated if stated is not None else (live or sorted(found))[0]
    if len(found) == 1:
        return chosen, []
    typical = ", ".join(f"{k}: {_typical(found[k].data):.1f} V" for k in sorted(found))
    said = f"{len(found)} batteries ({typical}); read number {chosen}; `instance=K` reads another"
    return chosen, [said]


def _is_measured(data: dict[str, Any]) -> bool:
    connected = np.any(data["connected"]) if "connected" in data else True
    current = _without_unknown("current_a", data.get("current_a", np.array([-1.0])))
    voltage = _without_unknown("voltage_v", data.get("voltage_v", np.array([0.0])))
    return bool(connected and np.any(np.isfinite(current)) and np.any(np.isfinite(voltage)))


def _typical(data: dict[str, Any]) -> float:
    return float(np.median(data["voltage_v"])) if len(data.get("voltage_v", ())) else 0.0


def _without_unknown(name: str, values: Any) -> FloatArray:
    """Values with the code of "unknown" as NaN."""
    array: FloatArray = np.asarray(values, dtype=np.float64)
    for mark in UNKNOWN.get(name, ()):
        array = np.where(np.isclose(array, mark), np.nan, array)
    return array


def _measured(channels: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Channels without the optional ones that were never measured."""
    optional = ("temperature_C", "charge_Ah")
    return {f: x for f, x in channels.items() if f not in optional or np.any(np.isfinite(x))}


def _cells(data: dict[str, Any]) -> int | None:
    counts = np.asarray(data.get("cell_count", ()))
    return int(counts[-1]) if counts.size and counts[-1] > 0 else None


PX4_ULOG = mapped(
    "px4-ulog",
    matches=lambda source: source.head.startswith(MAGIC),
    read=_read,
    instances=True,
    isolated=True,
)
