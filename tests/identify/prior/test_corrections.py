"""Corrections of a prior: none gives it back, and each does what its name says."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.effects import SlowDiffusion, TemperatureDependence
from cellwise.cell.stock import stock_model, stock_names
from cellwise.identify.prior.corrections import Corrections

WINDOW = np.array([1.5, 4.5])


def corrections(name="nmc-18650", capacity=5.0, std=0.1, window=WINDOW):
    return Corrections(stock_model(name), capacity, std, window)


@pytest.mark.parametrize("name", stock_names())
def test_no_correction_is_the_scaled_prior(name):
    c = corrections(name)
    model = c.model(np.zeros(c.size))
    assert model.capacity_Ah == pytest.approx(5.0)
    # The least rise of an OCV that can be inverted adds up to 0.1 mV over the grid.
    np.testing.assert_allclose(model.ocv_V, c.prior.ocv_V, atol=2e-4)
    np.testing.assert_allclose(model.r0_ohm, c.prior.r0_ohm, rtol=1e-12)


def test_the_usual_ocv_correction_is_as_large_as_the_prior_says():
    c = corrections()
    draws = np.random.default_rng(5).standard_normal((4000, c.size))
    spread = np.std(draws @ c.ocv_map.T, axis=0)
    expected = c.prior.error.at(c.prior.soc)
    middle = slice(30, 90)  # away from the steep end, where the size changes within a knot
    np.testing.assert_allclose(spread[middle], expected[middle], rtol=0.12)


@pytest.mark.parametrize("seed", range(20))
def test_the_ocv_is_monotone_and_in_the_window_whatever_the_correction(seed):
    c = corrections("nca-18650", window=np.array([2.5, 4.2]))
    model = c.model(4.0 * np.random.default_rng(seed).standard_normal(c.size))
    assert np.all(np.diff(model.ocv_V, axis=1) > 0.0)
    assert model.ocv_V.min() >= 2.5
    assert model.ocv_V.max() <= 4.2 + 1e-3
    assert np.all(model.tau1_s < model.tau2_s)


def test_the_slow_branches_go_together():
    c = corrections()
    z = np.random.default_rng(1).standard_normal(c.size)
    model = c.model(z)
    slow = np.asarray(model.effect(SlowDiffusion).r3_ohm)
    before = np.asarray(c.prior.effect(SlowDiffusion).r3_ohm)
    np.testing.assert_allclose(slow / before, model.r2_ohm / c.prior.r2_ohm, rtol=1e-12)


@pytest.mark.parametrize("name", stock_names())
def test_no_correction_leaves_what_a_model_may_be(name):
    """A kind of cell that cannot follow a log goes to its bounds, and is no error."""
    c = corrections(name)
    low, high = TemperatureDependence.bounds["activation_K"]
    for size in (-100.0, 100.0):
        warm = c.model(np.full(c.size, size)).effect(TemperatureDependence)
        assert warm is None or low <= warm.activation_K <= high
