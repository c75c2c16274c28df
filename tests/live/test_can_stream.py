"""CAN: frames encoded by the database library on a virtual bus, SOC sent back and decoded."""

from __future__ import annotations

import math
import uuid

import pytest

from cellwise.errors import InputError
from cellwise.live import Sample, Stray, open_source
from cellwise.live.can_stream import SocSender
from cellwise.logs.files.source import ReadOptions
from streams import DBC

can = pytest.importorskip("can")
cantools = pytest.importorskip("cantools")


@pytest.fixture
def dbc(tmp_path):
    (tmp_path / "bms.dbc").write_text(DBC)
    return tmp_path / "bms.dbc"


@pytest.fixture
def joined(dbc):
    """A stream, a bus to send on, and a way to send a message by its signals."""
    channel = uuid.uuid4().hex
    stream = open_source(f"can:virtual:{channel}", ReadOptions(dbc=dbc, series=100, parallel=2))
    bus = can.Bus(interface="virtual", channel=channel, preserve_timestamps=True)
    database = cantools.database.load_file(str(dbc))

    def send(message, at, **signals):
        found = database.get_message_by_name(message)
        full = {s.name: 0 for s in found.signals} | signals
        bus.send(
            can.Message(
                arbitration_id=found.frame_id,
                is_extended_id=found.is_extended_frame,
                data=found.encode(full, strict=False),
                timestamp=at,
            )
        )

    yield stream, bus, send, database
    stream.close()
    bus.shutdown()


def taken(stream):
    """What has come so far."""
    found = []
    for item in stream:
        if item is None and stream.bus.queue.empty():
            return found
        if item is not None:
            found.append(item)
    return found


def test_a_sample_for_each_voltage_with_the_mean_current_since_the_last(joined):
    stream, _, send, _ = joined
    send("BMS_Thermal", 99.0, BatteryTemp=21)
    send("BMS_Voltage", 100.0, PackVoltage=380.0)
    for k, amps in enumerate((10.0, 20.0, 60.0)):
        send("BMS_Pack", 100.2 + 0.1 * k, PackCurrent=amps)
    send("BMS_Voltage", 100.5, PackVoltage=375.0)
    send("BMS_Voltage", 101.0, PackVoltage=374.0)
    first, second, third = taken(stream)
    assert math.isnan(first.current_A)
    assert first.temperature_C == 21.0
    assert second[:3] == pytest.approx((100.5, 15.0, 3.75))
    assert third.current_A == pytest.approx(30.0)  # none has come since: the last one


def test_a_current_that_has_stopped_is_missing_and_so_is_a_voltage(joined):
    stream, _, send, _ = joined
    send("BMS_Pack", 10.0, PackCurrent=10.0)
    send("BMS_Voltage", 10.1, PackVoltage=380.0)
    send("BMS_Voltage", 12.0, PackVoltage=380.0)
    for k in range(30):
        send("BMS_Pack", 12.1 + 0.1 * k, PackCurrent=40.0)
    first, second, *rest = taken(stream)
    assert first.current_A == pytest.approx(5.0)
    assert math.isnan(second.current_A)
    assert 2 <= len(rest) <= 3  # once a second, without a voltage
    assert all(math.isnan(s.voltage_V) and s.current_A == pytest.approx(20.0) for s in rest)


def test_values_outside_the_range_of_the_database_are_missing(joined):
    stream, _, send, _ = joined
    send("BMS_Pack", 1.0, PackCurrent=320.0)
    send("BMS_Voltage", 1.0, PackVoltage=6553.5)
    (sample,) = taken(stream)
    assert math.isnan(sample.current_A)
    assert math.isnan(sample.voltage_V)


def test_unknown_and_broken_frames_are_survived(joined):
    stream, bus, send, _ = joined
    bus.send(can.Message(arbitration_id=0x7FF, data=b"\x01\x02", is_extended_id=False))
    bus.send(can.Message(arbitration_id=257, data=b"\x01", is_extended_id=False))
    bus.send(can.Message(arbitration_id=257, data=b"", is_remote_frame=True, is_extended_id=False))
    bus.send(can.Message(is_error_frame=True))
    send("BMS_Pack", 1.0, PackCurrent=1.0)
    send("BMS_Voltage", 1.0, PackVoltage=370.0)
    found = taken(stream)
    assert [type(f) for f in found] == [Stray, Sample]


@pytest.mark.parametrize("target", ["Cellwise.Charge", "Nobody.Soc", "Soc", ""])
def test_a_signal_that_is_not_there_is_refused(joined, target):
    with pytest.raises(InputError, match=r"Cellwise\.Soc"):
        SocSender(joined[0], target)


def test_a_wrong_database_or_bus_is_refused(tmp_path, dbc):
    wrong = tmp_path / "wrong.dbc"
    wrong.write_text(
        'VERSION ""\nBU_: X\nBO_ 1 Motor: 2 X\n SG_ Speed : 0|16@1+ (1,0) [0|0] "rpm" X\n'
    )
    (tmp_path / "none.dbc").write_bytes(b"\x00\x01garbage")
    for path in (wrong, tmp_path / "none.dbc"):
        with pytest.raises(InputError):
            open_source("can:virtual:a", ReadOptions(dbc=path))
    with pytest.raises(InputError, match="`dbc="):
        open_source("can:virtual:a")
    with pytest.raises(InputError, match="no bus"):
        open_source("can:telepathy:a", ReadOptions(dbc=dbc))
