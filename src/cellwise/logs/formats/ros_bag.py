"""Bags of ROS: MCAP, ROS 2 ``.db3``, ROS 1 ``.bag`` with ``sensor_msgs/BatteryState``, no ROS.

The message is laid out at https://docs.ros.org/en/rolling/p/sensor_msgs/msg/BatteryState.html:
current negative when discharging, NaN where nothing was measured. Its ``charge`` and
``percentage`` are the battery's own estimates, no counter.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.format import Format, chosen_battery, cut_off, library_at_work, need
from cellwise.logs.files.source import LogSource, RawLog
from cellwise.logs.files.tables import channels_of
from cellwise.logs.formats.column_maps import mapped
from cellwise.notices import Notice
from cellwise.typing import FloatArray

MCAP_MAGIC, SQLITE_MAGIC, BAG_MAGIC = b"\x89MCAP0\r\n", b"SQLite format 3\0", b"#ROSBAG V2.0\n"
MESSAGE = "sensor_msgs/msg/BatteryState"
FIELDS = ("voltage", "current", "temperature")
PURPOSE = "a bag of ROS"


def _read(source: LogSource, known: Format) -> RawLog:
    topics = battery_topics(source)
    if not topics:
        raise InputError(
            f"no topic of {MESSAGE} in {source.where}",
            "a bag of a robot that publishes its battery",
            "Record that topic, or choose another log.",
        )
    chosen, notices = _choose(topics, source)
    arrays, cells = topics[chosen]
    raw = channels_of(arrays, source, known, cells)
    channels = {f: x for f, x in raw.channels.items() if f != "temperature_C" or _known(x)}
    return RawLog(channels, (*raw.notices, *notices), raw.cells)


def battery_topics(source: LogSource) -> dict[str, tuple[dict[str, FloatArray], int | None]]:
    """Columns of every battery's topic, and its cells in series where they are there.

    ``time_s`` is that of the headers [s since 1970], of the recording where they have none.
    """
    rows: dict[str, list[tuple[float, ...]]] = {}
    cells: dict[str, int] = {}
    for topic, at_ns, message in _messages(source):
        stamp = message.header.stamp
        stamped_s = stamp.sec + 1e-9 * stamp.nanosec
        values = (float(getattr(message, name, np.nan)) for name in FIELDS)
        rows.setdefault(topic, []).append((stamped_s, 1e-9 * at_ns, *values))
        cells[topic] = max(cells.get(topic, 0), len(message.cell_voltage))
    found = {}
    for topic in sorted(rows):
        stamped_s, recorded_s, *columns = np.array(rows[topic]).T
        moves = bool(np.all(np.diff(stamped_s) >= 0.0)) and stamped_s[-1] > stamped_s[0] > 0.0
        arrays = {"time_s": stamped_s if moves else recorded_s}
        found[topic] = arrays | dict(zip(FIELDS, columns, strict=True)), cells[topic] or None
    return found


def start_of(source: LogSource) -> float:
    """When the log of a bag begins [s since 1970]: the time that its rows count from."""
    topics = battery_topics(source)
    return float(topics[_choose(topics, source)[0]][0]["time_s"][0])


def is_bag(source: LogSource) -> bool:
    """MCAP, ROS 2 or ROS 1 by its first bytes."""
    if source.head.startswith(SQLITE_MAGIC):
        return b"serialization_format" in source.head  # a column of its table of topics
    return source.head.startswith((MCAP_MAGIC, BAG_MAGIC))


def _choose(topics: dict[str, Any], source: LogSource) -> tuple[str, list[Notice]]:
    """The battery that was asked for, else the first that was measured."""
    names = dict(enumerate(topics))
    live = [k for k, n in names.items() if all(map(_known, map(topics[n][0].get, FIELDS[:2])))]
    chosen, notices = chosen_battery(names, live, source)
    return names[chosen], notices


def _known(values: FloatArray) -> bool:
    return bool(np.isfinite(values).any())


def _messages(source: LogSource) -> Iterator[tuple[str, int, Any]]:
    """Topic, time of recording [ns] and content of every battery message."""
    typesys = need("rosbags.typesys", PURPOSE, "rosbags")
    if source.head.startswith(MCAP_MAGIC):
        yield from _of_mcap(source, typesys)
    elif source.head.startswith(BAG_MAGIC):
        with library_at_work(source, "bag"):
            highlevel = need("rosbags.highlevel", PURPOSE, "rosbags")
            with highlevel.AnyReader([Path(source.path)]) as reader:
                wanted = [c for c in reader.connections if c.msgtype == MESSAGE]
                for connection, at_ns, data in reader.messages(wanted) if wanted else ():
                    yield connection.topic, at_ns, reader.deserialize(data, MESSAGE)
    else:
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        with library_at_work(source, "bag"), closing(_database(source)) as database:
            asked = "SELECT name, timestamp, data FROM messages JOIN topics ON topics.id = topic_id"
            for topic, at_ns, data in database.execute(
                f"{asked} WHERE type = ? ORDER BY timestamp", (MESSAGE,)
            ):
                yield topic, at_ns, store.deserialize_cdr(data, MESSAGE)


def _database(source: LogSource) -> sqlite3.Connection:
    return sqlite3.connect(f"{Path(source.path).resolve().as_uri()}?mode=ro", uri=True)


def _of_mcap(source: LogSource, typesys: Any) -> Iterator[tuple[str, int, Any]]:
    """As `_messages`; the definition of the message is the one in the file."""
    reading = need("mcap.reader", PURPOSE, "mcap")
    errors = need("mcap.exceptions", PURPOSE, "mcap")
    stores: dict[int, Any] = {}
    with library_at_work(source, "bag"), source.open() as file:
        whole = not source.options.partial
        reader = reading.make_reader(file) if whole else reading.NonSeekingReader(file)
        try:
            topics = None
            if whole and (summary := reader.get_summary()) is not None:
                ids = {k for k, s in summary.schemas.items() if s.name == MESSAGE}
                topics = [c.topic for c in summary.channels.values() if c.schema_id in ids]
            if topics == []:
                return
            for schema, channel, message in reader.iter_messages(topics, log_time_order=whole):
                if schema is None or schema.name != MESSAGE:
                    continue
                if schema.id not in stores:
                    stores[schema.id] = _store(typesys, schema)
                found = stores[schema.id].deserialize_cdr(message.data, MESSAGE)
                yield channel.topic, message.log_time, found
        except errors.EndOfFile as error:
            if whole:
                raise cut_off(source, "bag") from error


def _store(typesys: Any, schema: Any) -> Any:
    if schema.encoding != "ros2msg":
        return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(typesys.get_types_from_msg(schema.data.decode(), MESSAGE))
    return store


ROS_BAG = mapped("ros-bag", matches=is_bag, read=_read, instances=True, isolated=True)
