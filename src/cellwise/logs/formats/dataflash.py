"""ArduPilot dataflash ``.bin``: ``BAT`` (older ``CURR``, ``BAT2``), discharge positive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.format import Format, cut_off, library_at_work, need
from cellwise.logs.files.named_columns import channels_of
from cellwise.logs.files.source import LogSource, RawLog
from cellwise.logs.formats.column_maps import mapped
from cellwise.typing import FloatArray

_MAGIC = b"\xa3\x95\x80"
# Message to the battery it is of; None: the message says it itself.
_MESSAGES: dict[str, int | None] = {"BAT": None, "BAT2": 1, "CURR": 0, "CUR2": 1, "CURR2": 1}
_INSTANCE = ("Inst", "Instance", "I")
_CENTI = ("Volt", "VoltR", "Curr", "Volt2")
_INTEGERS = "bBhHiIqQ"


def _read(source: LogSource, known: Format) -> RawLog:
    reader = need("pymavlink.DFReader", "an ArduPilot dataflash log")
    with library_at_work(source, "dataflash log"):
        log = reader.DFReader_binary(str(source.path))
        there = {f.name: f for f in log.formats.values()}
        wanted = [name for name in _MESSAGES if name in there]
        whole = _is_whole(log)
        rows = _rows(log, wanted, source) if whole or source.options.partial else {}
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
    chosen = batteries[0] if source.options.instance is None else source.options.instance
    if chosen not in batteries:
        raise InputError(
            f"no battery {chosen} in {source.where}, which has {', '.join(map(str, batteries))}",
            "the number of a battery that is there",
            "Choose one of them with `instance=K`.",
        )
    # BAT stands beside the older messages where a log has both.
    name = next(n for n in wanted if (n, chosen) in rows)
    arrays = _columns(there[name], rows[name, chosen])
    raw = channels_of(arrays, source, known)
    notices = list(raw.notices)
    if len(batteries) > 1:
        notices.append(f"batteries {batteries}; read number {chosen}; `instance=K` reads another")
    if not whole:
        notices.append("the dataflash log is cut off; it was read as far as it goes")
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


def _rows(
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
    table = np.array(
        [[np.nan if not _is_number(x) else x for x in row] for row in rows], dtype=float
    )
    columns = {}
    for k, (name, code) in enumerate(zip(layout.columns, layout.format, strict=False)):
        values = table[:, k]
        columns[name] = 0.01 * values if name in _CENTI and code in _INTEGERS else values
    return columns


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float))


def _measured(channels: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Channels without the optional ones that are zero throughout: not measured."""
    optional = ("temperature_C", "charge_Ah")
    return {f: x for f, x in channels.items() if f not in optional or np.nan_to_num(x).any()}


ARDUPILOT_DATAFLASH = mapped(
    "ardupilot-dataflash",
    matches=lambda source: source.head.startswith(_MAGIC),
    read=_read,
    instances=True,
    isolated=True,
)
