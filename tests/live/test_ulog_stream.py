"""A ULog as it comes: the library for whole files as oracle, damage, growing files."""

from __future__ import annotations

import math
import struct
from itertools import pairwise

import numpy as np
import pytest

from cellwise.live import Sample
from cellwise.live.samples import Pieces
from cellwise.live.ulog_stream import UlogStream, layout_of
from cellwise.logs.files.source import ReadOptions
from streams import Given
from vehicle_files import write_ulog


def stream(pieces, **options):
    return UlogStream(Given(pieces), ReadOptions(**options), "auto")


def samples(source):
    return [s for s in source if isinstance(s, Sample)]


def battery(rows=200, volts=15.2):
    t = np.arange(float(rows))
    return {
        "time_s": t,
        "voltage_V": volts - 0.01 * t,
        "current_A": 10.0 + np.sin(t),
        "ampere_hours": t / 360.0,
        "temperature_C": np.full(rows, 31.0),
    }


def cut(data, seed):
    edges = np.sort(np.random.default_rng(seed).integers(0, len(data), 40))
    edges = [0, *edges.tolist(), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


@pytest.mark.parametrize("seed", range(2))
def test_a_written_log_comes_whole_whatever_the_pieces(tmp_path, seed):
    c = battery()
    data = write_ulog(tmp_path / "a.ulg", [c]).read_bytes()
    found = samples(stream(cut(data, seed), series=4))
    np.testing.assert_allclose([s.time_s for s in found], c["time_s"] + 20.0, atol=1e-6)
    np.testing.assert_allclose([s.voltage_V for s in found], c["voltage_V"] / 4, rtol=1e-6)
    np.testing.assert_allclose([s.current_A for s in found], c["current_A"], rtol=1e-6)
    assert found[0].temperature_C == 31.0


def test_a_flight_of_px4_is_what_its_library_reads(real_data):
    pyulog = pytest.importorskip("pyulog")
    path = real_data / "native" / "px4_pyulog_sample_log_small.ulg"
    for instance in (0, 1):
        topic = [
            d
            for d in pyulog.ULog(str(path), ["battery_status"]).data_list
            if d.multi_id == instance
        ]
        if not topic:
            continue
        found = samples(stream(cut(path.read_bytes(), instance), instance=instance))
        assert len(found) == topic[0].data["timestamp"].size
        volts = topic[0].data["voltage_v"].astype(float)
        np.testing.assert_allclose(
            [s.voltage_V for s in found], np.where(volts == 0.0, np.nan, volts)
        )


def test_the_first_battery_that_is_connected_is_read(tmp_path):
    data = write_ulog(tmp_path / "two.ulg", [battery(volts=0.0) | {"voltage_V": np.zeros(200)},
                                             battery(volts=12.0)]).read_bytes()  # fmt: skip
    found = samples(stream([data]))
    assert len(found) == 200
    assert found[0].voltage_V == pytest.approx(12.0, rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_bytes_that_are_lost_or_turned_cost_only_their_neighbours(tmp_path, seed):
    c = battery(rows=400)
    data = bytearray(write_ulog(tmp_path / "a.ulg", [c]).read_bytes())
    rng = np.random.default_rng(seed)
    start = len(data) - 400 * 34 + 500
    for at in rng.integers(start, len(data) - 4000, 4):
        if rng.random() < 0.5:
            data[at] ^= int(rng.integers(1, 256))
        else:
            del data[at : at + int(rng.integers(1, 30))]
    source = stream(cut(bytes(data), seed))
    found = list(source)
    good = [s for s in found if isinstance(s, Sample)]
    assert len(good) >= 385
    known = set(np.round(c["time_s"] + 20.0, 6))
    assert sum(round(s.time_s, 6) in known for s in good) >= len(good) - 4
    assert good[-1].time_s == pytest.approx(c["time_s"][-1] + 20.0)


def test_a_file_that_grows_is_followed(tmp_path):
    data = write_ulog(tmp_path / "whole.ulg", [battery(rows=60)]).read_bytes()
    growing = tmp_path / "growing.ulg"
    growing.write_bytes(data[: len(data) // 2 + 7])
    source = UlogStream(Pieces(str(growing), follow=True), ReadOptions(), "auto")
    seen = 0
    for item in source:
        if item is None and seen < 60:
            with growing.open("ab") as file:
                file.write(data[len(data) // 2 + 7 :])
        seen += isinstance(item, Sample)
        if seen == 60:
            break
    source.close()
    assert seen == 60


def test_unknown_values_are_missing(tmp_path):
    c = battery(rows=3)
    c["current_A"] = np.array([1.0, -1.0, 2.0])
    found = samples(stream([write_ulog(tmp_path / "a.ulg", [c]).read_bytes()]))
    assert math.isnan(found[1].current_A)


def test_fields_of_any_order_and_padding_are_found():
    fields = "float[2] other;float current_a;uint64_t timestamp;bool connected;"
    assert layout_of(fields) is None  # no voltage
    layout = layout_of(f"{fields}float voltage_v;uint8_t[3] _padding0;")
    body = struct.pack("<2ffQ?f", 9, 9, 5.0, 7_000_000, True, 3.7)
    assert np.frombuffer(body, layout)["timestamp"] == 7_000_000
