"""What is left in a cell: against the same load simulated on to its end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_flights import CUTOFF_V, discharge, known_replay, until

from cellwise.cell.model import CAPACITY_STD
from cellwise.cell.model_error import ModelError
from cellwise.cell.plausibility.validity import Validity
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.replay import replay
from cellwise.forecast.remaining import forecast, forecast_at
from example_cells import curved_cell, lfp_cell, linear_cell


@pytest.mark.parametrize("make", [linear_cell, curved_cell, lfp_cell])
@pytest.mark.parametrize("rate", [0.2, 1.0, 4.0])
@pytest.mark.parametrize("end_soc", [0.25, 0.03])
def test_a_constant_current_is_forecast_to_its_end(make, rate, end_soc):
    """From every moment: time so far plus time left is the time at which it ends."""
    model = make()
    load = rate * model.capacity_Ah
    dt = 2.0 / rate
    whole, truth = discharge(model, np.full(int(4200 / rate / dt), load), 0.95, dt)
    cutoff = float(whole.voltage_V[np.searchsorted(-truth.soc, -end_soc)])
    end_s, end_Wh = until(whole, truth.soc, cutoff)
    rows = int(0.8 * end_s / dt)
    flight = forecast(
        model,
        known_replay(whole.part(0, rows), truth.soc[:rows]),
        cutoff_V=cutoff,
        hold="current",
    )
    later = flight.time_s > 60.0  # before, the present load has not been seen for a minute
    np.testing.assert_allclose(
        (flight.time_s + flight.remaining_s)[later], end_s, rtol=0.003, atol=dt
    )
    spent = np.cumsum(whole.current_A * whole.voltage_V * whole.interval_s)[:rows] / 3600
    at = np.searchsorted(whole.time_s, flight.time_s)
    np.testing.assert_allclose((spent[at] + flight.remaining_Wh)[later], end_Wh, rtol=0.01)


def test_a_constant_power_takes_longer_and_longer_currents():
    """Energy left over power is the time left, and it is shorter than at the present current."""
    model = curved_cell()
    log, truth = discharge(model, np.full(600, 3.0), 0.9)
    known = known_replay(log, truth.soc)
    power = forecast(model, known, cutoff_V=CUTOFF_V).last
    current = forecast(model, known, cutoff_V=CUTOFF_V, hold="current").last
    now_W = 3.0 * log.voltage_V[-1]
    assert 3600 * power.remaining_Wh / power.remaining_s == pytest.approx(now_W, rel=0.01)
    assert power.remaining_s < current.remaining_s


def test_a_forecast_says_whether_voltage_or_charge_ends_it():
    model = curved_cell()
    log, truth = discharge(model, np.full(600, 3.0), 0.9)
    known = known_replay(log, truth.soc)
    by_voltage = forecast(model, known, cutoff_V=3.3).last
    assert by_voltage.by == "voltage"
    assert by_voltage.end_voltage_V == pytest.approx(3.3)
    assert by_voltage.end_soc > 0.02
    by_charge = forecast(model, known, cutoff_V=1.0).last
    assert by_charge.by == "charge"
    assert by_charge.end_soc == pytest.approx(0.0, abs=1e-9)
    assert by_charge.end_voltage_V < float(model.ocv_V.min())


def test_the_band_is_that_of_soc_and_capacity_where_the_charge_ends():
    """Forecasts from the SOC two deviations away, and 2 % of what is left, in squares."""
    model = linear_cell()
    log, truth = discharge(model, np.full(900, 2.0), 0.9)
    sure = {
        shift: forecast(
            model, known_replay(log, truth.soc + shift), cutoff_V=1.0, hold="current"
        ).last.remaining_s
        for shift in (-0.1, 0.0, 0.1)
    }
    left = forecast(
        model, known_replay(log, truth.soc, std=0.05), cutoff_V=1.0, hold="current"
    ).last
    assert left.remaining_s == pytest.approx(sure[0.0])
    of_capacity = 2 * CAPACITY_STD * sure[0.0]
    below = np.hypot(sure[0.0] - sure[-0.1], of_capacity)
    above = np.hypot(sure[0.1] - sure[0.0], of_capacity)
    assert left.remaining_s_band == pytest.approx((sure[0.0] - below, sure[0.0] + above))
    seconds_per_soc = 3600 * model.capacity_Ah / 2.0
    assert sure[0.1] - sure[0.0] == pytest.approx(0.1 * seconds_per_soc, rel=1e-6)


def test_where_the_voltage_ends_it_the_band_holds_the_models_own_error():
    """A cell whose voltage falls away from the model's with the SOC, within the stated error."""
    model = curved_cell()
    slope = 0.06  # V, from full to empty
    weak = replace(model, ocv_V=model.ocv_V - slope * (1.0 - model.soc))
    whole, truth = discharge(weak, np.full(6000, 3.0), 0.95)
    end_s, _ = until(whole, truth.soc, CUTOFF_V)
    now = int(0.3 * end_s)
    part = whole.part(0, now + 1)
    bands = []
    for stated_V in (0.001, 0.03):
        says = replace(
            model, error=ModelError.of_white_and_slow(slow_V=(stated_V,), resistance_share=0.0)
        )
        known = known_replay(part, truth.soc[: now + 1])
        left = forecast(says, known, cutoff_V=CUTOFF_V, hold="current").last
        assert left.by == "voltage"
        bands.append(left.remaining_s_band)
    assert bands[1][0] < end_s - part.time_s[-1] < bands[1][1]
    assert bands[1][1] - bands[1][0] > 1.3 * (bands[0][1] - bands[0][0])


def test_an_aged_cell_gives_up_earlier_and_the_forecast_says_so():
    """Twice the resistance that the model has: its present drop is taken to stay."""
    model = curved_cell()
    aged = replace(model, r0_ohm=2 * model.r0_ohm)
    whole, truth = discharge(aged, np.full(4000, 3.0), 0.95)
    end_s, _ = until(whole, truth.soc, CUTOFF_V)
    rows = int(0.6 * end_s)
    part = whole.part(0, rows)
    left = forecast(model, known_replay(part, truth.soc[:rows]), cutoff_V=CUTOFF_V, hold="current")
    assert left.last.time_s + left.last.remaining_s == pytest.approx(end_s, rel=0.02)
    fresh = simulate(model, part, 0.95)
    naive = forecast(
        model,
        known_replay(replace(part, voltage_V=fresh.voltage_V), truth.soc[:rows]),
        cutoff_V=CUTOFF_V,
        hold="current",
    )
    assert naive.last.remaining_s > left.last.remaining_s


def test_the_typical_load_is_not_that_of_a_vehicle_that_stands():
    model = curved_cell()
    current = np.concatenate((np.full(600, 6.0), np.full(300, 0.1)))
    log, truth = discharge(model, current, 0.9)
    flight = forecast(model, known_replay(log, truth.soc), cutoff_V=CUTOFF_V)
    assert flight.last.load_A == pytest.approx(0.1, rel=1e-6)
    assert flight.typical.last.load_A == pytest.approx(6.0, rel=0.05)  # a minute's mean falls
    assert flight.typical.last.remaining_s < 0.05 * flight.last.remaining_s


@pytest.mark.parametrize("current", [0.0, -2.0, 0.01])
def test_without_a_load_there_is_no_forecast(current):
    model = curved_cell()
    log, truth = discharge(model, np.full(300, current), 0.5)
    assert forecast(model, known_replay(log, truth.soc)) is None


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"cutoff_V": 14.0}, "not of the pack"),
        ({"cutoff_V": -1.0}, "not of the pack"),
        ({"hold": "torque"}, "Choose one"),
    ],
)
def test_what_cannot_be_forecast_is_refused(options, says):
    model = curved_cell()
    log, truth = discharge(model, np.full(300, 3.0), 0.5)
    with pytest.raises(InputError, match=says):
        forecast(model, known_replay(log, truth.soc), **options)


def test_a_long_log_has_a_few_hundred_moments_and_its_last_row():
    model = curved_cell()
    log, truth = discharge(model, np.full(20_000, 0.3), 0.9)
    flight = forecast(model, known_replay(log, truth.soc))
    assert 100 < len(flight) <= 400
    assert flight.last.time_s == log.time_s[-1]


def test_through_a_filter_from_an_unknown_start():
    """The whole way: a flight that begins under load, no SOC given; the end lies in the band."""
    model = curved_cell()
    rng = np.random.default_rng(1)
    rows = 500
    load = np.full(2000, 6.0)  # what is forecast: the mean load from now on
    load[:rows] *= 1 + 0.3 * (-1.0) ** np.arange(rows)
    whole, truth = discharge(model, load, 0.8)
    end_s, _ = until(whole.part(rows, len(whole)), truth.soc[rows:], 3.0)
    part = whole.part(0, rows)
    noisy = replace(part, voltage_V=part.voltage_V + rng.normal(0, 0.002, rows))
    left = forecast(model, replay(model, noisy), cutoff_V=3.0, hold="current").last
    low, high = left.remaining_s_band
    assert low - 20 < end_s - left.time_s < high + 20
    assert high - low < 0.5 * left.remaining_s


def test_beyond_the_data_s_soc_the_band_is_wider_and_the_forecast_says_so():
    """An OCV that is off by 0.3 V per SOC where nobody measured: the truth lies in the band."""
    truth = curved_cell()
    s = np.linspace(0.0, 1.0, 101)
    guessed = truth.ocv_V[0] + 0.3 * np.minimum(s - 0.6, 0.0)
    narrow = curved_cell(ocv_V=guessed)
    wide = replace(narrow, validity=Validity(soc=(0.6, 1.0)))
    whole, run = discharge(truth, np.full(4000, 3.0), 0.95)
    end_s, _ = until(whole, run.soc, CUTOFF_V)
    seen = whole.part(0, 600)
    bands, notices = [], []
    for model in (wide, narrow):
        flight = forecast(model, known_replay(seen, run.soc[:600], 0.005), cutoff_V=CUTOFF_V)
        bands.append(flight.last.remaining_s_band)
        notices.append(flight.notices)
    left_s = end_s - seen.time_s[-1]
    assert bands[0][0] < left_s < bands[0][1]
    assert not bands[1][0] < left_s < bands[1][1]
    assert "the model's data end at SOC 0.60" in notices[0][0].text
    assert notices[1] == ()


@pytest.mark.parametrize(("hold", "unit"), [("power", "W"), ("current", "A")])
def test_a_given_load_that_is_the_present_one_leaves_the_same(hold, unit):
    model = curved_cell()
    log, truth = discharge(model, np.full(600, 3.0), 0.9)
    known = known_replay(log, truth.soc)
    present = forecast(model, known, cutoff_V=CUTOFF_V, hold=hold).last
    load = 3.0 * float(log.voltage_V[-1]) if unit == "W" else 3.0
    given = forecast_at(model, known, load, cutoff_V=CUTOFF_V, hold=hold)
    assert given.time_s == log.time_s[-1]
    assert given.load_A == pytest.approx(3.0, rel=0.002)
    assert given.remaining_s == pytest.approx(present.remaining_s, rel=0.002)
    assert given.remaining_Wh == pytest.approx(present.remaining_Wh, rel=0.002)
    assert given.remaining_s_band == pytest.approx(present.remaining_s_band, rel=0.005)


def test_a_given_load_needs_none_in_the_log_and_may_be_too_much():
    model = curved_cell()
    log, truth = discharge(model, np.zeros(60), 0.5)
    known = known_replay(log, truth.soc)
    assert forecast(model, known, cutoff_V=CUTOFF_V) is None
    half, double = (forecast_at(model, known, w, cutoff_V=CUTOFF_V) for w in (5.0, 10.0))
    assert 0.0 < double.remaining_s < 0.5 * half.remaining_s
    at_once = forecast_at(model, known, 1e5, cutoff_V=CUTOFF_V)
    assert at_once.remaining_s == 0.0
    assert at_once.by == "voltage"
    for wrong in (0.0, -3.0, np.nan):
        with pytest.raises(InputError, match="a load of"):
            forecast_at(model, known, wrong)
