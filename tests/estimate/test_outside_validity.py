"""Beyond a model's data the filters say so, widen, and are right about it; within nothing changes.

The truth is the cell that the model is of at 25 degC; in the cold it does what lithium-ion cells
do and the model's data never showed.
"""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import ChargeTransfer, TemperatureDependence
from cellwise.cell.plausibility.notice import outside_moment, outside_notices
from cellwise.cell.plausibility.validity import TOLERANCE_K, UNKNOWN, Validity
from cellwise.cell.plausibility.validity_kernels import (
    extrapolation_V,
    validity_scalars,
)
from cellwise.cell.simulate import simulate
from cellwise.estimate.estimators import make_estimator
from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.replay import Replay, replay
from cellwise.estimate.status import OUTSIDE
from cellwise.logs.cell_log import CellLog
from cellwise.notices import texts
from example_cells import curved_cell

CAPACITY_AH = 3.0
SOC0 = 0.9
VALID = Validity(soc=(0.0, 1.0), temperature_C=(24.0, 29.0), current_A=(-6.0, 9.0))
MODEL = curved_cell(validity=VALID)
BEFORE = curved_cell()  # a model file of before: nothing is known of its data
TARGET = pytest.param(
    "firmware",
    marks=pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc"),
)
FILTERS = ("ekf", "ukf", "adaptive", TARGET, "filterpy-ekf")
ALL_STATES = ("ekf", "ukf", "adaptive")
# What a cold cell does; typical is some 30 kJ/mol, and the OCV moves a little.
COLD = (TemperatureDependence(3600.0, 25.0), ChargeTransfer(30.0))


def drive(temperature_C: float, seed: int = 1, rows: int = 6000, scale: float = 1.0) -> CellLog:
    """A drive of a real cell's kind: discharging on the whole, with breaks and recuperation."""
    rng = np.random.default_rng(seed)
    current = scale * np.repeat(rng.gamma(1.2, 1.1, rows // 20) - 0.4, 20)
    warm = np.full(rows, temperature_C)
    return CellLog(np.arange(float(rows)), current, np.full(rows, 3.7), temperature_C=warm)


def measured(truth, log: CellLog, soc0: float = SOC0) -> CellLog:
    run = simulate(truth, log, soc0)
    noise = 1e-3 * np.random.default_rng(9).normal(size=len(log))
    return replace(log, voltage_V=run.voltage_V + noise, charge_Ah=(soc0 - run.soc) * CAPACITY_AH)


def run(model, log: CellLog, name: str | Ekf, soc0: float = 0.75) -> Replay:
    return replay(
        model, log, name, soc0=soc0, reference_soc0=SOC0, reference_capacity_Ah=CAPACITY_AH
    )


@pytest.mark.parametrize("name", FILTERS)
def test_within_its_data_a_model_estimates_to_the_bit_as_one_of_before(name):
    log = measured(BEFORE, drive(25.0))
    a, b = (make_estimator(name, m).run(log, 0.7, 0.2) for m in (MODEL, BEFORE))
    assert not np.any(a.status & OUTSIDE)
    np.testing.assert_array_equal(a.soc, b.soc)
    np.testing.assert_array_equal(a.soc_std, b.soc_std)


@pytest.mark.parametrize("name", ALL_STATES)
@pytest.mark.parametrize("temperature_C", [0.0, -15.0])
def test_in_the_cold_the_truth_is_within_two_deviations_and_no_further_away(name, temperature_C):
    log = measured(curved_cell(effects=COLD), drive(temperature_C))
    wide, narrow = run(MODEL, log, name), run(BEFORE, log, name)
    assert np.all(wide.trace.status & OUTSIDE)
    assert wide.coverage_2sigma >= 0.95
    assert wide.coverage_2sigma >= narrow.coverage_2sigma
    assert wide.errors.rmse <= narrow.errors.rmse


def test_without_the_widening_the_cold_is_believed_too_much():
    """What the test above holds against: on the same drive the truth is mostly left out."""
    log = measured(curved_cell(effects=COLD), drive(-15.0))
    alone = Ekf(BEFORE, components=1)  # many are in doubt while they differ
    assert run(BEFORE, log, alone).coverage_2sigma < 0.8


def test_the_stated_deviation_grows_with_the_cold():
    stds = []
    for warm in (25.0, 21.5, 10.0, 0.0, -15.0):
        trace = Ekf(MODEL).run(measured(BEFORE, drive(warm)), 0.7, 0.2)
        stds.append(float(np.median(trace.soc_std)))
    assert stds[0] == stds[1], "within the tolerance"
    assert np.all(np.diff(stds[1:]) > 0.0)


def test_beyond_its_soc_an_ocv_that_nobody_saw():
    """The model's lower half is a guess, and off; its data end at SOC 0.6."""
    s = np.linspace(0.0, 1.0, 101)
    guessed = MODEL.ocv_V[0] + 0.3 * np.minimum(s - 0.6, 0.0)
    known = replace(VALID, soc=(0.6, 1.0))
    wide = curved_cell(ocv_V=guessed, validity=known)
    narrow = curved_cell(ocv_V=guessed)
    log = measured(BEFORE, drive(25.0, rows=9000))
    a, b = run(wide, log, "ekf"), run(narrow, log, "ekf")
    below = np.flatnonzero(a.reference_soc < 0.55)
    assert below.size > 1000
    assert np.all(a.trace.status[below] & OUTSIDE)
    covered_a, covered_b = (
        float(np.mean(np.abs(r.error[below]) <= 2.0 * r.trace.soc_std[below])) for r in (a, b)
    )
    assert covered_a >= 0.95
    assert covered_b < 0.8


def test_a_current_beyond_the_data_is_flagged_row_by_row():
    log = measured(BEFORE, drive(25.0, scale=4.0))
    status = Ekf(MODEL).run(log, SOC0, 0.05).status
    bounds = VALID.bounds()
    beyond = (log.current_A > bounds.discharge_A) | (log.current_A < bounds.charge_A)
    assert 0 < np.count_nonzero(beyond) < len(log)
    np.testing.assert_array_equal(status & OUTSIDE != 0, beyond)


def test_a_temperature_that_nobody_measured_is_no_news():
    log = replace(measured(BEFORE, drive(25.0)), temperature_C=None)
    model = replace(MODEL, validity=Validity(temperature_C=(-20.0, -10.0)))
    assert not np.any(Ekf(model).run(log, SOC0).status & OUTSIDE)
    assert simulate(model, log, SOC0).notices == ()


@pytest.mark.parametrize("activation_K", [2400.0, 3600.0])
def test_what_a_cold_cell_does_is_within_two_deviations_of_the_law(activation_K):
    """20 and 30 kJ/mol against a model that has no activation, to 45 K below its data."""
    valid, drop_V = validity_scalars(MODEL), 0.1
    for warm in np.arange(-20.0, 24.0 - TOLERANCE_K, 5.0):
        factor = np.exp(activation_K * (1.0 / (warm + 273.15) - 1.0 / 298.15))
        stated = np.hypot(float(MODEL.error.at(0.5)), MODEL.error.shown_share() * drop_V)
        law = np.hypot(stated, extrapolation_V(valid, warm, 3.0, drop_V))
        assert drop_V * (factor - 1.0) <= 2.0 * law


def test_a_model_with_an_activation_of_its_own_widens_less():
    own = replace(MODEL, effects=(TemperatureDependence(3000.0, 25.0),))
    a, b = (extrapolation_V(validity_scalars(m), -10.0, 3.0, 0.1) for m in (own, MODEL))
    assert 0.0 < a < b


def test_what_a_model_states_of_its_activation_is_taken_beyond_its_data():
    stated = replace(MODEL, error=replace(MODEL.error, activation_std_K=2000.0))
    a, b = (validity_scalars(m).share_per_K for m in (stated, MODEL))
    assert a / b == pytest.approx(2000.0 / 3600.0)


# ---- notices ----


def test_what_leaves_the_data_is_said_once_and_first_with_its_numbers():
    cold = drive(0.0)
    cold = replace(cold, temperature_C=np.where(np.arange(6000) < 1860, -12.0, 22.0))
    log = measured(curved_cell(effects=COLD), cold)
    for found in (simulate(MODEL, log, SOC0), replay(MODEL, log, "ekf", soc0=SOC0)):
        assert "31 % of the rows are below 24 degC" in found.notices[0].text
        assert "to -12" in found.notices[0].text
        assert sum("data covered" in n for n in texts(found.notices)) == 1


@pytest.mark.parametrize("warm", [24.0 - 0.9 * TOLERANCE_K, 29.0 + 0.9 * TOLERANCE_K])
def test_a_hair_outside_says_nothing(warm):
    log = measured(BEFORE, drive(warm, scale=0.5))
    assert simulate(MODEL, log, SOC0).notices == ()


def test_a_model_of_before_says_nothing():
    log = measured(BEFORE, drive(-20.0, scale=0.5))
    assert simulate(BEFORE, log, SOC0).notices == ()
    assert outside_notices(UNKNOWN, log, np.full(len(log), -3.0)) == []


def test_each_side_of_each_range_is_named():
    n = 1000
    part = np.arange(n)
    log = CellLog(
        part.astype(float),
        np.where(part < 100, -20.0, np.where(part < 300, 20.0, 0.0)),
        np.full(n, 3.7),
        temperature_C=np.where(part < 50, 60.0, 25.0),
    )
    soc = np.where(part < 400, 0.1, 0.95)
    valid = replace(VALID, soc=(0.3, 0.9))
    text = outside_notices(valid, log, soc)[0].text
    parts = ("10 % of the rows are below -6 A", "20 % of the rows are above 9 A", "to 60")
    socs = ("40 % of the rows are below SOC 0.30", "60 % of the rows are above SOC 0.90")
    for said in (*parts, *socs):
        assert said in text


def test_a_spike_is_no_use_outside():
    log = drive(25.0)
    current = np.array(log.current_A)
    current[[100, 2000]] = 500.0
    assert outside_notices(VALID, replace(log, current_A=current), np.full(6000, 0.5)) == []


def test_one_moment_names_what_is_outside():
    assert outside_moment(VALID, 0.5, 25.0, 1.0) is None
    assert outside_moment(VALID, 0.5, float("nan"), 1.0) is None
    assert outside_moment(VALID, 0.5, -10.0, 50.0) == (
        "temperature -10.0 degC (the model's data: 24.0 to 29.0), "
        "current 50.00 A (the model's data: -6.00 to 9.00)"
    )
