"""What `inspect_log` says: the contract's keys, the data sets' own tables, every oddity."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from cellwise.logs import CellLog, inspect_log, read_log
from cellwise.notices import texts
from log_files import pulse_channels

CONTRACT = ["format", "samples", "duration_s", "sign", "gaps", "duplicates", "current_A"]
CONTRACT += ["voltage_V", "temperature_C", "charge_Ah", "notices"]


def pulses(**change) -> CellLog:
    columns = pulse_channels(6000)
    columns.update({k: np.asarray(v) for k, v in change.items()})
    return CellLog.from_table(columns)


def told(log: CellLog, *words: str) -> bool:
    """One notice holds all the words."""
    return any(all(word in n for word in words) for n in texts(inspect_log(log).notices))


def test_the_contracts_keys_as_json():
    columns = pulse_channels(6000)
    columns["time_s"] = columns["time_s"] + np.where(columns["time_s"] > 3000, 5000.0, 0.0)
    found = inspect_log(CellLog.from_table(columns)).to_dict()
    again = json.loads(json.dumps(found, allow_nan=False))
    for key in CONTRACT:
        assert key in again
    assert again["samples"] == 6000
    assert again["duration_s"] == 10999.0
    assert again["sign"] == "verified"
    assert again["duplicates"] == 0
    for key in ("current_A", "voltage_V", "temperature_C"):
        assert set(again[key]) == {"min", "max"}
    assert again["current_A"] == {"min": -1.5, "max": 3.0}
    assert again["gaps"] == [{"start_s": 3000.0, "duration_s": 5001.0, "charge_Ah": 0.0}]
    assert again["charge_Ah"] == pytest.approx(20 * 150 / 3600)
    assert all(isinstance(notice, str) for notice in again["notices"])


def test_a_clean_log_has_nothing_to_tell():
    assert inspect_log(pulses()).notices == ()


def test_gap_repeated_stamps_missing_values():
    columns = pulse_channels(6000)
    time = columns["time_s"] + np.where(columns["time_s"] > 3000, 86400.0 * 3, 0.0)
    time[100] = time[99]
    current = columns["current_A"].copy()
    current[10:15] = np.nan
    log = pulses(time_s=time, current_A=current)
    assert told(log, "gap of 3.0 d", "3000.0 s", "counter moved by 0.0000 Ah")
    assert told(log, "1 row(s) repeat the time")
    assert told(log, "5 of 6000 rows without current_A")
    found = inspect_log(log)
    assert found.duplicates == 1
    assert found.missing["current_A"] == 5


def test_undetermined_sign_says_why():
    log = CellLog(np.arange(100.0), np.zeros(100), np.full(100, 3.7))
    assert inspect_log(log).sign == "undetermined"
    assert told(log, "could not be determined", "at rest")


def test_no_rest_and_a_first_row_under_load():
    time = np.arange(0.0, 3000.0, 1.0)
    current = 2.0 + np.sin(time / 7)
    voltage = 4.1 - 0.05 * current - time / 5000
    log = CellLog(time, current, voltage)
    assert told(log, "no rest of a minute")
    assert told(log, "first row is under load")
    assert not told(pulses(), "no rest")


def test_rests_have_start_length_and_last_voltage():
    log = pulses()
    rests = inspect_log(log).rests
    first = rests[0]
    assert first.start_s == 0.0
    assert first.duration_s == 99.0
    assert first.voltage_V == log.voltage_V[99]
    # Each later period rests 100 s before its pulse after 80 s at the end of the one before.
    assert [r.duration_s for r in rests[1:3]] == [180.0, 180.0]


def test_counter_that_disagrees():
    columns = pulse_channels(6000)
    assert told(pulses(ampere_hours=1.01 * columns["ampere_hours"]), "differs from the summed")
    mismatch = inspect_log(pulses(ampere_hours=1.01 * columns["ampere_hours"]))
    assert mismatch.counter_mismatch_percent == pytest.approx(100 * 0.01 * 150 / 210)


def test_stuck_voltage_but_not_a_voltage_held_by_the_tester():
    log = pulses()
    voltage = log.voltage_V.copy()
    voltage[:4500] = voltage[0]
    assert told(replace(log, voltage_V=voltage), "voltage_V stands still", "75.0 min")
    time = np.arange(0.0, 6000.0, 1.0)
    current = np.where(time < 2000, -1.5, -1.5 * np.exp(-(time - 2000) / 800))
    held = np.minimum(3.7 + 0.25e-3 * time, 4.2)
    assert inspect_log(CellLog(time, current, held)).stuck == {}


def test_stuck_current_but_not_a_constant_current():
    log = pulses()
    current = log.current_A.copy()
    current[1500:5500] = 0.0
    assert told(replace(log, current_A=current), "current_A stands still")
    time = np.arange(0.0, 3000.0, 1.0)
    falling = CellLog(time, np.full(3000, 3.0), 4.0 - 1e-4 * time - 0.5 * (time / 3000) ** 9)
    assert inspect_log(falling).stuck == {}


ROW = re.compile(r"^\| ([a-z]\w+) \| (\d+) \| ([\d.]+) \| ([\d.]+) / ([\d.]+) \| (.*) \|$")
FOLDERS = ["panasonic_18650pf", "plett_a123", "nissan_leaf", "lg_18650hg2", "lipo_5450"]


@pytest.mark.parametrize("folder", FOLDERS)
def test_the_data_sets_own_tables(real_data, folder):
    """Rows, duration, intervals, ranges and charge, as each data set's README lists them."""
    lines = (real_data / folder / "README.md").read_text().splitlines()
    rows = [match.groups() for line in lines if (match := ROW.match(line))]
    assert len(rows) > 5
    for name, count, hours, median, longest, rest in rows[::4]:
        current, voltage, first, temperature, counter, *_ = rest.split(" | ")
        log = read_log(real_data / folder / f"{name}.csv.gz")
        found = inspect_log(log)
        assert found.samples == int(count), name
        assert found.duration_s / 3600 == pytest.approx(float(hours), abs=0.006), name
        assert found.sampling.median_s == pytest.approx(float(median), abs=0.006), name
        assert found.sampling.max_s == pytest.approx(float(longest), abs=0.012), name
        # Modules are read as the mean of six cells; the string's own sensor reads 0.4 % less.
        cells, of_string = (6, 0.1) if name.startswith("modules") else (1, 0.0)
        assert cells * log.voltage_V[0] == pytest.approx(float(first), abs=2e-3 + of_string), name
        assert found.charge_Ah == pytest.approx(float(counter), abs=2e-4), name
        for text, span, digits, count_V in (
            (current, found.current_A, 6e-3, 1),
            (voltage, found.voltage_V, 6e-4 + of_string, cells),
            (temperature, found.temperature_C, 6e-2, 1),
        ):
            if text == "-":
                assert span is None, name
            else:
                low, high = (float(x) for x in text.split(".."))
                assert span is not None
                scaled = tuple(count_V * value for value in span)
                assert scaled == pytest.approx((low, high), abs=digits), name
        assert found.sign == "verified", name
        json.dumps(found.to_dict(), allow_nan=False)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_current_of_rounding_errors_alone_is_looked_through_without_a_warning():
    """1e-320 A, as a damaged recording holds: a resistance over it would be infinite."""
    truth = pulse_channels()
    tiny = 1e-320 * (np.arange(truth["time_s"].size) % 2)
    tiny[:600] = 0.0
    tiny[5] = 2.0
    assert inspect_log(CellLog(truth["time_s"], tiny, truth["voltage_V"])).samples == tiny.size
