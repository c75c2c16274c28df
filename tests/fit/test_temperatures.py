"""Several temperatures fitted together: a known cell comes back at each and between them."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.fit.rows import FitLog, prepare_log
from cellwise.fit.solve import FitResult
from cellwise.fit.splines import TABLE_KNOTS, spline_rows, spline_values
from cellwise.fit.unknowns import FitSettings
from cellwise.identify.assemble import KEPT, fitted_model
from fit_cases import CAPACITY_AH, Truth, cells_like, fit_of, log_of, pulse_current

GRID_C = np.array([0.0, 12.0, 25.0])
ACTIVATION_K = 3000.0
INSIDE = np.linspace(0.2, 0.95, 30)
TRUTH = Truth(activation_K=ACTIVATION_K)
BASE = cells_like().base()


def factor(temperature_C: float) -> float:
    return float(np.exp(ACTIVATION_K * (1.0 / (temperature_C + 273.15) - 1.0 / 298.15)))


@pytest.fixture(scope="module")
def result() -> FitResult:
    rng = np.random.default_rng(3)
    logs = []
    for t in GRID_C:
        current = pulse_current()
        warm = np.full(current.size, t)
        log, _ = log_of(current, TRUTH, noise=5e-4, rng=rng, temperature_C=warm)
        logs.append(FitLog(log, 1.0, temperature_C=float(t)))
    return fit_of(logs, cells_like(1.2), FitSettings(branches=2), tuple(GRID_C))


@pytest.mark.parametrize("temperature_C", [0.0, 6.0, 12.0, 18.0, 25.0])
def test_resistances_at_and_between_the_temperatures(result, temperature_C):
    row = result.at(temperature_C)
    splines = spline_rows(INSIDE, TABLE_KNOTS)
    for at, true in ((row.layout.r0, TRUTH.r0), (row.layout.r(1), TRUTH.pairs[1][0])):
        found = np.exp(spline_values(splines, row.theta[at : at + row.layout.knots]))
        np.testing.assert_allclose(found, factor(temperature_C) * true(INSIDE), rtol=0.05)


def test_the_model_has_rows_close_enough_and_the_cells_resistance(result):
    model = fitted_model(result, cells_like(1.2), skewed=False, hot=True)
    assert set(GRID_C) <= set(model.temperature_C)
    shown = (model.temperature_C >= GRID_C[0]) & (model.temperature_C <= GRID_C[-1])
    assert np.diff(model.temperature_C[shown]).max() <= KEPT.step_K
    for t in (3.0, 9.0, 20.0):
        r0 = model.at_temperature(t).r0_ohm[0, 50:180]
        np.testing.assert_allclose(r0, 0.025 * factor(t), rtol=0.05)


@pytest.mark.parametrize("temperature_C", [-20.0, -10.0, 35.0, 45.0])
def test_beyond_the_grid_the_model_goes_on_as_cells_do(result, temperature_C):
    # Held at the last row it would be off by the whole activation: 23 % at 10 K, 44 % at 20 K.
    model = fitted_model(result, cells_like(1.2), skewed=False, hot=True)
    r0 = model.at_temperature(temperature_C).r0_ohm[0, 50:180]
    np.testing.assert_allclose(r0, 0.025 * factor(temperature_C), rtol=0.15)


def test_beyond_the_grid_the_tables_go_on_for_half_a_step(result):
    colder, far, farther = (result.at(t).theta[result.layout.r0] for t in (-5.0, -6.5, -60.0))
    assert far > colder
    assert farther == result.at(-90.0).theta[result.layout.r0]


def test_a_log_brings_only_temperatures_at_which_charge_flowed():
    # Two hours of soaking from 25 degC, then a load at 1 degC: the soak says nothing.
    current = np.concatenate((np.zeros(7200), np.full(1800, 2.0)))
    degrees = np.concatenate((np.linspace(25.0, 1.0, 7200), np.full(1800, 1.0)))
    log, _ = log_of(current, TRUTH, temperature_C=degrees)
    prepared = prepare_log(FitLog(log, 1.0), BASE, CAPACITY_AH, 25.0, grid_C=GRID_C)
    assert (prepared.first_temperature, prepared.temperatures) == (0, 2)


def test_rows_of_long_logs_are_chosen_evenly():
    log, _ = log_of(pulse_current(), TRUTH)
    item = FitLog(log, 1.0)
    every = prepare_log(item, BASE, CAPACITY_AH, 25.0, most_rows=10**9)
    some = prepare_log(item, BASE, CAPACITY_AH, 25.0, most_rows=every.compared // 3)
    assert some.compared == every.compared // 3
    assert set(some.time_s) <= set(every.time_s)
    # Seconds after an edge keep their share.
    short = [np.mean(np.diff(p.time_s) < 60.0) for p in (every, some)]
    assert short[1] > 0.8 * short[0]
