"""Bluetooth: a device of the library's own kind, without a radio; skipped below Python 3.12."""

from __future__ import annotations

import math

import pytest

from cellwise.errors import InputError
from cellwise.live.samples import Sample, Stray
from cellwise.live.source import open_source
from cellwise.logs.files.source import ReadOptions

PACK = ReadOptions(series=4, parallel=2)


@pytest.fixture
def radio(monkeypatch):
    """Two devices in reach, of which one is a battery management system of the library."""
    pytest.importorskip("aiobmsble", reason="aiobmsble asks for Python 3.12")
    import bleak
    from aiobmsble.bms import dummy_bms
    from bleak.backends.device import BLEDevice
    from bleak.backends.scanner import AdvertisementData

    answers = [
        {"voltage": 13.2, "current": -3.0, "temp_values": [25.5], "cell_voltages": [3.3] * 4},
        TimeoutError("no frame"),
        {"voltage": 13.6, "current": 1.0},
    ]

    async def answer(self):
        found = answers.pop(0)
        if isinstance(found, Exception):
            raise found
        return dict(found)

    async def nothing(self, *_):
        return None

    monkeypatch.setattr(dummy_bms.BMS, "_async_update", answer)
    monkeypatch.setattr(dummy_bms.BMS, "_connect", nothing)

    async def discover(**_):
        def seen(name):
            return AdvertisementData(name, {}, {}, [], None, -60, ())

        places = {"AA:00:00:00:00:01": "dummy", "AA:00:00:00:00:02": "a lamp"}
        return {
            a: (BLEDevice(a, n, {"path": f"/{n}", "props": {}}), seen(n)) for a, n in places.items()
        }

    monkeypatch.setattr(bleak.BleakScanner, "discover", discover)
    monkeypatch.setattr("cellwise.live.ble.EVERY_S", 0.0)


def test_a_device_by_its_name_is_read_cell_by_cell(radio):
    stream = open_source("ble:dummy", PACK, cells=4)
    found = [one for _, one in zip(range(3), stream, strict=False)]
    stream.close()
    first, missed, last = found
    assert isinstance(first, Sample)
    assert (first.current_A, first.voltage_V) == (1.5, pytest.approx(3.3))  # discharge: positive
    assert first.temperature_C == 25.5
    assert first.cell_V == (3.3,) * 4
    assert missed == Stray("no answer")
    assert last.current_A == -0.5
    assert math.isnan(last.temperature_C)


@pytest.mark.parametrize(
    ("place", "said"), [("a lamp", "does not know"), ("AA:00:00:00:00:09", "one of a lamp, dummy")]
)
def test_a_device_that_is_no_battery_is_refused(radio, place, said):
    with pytest.raises(InputError, match=said):
        open_source(f"ble:{place}", PACK)


def test_without_the_library_what_is_missing_is_named(monkeypatch):
    def gone(name):
        raise ModuleNotFoundError(f"No module named '{name}'", name="aiobmsble")

    monkeypatch.setattr("cellwise.logs.files.format.import_module", gone)
    with pytest.raises(InputError, match=r"library aiobmsble, from Python 3.12 on"):
        open_source("ble:dummy", PACK)
