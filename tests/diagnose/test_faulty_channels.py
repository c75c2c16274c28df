"""Faults put into a clean log: found where they are, cut out, and nothing found where none is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.simulate import simulate
from cellwise.diagnose import diagnose
from cellwise.diagnose.sensor_faults import clean, without_faults
from cellwise.logs.cell_log import CellLog
from cellwise.logs.reading import read_log
from cellwise.notices import texts
from example_cells import curved_cell

ROWS = 3000


@pytest.fixture(scope="module")
def drive():
    """Demand that changes every three seconds, rests, and an instrument's noise."""
    rng = np.random.default_rng(11)
    model = curved_cell()
    current = np.repeat(rng.normal(1.5, 2.5, ROWS // 3), 3)
    current[(np.arange(ROWS) // 200) % 5 == 0] = 0.0
    time = np.arange(float(ROWS))
    log = CellLog(time, current, np.full(ROWS, 3.7), name="drive")
    voltage = simulate(model, log, 0.95).voltage_V + 5e-4 * rng.standard_normal(ROWS)
    measured = np.round((current + 1e-3 * rng.standard_normal(ROWS)) / 1e-3) * 1e-3
    return replace(log, current_A=measured, voltage_V=np.round(voltage / 1e-4) * 1e-4, soc0=0.95)


def with_rows(log, channel, rows, values):
    changed = getattr(log, channel).copy()
    changed[rows] = values
    return replace(log, **{channel: changed})


def test_a_clean_drive_has_no_faults_and_is_not_touched(drive):
    same, faults = clean(drive)
    assert same is drive
    assert faults == ()


def test_a_voltage_that_stands_still_is_made_missing_there_and_nowhere_else(drive):
    rows = slice(1200, 1500)
    bad = with_rows(drive, "voltage_V", rows, drive.voltage_V[1200])
    log, faults = clean(bad)
    assert [(f.channel, f.kind) for f in faults] == [("voltage_V", "stuck")]
    assert abs(faults[0].rows - 300) <= 3
    assert faults[0].start_s == pytest.approx(1200.0, abs=2.0)
    assert np.isnan(log.voltage_V[1203:1498]).all()
    assert np.isfinite(np.delete(log.voltage_V, np.arange(1199, 1501))).all()
    assert faults[0].notice().rows.stop in (1499, 1500)


def test_after_a_current_that_stood_still_the_longest_part_is_judged_from_a_start_of_its_own(drive):
    bad = with_rows(drive, "current_A", slice(500, 800), drive.current_A[501])
    groups, starts, faults = without_faults([[bad]], [0.95])
    log = groups[0][0]
    assert [(f.channel, f.kind) for f in faults] == [("current_A", "stuck")]
    assert log.time_s[0] >= 798.0
    assert log.time_s[-1] == drive.time_s[-1]
    assert log.soc0 is None
    assert starts == [None]


def test_a_current_at_the_end_of_its_range_is_saturated_and_a_tester_at_its_limit_is_not(drive):
    clipped = replace(drive, current_A=np.minimum(drive.current_A, 3.0))
    assert [f.kind for f in clean(clipped)[1]] == ["saturated"]
    limited = replace(drive, current_A=np.minimum(drive.current_A, 3.0))
    voltage = simulate(curved_cell(), limited, 0.95).voltage_V
    noise = 5e-4 * np.random.default_rng(12).standard_normal(ROWS)
    assert clean(replace(limited, voltage_V=voltage + noise))[1] == ()


def test_single_rows_that_jump_are_spikes(drive):
    rng = np.random.default_rng(13)
    at = np.sort(rng.choice(np.arange(10, ROWS - 10, 7), 12, replace=False))
    bad = with_rows(drive, "voltage_V", at, drive.voltage_V[at] + rng.choice([-0.7, 0.7], 12))
    log, faults = clean(bad)
    assert [f.kind for f in faults] == ["spikes"]
    found = {r.first for r in faults[0].runs}
    assert found <= set(at)
    steady = [k for k in at if np.ptp(drive.current_A[k - 6 : k + 7]) < 4.0]
    assert set(steady) <= found
    assert np.isnan(log.voltage_V[list(found)]).all()


def test_many_rows_without_a_value_are_lost_and_a_few_are_not(drive):
    few = with_rows(drive, "voltage_V", slice(700, 705), np.nan)
    assert clean(few)[1] == ()
    lost = with_rows(drive, "voltage_V", slice(700, 900), np.nan)
    log, faults = clean(lost)
    assert [(f.kind, f.rows) for f in faults] == [("lost", 200)]
    assert len(log) == ROWS
    no_current = with_rows(drive, "current_A", slice(700, 900), np.nan)
    log, faults = clean(no_current)
    assert [f.channel for f in faults] == ["current_A"]
    assert log.time_s[0] == 900.0


def test_a_log_whose_current_was_wrong_almost_everywhere_is_kept_whole_and_said(drive):
    current = drive.current_A.copy()
    for begin in range(0, ROWS, 300):
        current[begin : begin + 280] = np.nan
    log, faults = clean(replace(drive, current_A=current))
    assert len(log) == ROWS
    assert faults[0].kind == "lost"


def test_a_diagnosis_names_the_fault_first_with_its_rows_and_judges_the_rest(drive):
    bad = with_rows(drive, "voltage_V", slice(1200, 1500), drive.voltage_V[1200])
    found = diagnose(curved_cell(), bad, causes=["ocv_shift", "current_offset"])
    assert found.verdict == "sensor_fault"
    assert [c.name for c in found.causes] == ["sensor_fault"]
    fault = found.causes[0]
    assert fault.parameters["rows"] == pytest.approx(300, abs=3)
    assert fault.holdout_rmse_after_V < 0.2 * fault.holdout_rmse_before_V
    assert "voltage_V stands still" in fault.evidence[0]
    assert len(found.to_dict()["causes"]) == 1


GROSS = [
    ("voltage_V", 108.0, 35),
    ("voltage_V", 0.0, 20),
    ("voltage_V", -40.0, 25),
    ("voltage_V", 4095.0, 1),
    ("current_A", 1e9, 35),
    ("current_A", -655.35, 22),
    ("temperature_C", 900.0, 35),
]


def test_a_current_that_reads_nothing_while_the_voltage_is_driven_is_stuck(drive):
    loaded = drive.current_A.copy()
    begin = 1310
    assert np.all(np.ptp(loaded[begin : begin + 20].reshape(2, 10), axis=1) > 0.5)
    log, faults = clean(with_rows(drive, "current_A", slice(begin, begin + 20), 0.0))
    assert [(f.channel, f.kind) for f in faults] == [("current_A", "stuck")]
    assert abs(faults[0].rows - 20) <= 2
    assert log.time_s[0] >= begin + 18.0


@pytest.mark.parametrize("end", [0.25, 0.75])
def test_a_voltage_at_the_end_of_its_range_is_saturated(drive, end):
    limit = float(np.round(np.quantile(drive.voltage_V, end), 4))
    held = np.minimum if end > 0.5 else np.maximum
    bad = replace(drive, voltage_V=held(drive.voltage_V, limit))
    log, faults = clean(bad)
    kinds = {(f.channel, f.kind) for f in faults}
    assert ("voltage_V", "saturated") in kinds
    assert not any(c == "current_A" for c, _ in kinds)
    assert not np.any(log.voltage_V == limit)


def test_a_cell_at_rest_full_or_dead_and_a_heavy_pulse_are_no_faults(drive):
    rest = np.zeros(600)
    pulses = np.where(np.arange(600) % 300 < 2, 60.0, 0.0)
    for current in (rest, pulses):
        log = CellLog(np.arange(600.0), current + 1e-3, np.full(600, 3.7))
        voltage = simulate(curved_cell(), log, 0.5).voltage_V
        assert clean(replace(log, voltage_V=voltage))[1] == ()
    dying = drive.voltage_V * np.clip(np.linspace(9.0, 0.0, ROWS), 0.0, 1.0)
    assert not any(f.kind == "impossible" for f in clean(replace(drive, voltage_V=dying))[1])


@pytest.mark.parametrize(("channel", "value", "rows"), GROSS)
def test_a_file_with_gross_faults_is_read_and_named_with_the_same_rows(
    drive, tmp_path, channel, value, rows
):
    warm = replace(drive, temperature_C=np.full(ROWS, 24.5))
    bad = with_rows(warm, channel, slice(1307, 1307 + rows), value)
    names = ("time_s", "current_A", "voltage_V", "temperature_C")
    table = np.column_stack([getattr(bad, n) for n in names])
    file = tmp_path / "drive.csv"
    np.savetxt(file, table, "%.7g", ",", header=",".join(names), comments="")
    log = read_log(file)
    left, faults = clean(log)
    if rows > 1:  # a single one was made missing where the file was read
        assert [(f.channel, f.runs) for f in faults] == [(channel, ((1307, 1306 + rows),))]
    assert any("1308" in n for n in texts(log.notices))
    assert np.nanmax(np.abs(getattr(left, channel))) < 30.0


@pytest.mark.parametrize("skew_s", [-2.0, 2.5])
def test_a_voltage_that_comes_late_is_no_fault_of_a_channel(drive, skew_s):
    """The load before a rest, or after it, is still in the voltage then: that is a delay."""
    resting = drive.current_A.copy()
    resting[1300:1500] = 0.0
    log = replace(drive, current_A=resting)
    voltage = simulate(curved_cell(), log, 0.9).voltage_V
    late = np.interp(log.time_s - skew_s, log.time_s, voltage)
    assert clean(replace(log, voltage_V=np.round(late, 4)))[1] == ()
