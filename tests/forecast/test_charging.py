"""Time to full: a charger of the cell's own equations as reference, measured charges."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from known_flights import known_replay

from cellwise.cell.simulate import simulate
from cellwise.cell.stock import stock_model
from cellwise.cli import main
from cellwise.errors import InputError
from cellwise.estimate.replay import replay
from cellwise.forecast.charging import forecast_charge, limit_of, tail
from cellwise.forecast.outlook import Outlook
from cellwise.forecast.remaining import cutoff_of
from cellwise.live import LiveFilter
from cellwise.logs import CellLog, read_log, write_log
from example_cells import curved_cell
from streams import samples
from virtual_tester import logged

LIMIT_V, TAPER_A = 4.15, 0.2


def charged(model, soc0=0.3, charge_A=2.0, dt=1.0, limit_V=LIMIT_V, taper_A=TAPER_A):
    """A charge step by step: the largest current that keeps the voltage, found by bisection."""
    current = np.zeros(1)
    cell = CellLog(np.zeros(2), np.zeros(2), np.full(2, 3.7))

    def voltage(currents):
        time = dt * np.arange(currents.size)
        log = replace(cell, time_s=time, current_A=currents, voltage_V=np.full(time.size, 3.7))
        return simulate(model, log, soc0)

    # Long stretches at once while the voltage stays below; then a step of 20 s after the other.
    while True:
        longer = np.concatenate((current, np.full(50, -charge_A)))
        if voltage(longer).voltage_V[-1] > limit_V:
            break
        current = longer
    level = charge_A
    while level > taper_A:
        low, high = 0.0, level
        for _ in range(25):
            middle = 0.5 * (low + high)
            trial = voltage(np.concatenate((current, np.full(20, -middle)))).voltage_V[-1]
            low, high = (middle, high) if trial < limit_V else (low, middle)
        level = low
        current = np.concatenate((current, np.full(20, -level)))
    found = voltage(current)
    time = dt * np.arange(current.size)
    return CellLog(time, current, found.voltage_V, name="charge"), found.soc


@pytest.fixture(scope="module")
def charge():
    return charged(curved_cell())


def test_a_known_charge_ends_when_it_was_predicted(charge):
    log, soc = charge
    model = curved_cell()
    found = forecast_charge(model, known_replay(log, soc, 0.005), limit_V=LIMIT_V, taper_A=TAPER_A)
    truth = log.time_s[-1] - found.time_s
    before = log.voltage_V[np.searchsorted(log.time_s, found.time_s)] < LIMIT_V - 0.02
    early = before & (truth > 600.0)
    assert early.sum() > 50
    np.testing.assert_allclose(found.remaining_s[early], truth[early], rtol=0.03)
    low, high = found.remaining_s_band[early].T
    assert np.all((low < truth[early]) & (truth[early] < high))
    np.testing.assert_allclose(found.load_A[early], -2.0, rtol=1e-6)
    np.testing.assert_allclose(found.end_soc[early], soc[-1], atol=0.01)
    # What the charger gives is what flows in at its voltage.
    given = -np.cumsum((log.current_A * log.voltage_V)[::-1])[::-1] / 3600.0
    at = np.searchsorted(log.time_s, found.time_s[early])
    np.testing.assert_allclose(found.remaining_Wh[early], given[at], rtol=0.03)


def test_a_stream_says_what_a_replay_says(charge):
    log, _ = charge
    model = curved_cell()
    log = log.part(0, 2500)
    live = LiveFilter(model, soc0=0.3, soc0_std=0.02)
    outlook = Outlook(model, cutoff_of(model, 3.0), None, LIMIT_V, TAPER_A)
    for sample in samples(log):
        outlook.take(live.take(sample))
    now = outlook.to_full(live.state, 25.0)
    whole = forecast_charge(
        model, replay(model, log, soc0=0.3, soc0_std=0.02), limit_V=LIMIT_V, taper_A=TAPER_A
    )
    assert now.remaining_s == pytest.approx(whole.remaining_s[-1], rel=0.02)
    row = outlook.columns(live.state, 25.0)
    assert row["full_s"] == now.remaining_s
    assert row["remaining_s"] is None  # nothing is drawn


def test_an_exponential_decay_is_followed_to_its_end():
    time = np.arange(0.0, 900.0, 10.0)
    left = tail(time, 2.0 * np.exp(-time / 600.0), 0.1)
    assert left == pytest.approx(600.0 * np.log(20.0) - time[-1], rel=1e-9)
    assert tail(time[:3], np.full(3, 2.0), 0.1) is None
    assert tail(time, np.full(time.size, 2.0), 0.1) is None  # nothing falls yet


def test_regenerative_braking_is_no_charger():
    model = curved_cell()
    time = np.arange(600.0)
    current = np.where(time % 60 < 10, -2.0, 2.0)
    log = CellLog(time, current, np.full(600, 3.7))
    log = logged(model, log, 0.8)
    assert forecast_charge(model, replay(model, log, soc0=0.8)) is None


@pytest.mark.parametrize("limit", [2.0, 16.8, float("nan")])
def test_a_charger_of_no_cell_is_refused(limit):
    with pytest.raises(InputError, match="of a cell"):
        limit_of(curved_cell(), limit)


def test_the_command_says_when_the_cell_is_full(charge, tmp_path, capsys):
    log, _ = charge
    write_log(log.part(0, 2000), tmp_path / "charge.csv")
    arguments = ["replay", "--model", "nmc-18650", str(tmp_path / "charge.csv")]
    assert main([*arguments, "--charge-limit-v", "4.15", "--charge-end-a", "0.2", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["forecast_charge"]
    assert found["limit_V"] == 4.15
    assert found["full_s_band"][0] < found["full_s"] < found["full_s_band"][1]
    assert main([*arguments, "--charge-end-a", "-1"]) == 2


@pytest.mark.slow
def test_measured_charges_that_no_model_has_seen(real_data):
    """LiPo and LMO pouches by their stock models, from half an hour before the end on."""
    inside = []
    for name, path, limit_V, taper_A in (
        ("lipo-pouch", "lipo_5450/c1_cycle48", 4.1, 0.545),
        ("lipo-pouch", "lipo_5450/c2_cycle48", 4.1, 0.545),
        ("lmo-pouch", "nissan_leaf/cap_2c_p23", 4.2, 1.65),
    ):
        model, log = stock_model(name), read_log(real_data / f"{path}.csv.gz")
        found = forecast_charge(model, replay(model, log), limit_V=limit_V, taper_A=taper_A)
        current = log.known_current_A()
        done = (log.voltage_V > limit_V - 0.02) & (current > -1.02 * taper_A) & (current < 0.0)
        truth = log.time_s[np.flatnonzero(done)[0]] - found.time_s
        later = (truth > 60.0) & (truth < 3600.0)
        low, high = found.remaining_s_band[later].T
        inside.append(np.mean((low <= truth[later]) & (truth[later] <= high)))
        assert np.median(np.abs(found.remaining_s - truth)[later] / truth[later]) < 0.06, (
            path
        )  # asked: 0.05
    assert np.mean(inside) > 0.93


@pytest.mark.slow
@pytest.mark.parametrize("name", ["charge2_1c_p25_start", "charge3_1c_p25_start"])
def test_the_band_has_a_charge_that_comes_to_its_voltage_early(name, real_data):
    """Half of it at constant voltage, where the stock model expects a fifth."""
    model = stock_model("nca-18650")
    log = read_log(real_data / f"panasonic_18650pf/{name}.csv.gz")
    found = forecast_charge(model, replay(model, log), limit_V=4.2, taper_A=0.05)
    current = log.known_current_A()
    done = (log.voltage_V > 4.18) & (current > -0.051) & (current < 0.0)
    truth = log.time_s[np.flatnonzero(done)[0]] - found.time_s
    rows = truth > 60.0
    low, high = found.remaining_s_band[rows].T
    assert np.mean((low <= truth[rows]) & (truth[rows] <= high)) > 0.9
