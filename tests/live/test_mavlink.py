"""MAVLink: a vehicle of pymavlink in loopback, a recorded tlog, what is sent back."""

from __future__ import annotations

import json
import math
import os
import socket
import struct
import threading
import time

import pytest

from cellwise.cli import main
from cellwise.errors import InputError
from cellwise.live import Sample, Stray, open_source
from cellwise.logs.files.source import ReadOptions

os.environ.setdefault("MAVLINK20", "1")
mavutil = pytest.importorskip("pymavlink.mavutil")
said = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")

UNKNOWN_MV, SYSTEM = 65_535, 7


def status(number=0, cells=(3900, 3910, 3890, 3900), current_cA=1500, warm_cdeg=3100):
    return said.MAVLink_battery_status_message(
        number, 0, 1, warm_cdeg, [*cells, *[UNKNOWN_MV] * (10 - len(cells))],
        current_cA, 120, -1, 80, 0, 1,
    )  # fmt: skip


def info(number=0, cells=4):
    text = b""
    return said.MAVLink_smart_battery_info_message(
        number, 0, 1, 5000, 5000, 3, text, text, 0, 0, 0, 0, cells_in_series=cells
    )


def packed(*messages):
    mav = said.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
    return [m.pack(mav) for m in messages]


def tlog(place, *timed):
    """A recording of (seconds, message or bytes)."""
    with place.open("wb") as file:
        for at, message in timed:
            data = message if isinstance(message, bytes) else packed(message)[0]
            file.write(struct.pack(">Q", int(at * 1e6)) + data)
    return f"mavlink:{place}"


def found(name, **options):
    source = open_source(name, ReadOptions(**options))
    items = list(source)
    source.close()
    return [i for i in items if isinstance(i, Sample)], [i for i in items if isinstance(i, Stray)]


def test_a_recording_gives_its_own_times_and_the_mean_cell(tmp_path):
    at = 1.7e9
    name = tlog(tmp_path / "a.tlog", (at, info()), (at + 0.5, status()),
                (at + 1.5, status(current_cA=-1, warm_cdeg=32_767)),
                (at + 2.0, status(number=1, cells=(8000,))))  # fmt: skip
    (first, second), stray = found(name, series=4)
    assert stray == []
    assert first[:4] == pytest.approx((at + 0.5, 15.0, 3.9, 31.0))
    assert second.time_s - first.time_s == pytest.approx(1.0, abs=1e-5)
    assert math.isnan(second.current_A)
    assert math.isnan(second.temperature_C)
    (other,), _ = found(name, series=2, instance=1)
    assert other.voltage_V == pytest.approx(4.0)


def test_the_battery_states_its_cells_in_series(tmp_path):
    name = tlog(tmp_path / "a.tlog", (1e9, status()), (1e9 + 1, info()), (1e9 + 2, status()))
    (one,), (early,) = found(name, series="auto")
    assert one.voltage_V == pytest.approx(3.9)
    assert "cells in series" in early.reason
    with pytest.raises(InputError, match="series=4"):
        found(name, series=3)


INFO_XML = """<?xml version="1.0"?><mavlink><messages><message id="372" name="BATTERY_INFO">
<description>Static</description>{}</message></messages></mavlink>"""
INFO_FIELDS = (
    *(("uint8_t", n) for n in ("id", "battery_function", "type", "state_of_health")),
    ("uint8_t", "cells_in_series"), ("uint16_t", "cycle_count"), ("uint16_t", "weight"),
    *(("float", f"{n}_voltage") for n in ("discharge_minimum", "charging_minimum",
                                          "resting_minimum", "charging_maximum")),
    ("float", "charging_maximum_current"), ("float", "nominal_voltage"),
    ("float", "discharge_maximum_current"), ("float", "discharge_maximum_burst_current"),
    ("float", "design_capacity"), ("float", "full_charge_capacity"),
    ("char[9]", "manufacture_date"), ("char[32]", "serial_number"), ("char[50]", "name"),
)  # fmt: skip


def test_a_battery_info_that_the_library_does_not_know_states_them_too(tmp_path, monkeypatch):
    """Packed by a dialect that the library's generator makes of the message's definition."""
    from pymavlink.generator import mavgen

    fields = "".join(f'<field type="{t}" name="{n}">x</field>' for t, n in INFO_FIELDS)
    (tmp_path / "info.xml").write_text(INFO_XML.format(fields))
    options = mavgen.Opts(str(tmp_path / "made_dialect"), "2.0", "Python3", validate=False)
    assert mavgen.mavgen(options, [str(tmp_path / "info.xml")])
    monkeypatch.syspath_prepend(tmp_path)
    import made_dialect

    vehicle = made_dialect.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
    message = made_dialect.MAVLink_battery_info_message(
        0, 0, 1, 98, 6, 40, 0, *[0.0] * 4, 10.0, 22.2, 0.0, 0.0, 5.0, 4.9, b"", b"7", b"a pack"
    )
    frame = bytes(message.pack(vehicle))
    damaged = frame[:20] + bytes([frame[20] ^ 1]) + frame[21:]
    cells = [3900] * 6
    name = tlog(tmp_path / "a.tlog", (1.7e9, damaged), (1.7e9 + 1, status(cells=cells)),
                (1.7e9 + 2, frame), (1.7e9 + 3, status(cells=cells)))  # fmt: skip
    (sample,), stray = found(name, series="auto")
    assert sample.voltage_V == pytest.approx(3.9)
    assert [s.reason for s in stray] == [
        "a battery whose cells in series no BATTERY_INFO has stated yet"
    ]
    with pytest.raises(InputError, match=r"BATTERY_INFO .* with 6 cells in series, 4 given"):
        found(name, series=4)


def test_cells_come_one_by_one(tmp_path):
    name = tlog(tmp_path / "a.tlog", (1e9, status()), (1e9 + 1, status(cells=(3900, 3910))))
    first, second = list(open_source(name, ReadOptions(series=4), cells=4))
    assert first.cell_V == pytest.approx((3.9, 3.91, 3.89, 3.9))
    assert second.cell_V == pytest.approx((3.9, 3.91, 3.89, 3.9))  # held for some seconds


def test_bytes_of_others_are_passed_over(tmp_path):
    name = tlog(tmp_path / "a.tlog", (1e9, status()), (1e9 + 1, b"\x01\x02garbage\xfe\x00"),
                (1e9 + 2, status()))  # fmt: skip
    good, stray = found(name, series=4)
    assert 1 <= len(good) <= 2
    assert stray


@pytest.mark.parametrize("place", ["udpin:nowhere.invalid:1", "udpin:127.0.0.1", "/dev/none,57600"])
def test_a_link_that_is_not_there_is_refused(place):
    with pytest.raises(InputError, match="udpin:HOST:PORT"):
        open_source(f"mavlink:{place}")


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


def test_a_vehicle_in_loopback_hears_its_state(capsys, tmp_path):
    """As a simulator sends: heartbeats, attitudes, two batteries, noise on the line."""
    place = f"udpin:127.0.0.1:{free_port()}"
    heard, over = [], threading.Event()

    def vehicle():
        link = mavutil.mavlink_connection(
            place.replace("udpin", "udpout"), source_system=SYSTEM, source_component=1,
            dialect="ardupilotmega",
        )  # fmt: skip
        until = time.monotonic() + 300.0  # kernels may have to be compiled first
        while not over.is_set() and time.monotonic() < until:
            link.mav.heartbeat_send(2, 3, 0, 0, 4)
            link.mav.attitude_send(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            link.mav.send(info())
            link.mav.send(status())
            link.mav.send(status(number=1, cells=(12_000,)))
            link.write(b"\x00noise\xfd")
            time.sleep(0.02)
            while (message := link.recv_match()) is not None:
                heard.append(message)
        link.close()

    thread = threading.Thread(target=vehicle)
    thread.start()
    try:
        code = main([
            "live", "--model", "lipo-pouch", "--source", f"mavlink:{place}", "--series", "auto",
            "--send", f"mavlink:{place}", "--send-every", "0", "--samples", "60", "--idle", "20",
            "--json",
        ])  # fmt: skip
    finally:
        time.sleep(0.1)
        over.set()
        thread.join()
    printed = capsys.readouterr()
    assert code == 0, printed.err
    end = json.loads(printed.out)
    assert end["samples"] == 60
    said_of = [m for m in heard if m.get_type() == "BATTERY_STATUS"]
    assert any(m.get_type() == "HEARTBEAT" for m in heard)
    assert len(said_of) >= 3
    last = said_of[-1]
    assert (last.get_srcSystem(), last.get_srcComponent()) == (SYSTEM, 180)
    assert last.id == 0
    assert sum(v for v in last.voltages if v != UNKNOWN_MV) == 15_600  # the pack's own, as it came
    assert last.current_battery == 1500
    assert last.battery_remaining == pytest.approx(100 * end["soc"], abs=0.51)
    assert last.time_remaining == pytest.approx(end["remaining_s"], abs=0.51)
    assert last.charge_state == said.MAV_BATTERY_CHARGE_STATE_OK
    assert last.fault_bitmask == 0


def test_faults_and_a_pack_that_another_source_measures(tmp_path):
    from cellwise.live.mavlink import MavlinkSender

    link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{(port := free_port())}")
    options = ReadOptions(series=20, parallel=2)
    sender = MavlinkSender(f"udpout:127.0.0.1:{port}", object(), options, least_A=0.1)
    row = {"soc": 0.0, "status": 16 | 512, "current_A": -2.0, "measured_voltage_V": 4.2}
    sender.send(row | {"remaining_s": math.inf, "temperature_C": math.nan})
    sender.close()
    message = link.recv_match(type="BATTERY_STATUS", blocking=True, timeout=5)
    link.close()
    assert message.voltages[:3] == [65_534, 18_466, UNKNOWN_MV]
    assert message.current_battery == -400
    assert message.time_remaining == 0  # not known
    assert message.charge_state == said.MAV_BATTERY_CHARGE_STATE_CHARGING
    assert message.fault_bitmask == (
        said.MAV_BATTERY_FAULT_DEEP_DISCHARGE
        | said.MAV_BATTERY_FAULT_SPIKES
        | said.MAV_BATTERY_FAULT_INCOMPATIBLE_VOLTAGE
    )
