"""A replay's rows for other viewers: MCAP and a layout of Foxglove.

`Foxglove <https://foxglove.dev>`_ opens the MCAP file beside the bag it came from: the stamps are
the bag's, and ``ros2 bag play`` plays it with its storage plugin for MCAP.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.files import write_atomically
from cellwise.logs.files.format import need
from cellwise.logs.formats.ros_bag import MESSAGE, PURPOSE
from cellwise.typing import FloatArray

NUMBER = "std_msgs/msg/Float64"
ROOT = "/cellwise"
BATTERY = f"{ROOT}/battery_state"
TIME = "time_s"
NOT_KNOWN = 0  # of status, health and technology


def write_mcap(path: str | Path, columns: Mapping[str, Any], start_s: float = 0.0) -> Path:
    """Write rows as topics: ``/cellwise/battery_state``, and a number for every other column.

    Parameters
    ----------
    path : str or Path    ends in ``.mcap``; it appears whole or not at all
    columns : mapping     arrays of one length, ``time_s``, ``soc``, ``current_A`` and
                          ``measured_voltage_V`` among them, discharge positive
    start_s : float       when ``time_s`` is 0 [s since 1970]

    Raises
    ------
    InputError            a library is missing, or the path cannot be written
    """
    writing = need("mcap.writer", PURPOSE, "mcap")
    typesys = need("rosbags.typesys", PURPOSE, "rosbags")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    arrays = {name: np.asarray(values, dtype=np.float64) for name, values in columns.items()}
    stamps = np.round((start_s + arrays[TIME]) * 1e9).astype(np.int64).tolist()
    others = {n: x for n, x in arrays.items() if n not in (TIME, "soc", "current_A")}

    def write(target: Path) -> None:
        with target.open("wb") as file:
            writer = writing.Writer(file)
            writer.start(profile="ros2", library="cellwise")

            def channel(topic: str, kind: str) -> int:
                text = store.generate_msgdef(kind, ros_version=2)[0].encode()
                if kind not in schemas:
                    schemas[kind] = writer.register_schema(kind, "ros2msg", text)
                return int(writer.register_channel(topic, "cdr", schemas[kind]))

            schemas: dict[str, int] = {}
            battery = channel(BATTERY, MESSAGE)
            numbers = [(channel(f"{ROOT}/{n}", NUMBER), x.tolist()) for n, x in others.items()]
            for k, at_ns in enumerate(stamps):
                said = _battery(store, arrays, k, at_ns)
                writer.add_message(battery, at_ns, store.serialize_cdr(said, MESSAGE), at_ns)
                for one, values in numbers:
                    # A float64 as CDR, little endian: a header of four bytes, the value.
                    data = struct.pack("<4Bd", 0, 1, 0, 0, values[k])
                    writer.add_message(one, at_ns, data, at_ns)
            writer.finish()

    return write_atomically(Path(path), write)


def write_foxglove(path: str | Path) -> Path:
    """Write a layout that plots what :func:`write_mcap` has written (JSON, whole or not at all)."""
    layout = (files("cellwise.report") / "foxglove.json").read_text(encoding="utf-8")
    return write_atomically(Path(path), layout)


def _battery(store: Any, arrays: Mapping[str, FloatArray], k: int, at_ns: int) -> Any:
    """A row as the message of ROS: charge positive, NaN where nothing was measured."""
    types, none = store.types, float("nan")
    stamp = types["builtin_interfaces/msg/Time"](at_ns // 1_000_000_000, at_ns % 1_000_000_000)
    empty = np.array([], dtype=np.float32)
    return types[MESSAGE](
        header=types["std_msgs/msg/Header"](stamp, ""),
        voltage=arrays["measured_voltage_V"][k],
        temperature=none,
        current=-arrays["current_A"][k],
        charge=none,
        capacity=none,
        design_capacity=none,
        percentage=arrays["soc"][k],
        power_supply_status=NOT_KNOWN,
        power_supply_health=NOT_KNOWN,
        power_supply_technology=NOT_KNOWN,
        present=True,
        cell_voltage=empty,
        cell_temperature=empty,
        location="",
        serial_number="",
    )
