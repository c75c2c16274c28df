"""Rows that somebody has put before a log are no rest; a rest of a cell is not taken for such."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.initial_soc import initial_soc as starts
from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.initial_soc.padding import padded_rows
from cellwise.cell.simulate import simulate
from cellwise.cell.stock import stock_model
from cellwise.estimate.replay import replay
from cellwise.logs.cell_log import CellLog, resample
from cellwise.logs.reading import read_log
from example_cells import curved_cell

MODEL = curved_cell()
HOUR = 3600


def drive(rest_s=0, soc0=0.7, seed=3):
    """A load that changes every five seconds, with a rest before it; its true SOC."""
    rng = np.random.default_rng(seed)
    load = np.repeat(rng.uniform(0.5, 4.0, 240), 5)
    current = np.concatenate([np.zeros(rest_s), load])
    log = CellLog(np.arange(float(current.size)), current, np.full(current.size, 3.7))
    found = simulate(MODEL, log, soc0)
    return replace(log, voltage_V=np.round(found.voltage_V, 3)), found.soc


def padded(log, first, current_A=0.0, rows=HOUR):
    """A log from one of its rows on, behind an hour that holds this row's voltage."""
    part = log.part(first, len(log))
    time = np.concatenate([np.arange(float(rows)), rows + part.time_s - part.time_s[0]])
    current = np.concatenate([np.full(rows, current_A), part.current_A])
    voltage = np.concatenate([np.full(rows, part.voltage_V[0]), part.voltage_V])
    warm = None
    if part.temperature_C is not None:
        warm = np.concatenate([np.full(rows, part.temperature_C[0]), part.temperature_C])
    return CellLog(time, current, voltage, warm)


@pytest.mark.parametrize("first", [251, 400, 777])
@pytest.mark.parametrize("current_A", [0.0, 0.05, -0.05])
def test_the_start_is_that_of_the_rows_behind(first, current_A, monkeypatch):
    """Counted back over them; taken for a rest it is beyond two of its own deviations."""
    log, soc = drive()
    whole = padded(log, first, current_A)
    assert padded_rows(MODEL, whole) == HOUR
    found = initial_soc(MODEL, whole)
    counted = current_A * HOUR / (3600.0 * MODEL.capacity_Ah)
    assert found.soc - counted == pytest.approx(soc[first], abs=2.0 * found.std)
    assert "behind 3600 rows that are no measurement" in found.how
    monkeypatch.setattr(starts, "padded_rows", lambda *_: 0)
    rest = initial_soc(MODEL, whole)
    assert abs(rest.soc - counted - soc[first]) > 2.0 * rest.std


@pytest.mark.parametrize("late", [0, 1])
@pytest.mark.parametrize("digit_V", [0.0001, 0.001, 0.01])
def test_a_rest_that_has_relaxed_is_a_rest(late, digit_V):
    """Also where the voltage is rounded until it stands, and where it is logged one row late."""
    log, _ = drive(rest_s=2 * HOUR)
    volts = np.round(log.voltage_V / digit_V) * digit_V
    volts = np.concatenate([volts[:1].repeat(late), volts[: volts.size - late]])
    assert np.ptp(volts[:HOUR]) == 0.0
    log = replace(log, voltage_V=volts)
    assert padded_rows(MODEL, log) == 0
    assert initial_soc(MODEL, log).how.startswith("rest of")


def test_too_short_or_without_a_load_nothing_is_claimed():
    log, _ = drive()
    assert padded_rows(MODEL, padded(log, 251, rows=60)) == 0
    still = CellLog(np.arange(500.0), np.zeros(500), np.full(500, 3.8))
    assert padded_rows(MODEL, still) == 0
    missing = padded(log, 251)
    missing = replace(missing, voltage_V=np.where(np.arange(len(missing)) < 9, np.nan, 3.7))
    assert padded_rows(MODEL, missing) == 0


OF_CELLS = {
    "panasonic_18650pf": "nca-18650", "plett_a123": "lfp-26650", "nissan_leaf": "lmo-pouch",
    "lg_18650hg2": "nmc-18650", "lipo_5450": "lipo-pouch", "samsung_30q_ageing": "nmc-18650",
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("folder", OF_CELLS)
def test_no_measured_start_is_taken_for_rows_put_there(real_data, folder):
    """As it was logged, to ten millivolts, and with the voltage one row late."""
    model = stock_model(OF_CELLS[folder])
    for path in sorted((real_data / folder).glob("*.csv.gz")):
        log = read_log(path, check_sign=False)
        volts = log.voltage_V
        for seen in (volts, np.round(volts, 2), np.concatenate([volts[:1], volts[:-1]])):
            assert padded_rows(model, replace(log, voltage_V=seen)) == 0, path.name


@pytest.mark.slow
def test_measured_drives_behind_an_hour_of_their_first_row(real_data):
    """From rows under load of every 25 degC drive: found nine times of ten, then closer."""
    model = stock_model("nca-18650")
    hits, errors = [], []
    for path in sorted((real_data / "panasonic_18650pf").glob("drive_p25_*.csv.gz")):
        log = read_log(path, check_sign=False)
        soc = 1.0 - (log.charge_Ah - log.charge_Ah[0]) / 2.9
        loaded = np.flatnonzero(log.current_A > 0.5 * 2.9)
        for first in loaded[:: max(1, loaded.size // 8)]:
            whole = padded(log, int(first))
            hits.append(padded_rows(model, whole) == HOUR)
            if hits[-1]:
                behind = initial_soc(model, whole).soc
                rest = initial_soc(model, whole.part(0, HOUR)).soc
                errors.append((abs(behind - soc[first]), abs(rest - soc[first])))
    assert np.mean(hits) >= 0.9
    behind, rest = np.mean(errors, axis=0)
    assert behind < 0.7 * rest


@pytest.mark.slow
@pytest.mark.parametrize("cold", ["p00", "n10", "n20"])
def test_they_are_found_in_the_cold_at_one_second_too(real_data, cold):
    """Where the resistance is several times the least, and a row is a mean of what has been."""
    model, hits = stock_model("nca-18650"), []
    for path in sorted((real_data / "panasonic_18650pf").glob(f"drive_{cold}_*.csv.gz")):
        log = resample(read_log(path, check_sign=False), 1.0)
        loaded = np.flatnonzero(log.current_A > 0.2 * model.capacity_Ah)
        for first in loaded[:: max(1, loaded.size // 12)]:
            part = log.part(int(first), min(int(first) + 60, len(log)))
            hits += [padded_rows(model, padded(part, 0, a, 200)) == 200 for a in (0.0, 0.3, -0.3)]
    assert np.mean(hits) >= 0.8


@pytest.mark.parametrize("estimator", ["ekf", "adaptive"])
def test_a_padded_hour_changes_nothing_in_a_replay(estimator):
    """The filter begins at the first measured row; handed the hour it takes it for a rest."""
    log, _ = drive()
    plain = replay(MODEL, log.part(400, len(log)), estimator=estimator).trace.soc
    whole = padded(log, 400)
    found = replay(MODEL, whole, estimator=estimator).trace.soc
    assert found.size == len(whole)
    np.testing.assert_allclose(found[-plain.size :], plain, atol=1e-6)


def test_over_the_padded_rows_soc_is_counted():
    log, _ = drive()
    whole = padded(log, 400, 0.05)
    found = replay(MODEL, whole, soc0=0.6)
    taken = 0.05 * (HOUR - 1) / (3600.0 * MODEL.capacity_Ah)
    assert found.trace.soc[0] - found.trace.soc[HOUR - 1] == pytest.approx(taken)
    assert not found.trace.used[:HOUR].any()
