"""Lines of JSON: any cut into pieces, garbage, units, packs."""

from __future__ import annotations

import json
import math
import sys
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwise.errors import InputError
from cellwise.live import Sample, Stray, open_source
from cellwise.live.source import JsonLines
from cellwise.logs.files.source import HEAD_BYTES, NOTHING_SAID, ReadOptions
from streams import Given


def found(text, *, pieces=None, options=NOTHING_SAID, sign="auto"):
    data = text.encode() if isinstance(text, str) else text
    source = JsonLines(Given(pieces or [data]), options, sign)
    return [s if s is None or isinstance(s, Stray) else s._replace(arrived_s=0.0) for s in source]


LINES = "".join(
    json.dumps({"time_s": k, "current_A": 0.5 * k, "voltage_V": 4.0 - 0.01 * k}) + "\n"
    for k in range(6)
)


def test_lines_become_samples_with_missing_values_as_nan():
    (one,) = found('{"time_s": 2, "current_A": 1.5, "voltage_V": null}\n')
    assert one[:2] == (2.0, 1.5)
    assert math.isnan(one.voltage_V)
    assert math.isnan(one.temperature_C)


@given(cuts=st.lists(st.integers(0, len(LINES)), max_size=12))
@settings(max_examples=60, deadline=None)
def test_any_cut_into_pieces_gives_the_same_samples(cuts):
    data = LINES.encode()
    edges = [0, *sorted(cuts), len(data)]
    pieces = [data[a:b] for a, b in pairwise(edges)]
    whole = [s[:3] for s in found(LINES)]
    assert len(whole) == 6
    assert [s[:3] for s in found(b"", pieces=pieces) if s is not None] == whole


@pytest.mark.parametrize(
    "garbage",
    ["{", "nonsense", "\x00\xff", "[1, 2]", "3", '{"time_s": 1}', '{"voltage_V": "high"}',
     '{"voltage_V": true}', "[" * 5000, '{"current_A": 1' + "0" * 400 + "}"],
)  # fmt: skip
def test_garbage_is_reported_and_passed_over(garbage):
    first, second, *_ = LINES.encode().splitlines(keepends=True)
    before, between, after = found(first + garbage.encode("latin-1") + b"\n" + second)
    assert isinstance(between, Stray)
    assert (before[0], after[0]) == (0.0, 1.0)


def test_a_line_without_an_end_does_not_fill_the_memory():
    pieces = [b"x" * 10_000] * (2 * HEAD_BYTES // 10_000 + 2) + [b"\n", LINES.encode()]
    kinds = [type(s) for s in found(b"", pieces=pieces) if s is not None]
    assert kinds.count(Sample) == 6
    assert 1 <= kinds.count(Stray) <= 4


def test_units_packs_and_signs():
    options = ReadOptions(series=4, parallel=2, channels={"current_mA": "I"})
    line = '{"time_ms": 1500, "I": -3000, "voltage_mV": 16000, "temperature_K": 298.15}\n'
    (one,) = found(line, options=options, sign="charge-positive")
    assert one[:4] == pytest.approx((1.5, 1.5, 4.0, 25.0))


@pytest.mark.parametrize(
    "told", ["", "serial:0", "json:", "can:", "can:virtual", "ulog:", "json:nowhere.jsonl"]
)
def test_a_source_that_is_none_is_refused(told):
    with pytest.raises(InputError):
        open_source(told)


@pytest.mark.parametrize(
    ("source", "module", "package"),
    [
        ("mavlink:udpin:127.0.0.1:0", "pymavlink.mavutil", "pymavlink"),
        ("mqtt://h/t", "paho.mqtt.client", "paho-mqtt"),
    ],
)
def test_a_library_that_is_not_there_is_named(source, module, package, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=f"pip install '{package}>="):
        open_source(source)


def test_options_that_a_stream_has_no_use_for_are_refused(tmp_path):
    dbc = tmp_path / "x.dbc"
    dbc.write_text("")
    for options in (ReadOptions(dbc=dbc), ReadOptions(instance=1), ReadOptions(series="auto"),
                    ReadOptions(channels={"current_kA": "I"})):  # fmt: skip
        with pytest.raises(InputError):
            open_source("stdin", options)


def table_of(mark=",", decimal=".", name="time_s"):
    rows = [f"{k}.0{mark}{0.5 * k}{mark}{4.0 - 0.01 * k:.2f}" for k in range(6)]
    return "\n".join([mark.join((name, "current_A", "voltage_V")), *rows]).replace(".", decimal)


@pytest.mark.parametrize(("mark", "decimal"), [(",", "."), (";", ","), ("\t", ".")])
def test_rows_below_a_header_are_the_same_samples(mark, decimal):
    assert [s[:3] for s in found(table_of(mark, decimal))] == [s[:3] for s in found(LINES)]


def test_an_empty_cell_is_missing_and_a_text_is_reported():
    one, two = found("time_s,current_A,voltage_V\n1,,3.9\n2,high,3.9\n")
    assert math.isnan(one.current_A)
    assert two == Stray("current_A is no number")


@pytest.mark.parametrize("name", ["time", "timestamp", "Timestamp"])
@pytest.mark.parametrize(
    "stamps",
    [(0.0, 2.0), (1.7e9, 1.7e9 + 2.0), (1.7e12, 1.7e12 + 2e3), (1.7e18, 1.7e18 + 2e9),
     ("2024-05-31T09:00:00Z", "2024-05-31T11:00:02+02:00"), ("2024-05-31 09:00:00",) * 1],
)  # fmt: skip
def test_a_stamp_without_a_unit_is_a_time_and_said(name, stamps):
    source = JsonLines(
        Given([json.dumps({name: t, "voltage_V": 3.9}).encode() + b"\n" for t in stamps]),
        NOTHING_SAID,
        "auto",
    )
    times = [s.time_s for s in source]
    assert times[-1] - times[0] == 2.0 * (len(stamps) - 1)
    assert f"'{name}'" in source.note


def test_a_stamp_that_is_none_is_reported_and_no_stamp_is_said():
    assert found('{"time": "soon", "voltage_V": 3.9}') == [Stray("time is no time")]
    source = JsonLines(Given([b'{"uptime": 5, "voltage_V": 3.9}']), NOTHING_SAID, "auto")
    assert len(list(source)) == 1
    assert "'uptime'" in source.note
