"""A car's pack over months: nobody accused, hidden faults named, the order of the cells kept."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import spearmanr

from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.cell.stock import named_model
from cellwise.cli import main
from cellwise.logs import CellLog
from cellwise.logs.reading import read_pack
from cellwise.logs.writing import write_columns
from cellwise.pack.differences import RESISTANCE, MeanCell, OcvSlope, mean_cell, regressors
from cellwise.pack.pack_estimate import estimate_pack
from emulated_packs import with_cells

MODEL = named_model("lmo-pouch", 54.0)
HURT = 37
REST_A = 2.0  # what the car takes while it stands


@pytest.fixture(scope="module")
def months(real_data):
    """Logs of May to November 2017."""
    found = {}
    for month in ("05", "06", "07", "08", "09", "10", "11"):
        paths = sorted((real_data / "leaf_pack").glob(f"leaf_2017{month}*.parquet"))
        found[month] = [read_pack(path) for path in paths]
    return found


@pytest.fixture(scope="module")
def before(months):
    """What is known after May and June."""
    return estimate_pack(MODEL, [*months["05"], *months["06"]])


def changed(logs, kind):
    """The logs with one cell changed, readings in whole millivolts as they were."""
    found = []
    for log in logs:
        volts = log.cell_V.copy()
        time, mean_V = log.mean.time_s, log.mean.voltage_V
        ocv = OcvSlope(MODEL, log.mean)
        soc = np.nan_to_num(mean_cell(MODEL, log.mean).soc, nan=0.5)
        if kind == "capacity":
            moved = 0.03 / 0.97 * (0.65 - soc)
            volts[:, HURT] += ocv.ocv_V(soc - moved) - ocv.ocv_V(soc)
        elif kind == "resistance_scale":
            volts[:, HURT] -= 0.1 * (ocv.ocv_V(soc) - mean_V)
        elif kind == "voltage_offset":
            volts[:, HURT] += 0.005
        elif kind == "time_skew":
            volts[:, HURT] = np.interp(time - 2.0, time, volts[:, HURT])
        found.append(with_cells(log, np.round(volts, 3)))
    return found


def rest_difference_V(found, soc):
    """Every cell's voltage at rest less the mean cell's, as the estimate has it [V]."""
    at = np.full(3, soc)
    log = CellLog(np.arange(3.0), np.zeros(3), np.full(3, 3.8), temperature_C=np.full(3, 25.0))
    start = InitialSoc(soc, 0.0, "given")
    still = MeanCell(log, start, at, np.zeros(3), log.voltage_V, np.zeros(3, np.intp))
    row = regressors(still, OcvSlope(MODEL, log), 0.0).rows[1].copy()
    row[RESISTANCE] = 0.0
    return found.state.deltas.mean @ row


def test_in_three_months_nobody_is_accused(months, before):
    found = estimate_pack(MODEL, months["07"], before.state)
    assert before.causes == []
    assert found.causes == []
    assert found.weak == []


def test_eight_windows_of_a_healthy_car_accuse_nobody(months):
    """Each for itself, as drives come; a drift that balancing makes is said, and no more."""
    logs = [log for month in months.values() for log in month]
    windows = [logs[k : k + 12] for k in range(0, 96, 12)]
    for window in windows:
        assert estimate_pack(MODEL, window).causes == []


def drained(log, leak_A):
    """The log with a cell that has lost charge since the first of May."""
    day = np.datetime64(f"{log.name[-8:-4]}-{log.name[-4:-2]}-{log.name[-2:]}")
    days = (day - np.datetime64("2017-05-01")).astype(int) + log.mean.time_s / 86_400.0
    soc = np.nan_to_num(mean_cell(MODEL, log.mean).soc, nan=0.5)
    ocv, volts = OcvSlope(MODEL, log.mean), log.cell_V.copy()
    lost = leak_A * 24.0 * days / MODEL.capacity_Ah
    volts[:, HURT] += ocv.ocv_V(np.clip(soc - lost, 0.0, 1.0)) - ocv.ocv_V(soc)
    return with_cells(log, np.round(volts, 3))


@pytest.mark.slow
def test_self_discharge_of_two_milliamperes_is_found_by_the_command(months, tmp_path, capsys):
    for log in (log for month in months.values() for log in month):
        write_columns(drained(log, 0.002).columns(), tmp_path / f"{log.name}.parquet")
    model = ["--model", "lmo-pouch", "--capacity-ah", "54"]
    assert main(["pack", *model, str(tmp_path), "--json"]) == 0
    (cause,) = json.loads(capsys.readouterr().out)["causes"]
    assert (cause["cell"], cause["name"]) == (f"cell_{HURT + 1}", "self_discharge")
    assert cause["parameters"]["leak_A"] == pytest.approx(0.002, rel=0.2)


@pytest.mark.parametrize("kind", ["capacity", "resistance_scale", "voltage_offset", "time_skew"])
def test_a_fault_put_into_july_is_named(months, before, kind):
    found = estimate_pack(MODEL, changed(months["07"], kind), before.state)
    assert {(c["cell"], c["name"]) for c in found.causes} == {(f"cell_{HURT + 1}", kind)}


@pytest.fixture(scope="module")
def weeks(months):
    """Logs of three months, those of even weeks and those of odd ones."""
    return by_week([*months["05"], *months["06"], *months["07"]])


def by_week(logs):
    parts = [[], []]
    for log in logs:
        day = log.name[-8:]
        number = int(np.datetime64(f"{day[:4]}-{day[4:6]}-{day[6:]}").astype(int) // 7)
        parts[number % 2].append(log)
    return parts


@pytest.fixture(scope="module")
def even(weeks):
    return estimate_pack(MODEL, weeks[0])


@pytest.fixture(scope="module")
def odd(weeks):
    return estimate_pack(MODEL, weeks[1])


def test_resistances_keep_their_order_between_weeks(even, odd):
    order = spearmanr(odd.cells.resistance_scale, even.cells.resistance_scale).statistic
    assert order >= 0.95


def order_of_rests(even, odd):
    """At the SOC at which the car rests, as the estimates of either weeks have them."""
    resting = [day.mean.soc[np.abs(day.log.mean.current_A) < REST_A] for day in even.days]
    soc = float(np.nanmedian(np.concatenate(resting)))
    return spearmanr(rest_difference_V(odd, soc), rest_difference_V(even, soc)).statistic


def test_rest_voltages_keep_their_order_between_weeks(even, odd):
    assert order_of_rests(even, odd) >= 0.9


@pytest.fixture(scope="module")
def autumn(months):
    """Estimates of even and of odd weeks from August to November."""
    logs = [log for month in ("08", "09", "10", "11") for log in months[month]]
    return [estimate_pack(MODEL, part) for part in by_week(logs)]


@pytest.mark.xfail(strict=True, reason="0.91: the last period of either weeks is a short one")
def test_resistances_keep_their_order_in_autumn(autumn):
    even, odd = autumn
    assert spearmanr(even.cells.resistance_scale, odd.cells.resistance_scale).statistic >= 0.95


@pytest.mark.xfail(strict=True, reason="0.15: cells are balanced by 0.3 % of SOC between logs")
def test_rest_voltages_keep_their_order_in_autumn(autumn):
    assert order_of_rests(*autumn) >= 0.9


def test_resistances_keep_their_order_under_polling(weeks, even):
    late = []
    for log in weeks[0]:
        volts = log.cell_V.copy()
        time = log.mean.time_s
        for cell in range(0, 96, 2):
            volts[:, cell] = np.interp(time - 1.0, time, volts[:, cell])
        late.append(replace(with_cells(log, volts)))
    delayed = estimate_pack(MODEL, late).cells.resistance_scale
    assert spearmanr(even.cells.resistance_scale, delayed).statistic >= 0.95
