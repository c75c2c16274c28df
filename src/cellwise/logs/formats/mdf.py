"""ASAM MDF: signals by unit and name, each group on its own clock; CAN frames with a DBC file."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.format import Format, library_at_work, need
from cellwise.logs.files.source import LogSource, RawLog
from cellwise.logs.vehicle.alignment import Series, aligned
from cellwise.logs.vehicle.signal_choice import CHOSEN, Signal, choose_signals

_MAGIC = (b"MDF     ", b"UnFinMF ")
_FRAMES = "CAN_DataFrame"
_BUSES = ("CAN_", "LIN_")  # groups of frames, as the standard names them


def _read(source: LogSource, known: Format) -> RawLog:
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
                    "Choose another DBC file, or omit `dbc=...`.",
                )
        elif (signals or _has_frames(file)) and all(_of_a_bus(s.name) for s in signals):
            raise InputError(
                f"CAN frames only in {source.where}",
                "the database that describes them",
                "Give it with `dbc=FILE.dbc`.",
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
    matches=lambda source: source.head.startswith(_MAGIC),
    channels=CHOSEN,
    read=_read,
    sign="discharge-positive",
    uses_dbc=True,
    isolated=True,
)
