"""Bags of ROS written by other libraries, read as logs; estimates read back by another one."""

from __future__ import annotations

import json
import sqlite3
import sys
from pathlib import Path

import numpy as np
import pytest

from cellwise.cli import main
from cellwise.errors import InputError
from cellwise.logs import read_log
from cellwise.notices import texts
from cellwise.report.viewer_files import write_mcap

mcap_writer = pytest.importorskip("mcap.writer")
typesys = pytest.importorskip("rosbags.typesys")
MESSAGE = "sensor_msgs/msg/BatteryState"
START_S, ROWS = 1_700_000_000, 120


def battery(store, k, *, volts=15.6, cells=4, stamped=True, amps=None):
    """Discharging by 4 A: negative in ROS."""
    types, nan = store.types, float("nan")
    stamp = types["builtin_interfaces/msg/Time"](START_S + k if stamped else 0, 500_000_000)
    return types[MESSAGE](
        header=types["std_msgs/msg/Header"](stamp, "base"), voltage=volts - 0.001 * k,
        temperature=nan, current=-4.0 - (k % 10) / 10 if amps is None else amps, charge=nan,
        capacity=5.0, design_capacity=5.0, percentage=0.7, power_supply_status=2,
        power_supply_health=1, power_supply_technology=2, present=True,
        cell_voltage=np.full(cells, volts / max(cells, 1), np.float32),
        cell_temperature=np.zeros(0, np.float32), location="", serial_number="1",
    )  # fmt: skip


def mcap(place, store, **topics):
    with place.open("wb") as file:
        writer = mcap_writer.Writer(file, chunk_size=4096)
        writer.start(profile="ros2")
        text = store.generate_msgdef(MESSAGE, ros_version=2)[0].encode()
        schema = writer.register_schema(MESSAGE, "ros2msg", text)
        other = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        noise = writer.register_channel("/chatter", "cdr", other)
        for name, options in topics.items():
            channel = writer.register_channel(f"/{name}", "cdr", schema)
            for k in range(ROWS):
                at = int(1e9) * (START_S + k) + 600_000_000
                data = store.serialize_cdr(battery(store, k, **options), MESSAGE)
                writer.add_message(channel, at, bytes(data), at)
                writer.add_message(noise, at, b"\x00\x01\x00\x00\x02\x00\x00\x00a\x00", at)
        writer.finish()
    return str(place)


@pytest.fixture(scope="module")
def store():
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def database(place, store):
    """As ROS 2 stores a bag by default."""
    with sqlite3.connect(place) as bag:
        bag.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT, "
                    "serialization_format TEXT, offered_qos_profiles TEXT)")  # fmt: skip
        bag.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, "
                    "timestamp INTEGER, data BLOB)")  # fmt: skip
        bag.execute("INSERT INTO topics VALUES(1, '/battery', ?, 'cdr', '')", (MESSAGE,))
        for k in range(ROWS):
            data = bytes(store.serialize_cdr(battery(store, k), MESSAGE))
            at = int(1e9) * (START_S + k)
            bag.execute("INSERT INTO messages VALUES(?, 1, ?, ?)", (k + 1, at, data))
    return str(place)


def bag1(place):
    from rosbags.rosbag1 import Writer

    old = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    with Writer(place) as writer:
        connection = writer.add_connection("/battery", MESSAGE, typestore=old)
        for k in range(ROWS):
            said = battery(Seq(old), k)
            data = old.serialize_ros1(said, MESSAGE)
            writer.write(connection, int(1e9) * (START_S + k), bytes(data))
    return str(place)


class Seq:
    """The types of ROS 1, whose header counts."""

    def __init__(self, store):
        header = store.types["std_msgs/msg/Header"]
        self.types = store.types | {
            "std_msgs/msg/Header": lambda stamp, frame: header(0, stamp, frame)
        }


@pytest.mark.parametrize("kind", ["mcap", "db3", "bag"])
def test_a_ros_bag_of_any_storage_reads_alike(kind, tmp_path, store):
    place = tmp_path / f"robot.{kind}"
    path = {"mcap": lambda: mcap(place, store, battery={}), "db3": lambda: database(place, store),
            "bag": lambda: bag1(place)}[kind]()  # fmt: skip
    log = read_log(path, series="auto")
    assert log.format == "ros-bag"
    assert len(log) == ROWS
    np.testing.assert_allclose(log.time_s, np.arange(ROWS), atol=1e-6)
    np.testing.assert_allclose(log.current_A, 4.0 + (np.arange(ROWS) % 10) / 10, rtol=1e-6)
    np.testing.assert_allclose(log.voltage_V, (15.6 - 0.001 * np.arange(ROWS)) / 4, rtol=1e-6)
    assert log.temperature_C is None


def test_the_battery_that_is_measured_is_read_and_another_on_demand(tmp_path, store):
    path = mcap(tmp_path / "two.mcap", store, aux={"amps": float("nan")},
                main={"stamped": False, "cells": 0})  # fmt: skip
    log = read_log(path)
    assert any("2 batteries (0: /aux, 1: /main); read number 1" in n for n in texts(log.notices))
    assert log.time_s[-1] == pytest.approx(ROWS - 1)  # by the time of the recording
    with pytest.raises(InputError, match="no battery 2"):
        read_log(path, instance=2)


def test_a_bag_that_is_cut_off_is_read_when_asked(tmp_path, store):
    whole = mcap(tmp_path / "whole.mcap", store, battery={})
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(Path(whole).read_bytes()[:-6000])
    with pytest.raises(InputError):
        read_log(str(cut))
    assert len(read_log(str(cut), partial=True)) > ROWS // 2


def test_a_library_that_is_not_there_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    columns = dict.fromkeys(("time_s", "soc", "current_A", "measured_voltage_V"), np.zeros(2))
    with pytest.raises(InputError, match="pip install 'mcap>="):
        write_mcap(tmp_path / "soc.mcap", columns)
    assert not (tmp_path / "soc.mcap").exists()


def test_a_bag_without_a_battery_is_refused(tmp_path, store):
    with pytest.raises(InputError, match="no topic of sensor_msgs/msg/BatteryState"):
        read_log(mcap(tmp_path / "none.mcap", store))


def test_estimates_are_topics_beside_the_log(tmp_path, store, capsys):
    """Written by the command, read by a library that decodes by the file's own definitions."""
    reading = pytest.importorskip("mcap.reader")
    decoding = pytest.importorskip("mcap_ros2.decoder")
    bag = mcap(tmp_path / "robot.mcap", store, battery={})
    out = tmp_path / "soc.mcap"
    code = main(["replay", "--model", "lipo-pouch", bag, "--series", "auto", "-o", str(out),
                 "--json"])  # fmt: skip
    printed = capsys.readouterr()
    assert code == 0, printed.err
    with out.open("rb") as file:
        found = list(
            reading.make_reader(
                file, decoder_factories=[decoding.DecoderFactory()]
            ).iter_decoded_messages()
        )
    states = [m for _, c, _, m in found if c.topic == "/cellwise/battery_state"]
    deviations = [m.data for _, c, _, m in found if c.topic == "/cellwise/soc_std"]
    assert len(states) == len(deviations) == ROWS
    last = states[-1]
    assert last.percentage == pytest.approx(json.loads(printed.out)["soc_final"], abs=1e-6)
    assert last.current == pytest.approx(-4.9)
    assert last.header.stamp.sec == START_S + ROWS - 1
    assert last.header.stamp.nanosec == pytest.approx(500_000_000, abs=1000)
    assert all(0.0 < d < 0.5 for d in deviations)
    layout = json.loads((tmp_path / "soc.foxglove.json").read_text())
    there = {c.topic for _, c, _, _ in found}
    paths = [p["value"].rpartition(".")[0] for v in layout["configById"].values()
             for p in v["paths"]]  # fmt: skip
    assert set(paths) - there == {"/cellwise/reference_soc"}
    again = read_log(str(out))  # and it is a log itself
    assert len(again) == ROWS
