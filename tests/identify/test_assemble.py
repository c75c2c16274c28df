"""From a fit to a model: the same voltage, a monotone OCV, effects only where fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import Hysteresis, SlowDiffusion, TemperatureDependence, TimeSkew
from cellwise.cell.simulate import simulate
from cellwise.fit.rows import FitLog
from cellwise.fit.splines import SOC_GRID
from cellwise.fit.unknowns import FitSettings
from cellwise.identify.assemble import fitted_model
from fit_cases import CURVED, Truth, cells_like, fit_of, log_of, pulse_current, two_logs


def fitted(truth, *, branches=2, skewed=False, warm=False):
    logs = two_logs(truth, noise=5e-4, warm=warm)
    settings = FitSettings(branches=branches, hysteresis=bool(truth.m_V), skew=skewed)
    result = fit_of(logs, cells_like(1.2, 0.01 if truth.m_V else 0.0), settings)
    return logs, result, fitted_model(result, cells_like(), skewed, warm)


@pytest.fixture(scope="module")
def plain():
    return fitted(CURVED)


def test_the_model_simulates_what_was_fitted(plain):
    # Splines on 15 knots against tables of 201 points, merged rows against all rows.
    logs, result, model = plain
    for item, residual, prepared in zip(logs, result.residual_V, result.logs, strict=True):
        error = simulate(model, item.log, item.soc0).residual_V
        at = np.searchsorted(item.log.time_s, prepared.time_s)
        assert np.sqrt(np.mean((error[at] - residual) ** 2)) < 5e-4


def test_tables_are_positive_ordered_and_on_the_grid(plain):
    model = plain[2]
    assert model.ocv_V.shape == (1, SOC_GRID.size)
    assert np.all(np.diff(model.ocv_V) > 0.0), "strictly: the OCV is inverted"
    assert np.all(model.tau2_s > model.tau1_s)


def test_effects_that_were_fitted():
    truth = Truth(m_V=0.02, gamma=100.0, skew_s=0.3, activation_K=3000.0)
    _, result, model = fitted(truth, skewed=True, warm=True)
    assert np.median(model.effect(Hysteresis).m_V) == pytest.approx(0.02, rel=0.2)
    assert model.effect(TimeSkew).skew_s == pytest.approx(0.3, abs=0.05)
    assert model.effect(TemperatureDependence).activation_K == pytest.approx(3000.0, rel=0.1)
    names = {e.name for e in fitted_model(result, cells_like(), False, False).effects}
    assert names == {"hysteresis"}, "nobody measured the rest"


def test_the_slow_branch_becomes_an_effect():
    _, _, model = fitted(Truth(), branches=3)
    assert np.all(np.asarray(model.effect(SlowDiffusion).tau3_s) > model.tau2_s)


def test_what_no_log_has_seen_is_admitted():
    # A log that stops at 60 %: below, the standard error must say that nothing is known.
    log, _ = log_of(pulse_current(4), CURVED)
    noise_V = 5e-4 * np.random.default_rng(1).normal(size=len(log))
    result = fit_of([FitLog(replace(log, voltage_V=log.voltage_V + noise_V), 1.0)], cells_like(1.2))
    std = result.theta_std[result.layout.r0 : result.layout.r0 + result.layout.knots]
    assert std[1] > 5.0 * std[-3]
