"""What a fit left open of a model: marginals, the model file, what other capacities make of it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model import CAPACITY_STD
from cellwise.cell.model_file import model_from_dict, model_to_dict
from cellwise.cell.posterior import POINTS, Posterior
from cellwise.cell.simulate import simulate
from cellwise.cell.stock import scaled_model, stock_model
from cellwise.errors import InputError
from cellwise.estimate.noise import Noise
from cellwise.logs import CellLog

SOC = np.linspace(0.0, 1.0, POINTS)


@pytest.fixture
def posterior():
    """Capacity, OCV and resistance, which the logs have tied to each other."""
    nothing = np.zeros(POINTS)
    return Posterior(
        directions=("capacity_Ah", "ocv_mode_1", "resistance_mode_1"),
        factor=np.array([[0.5, 0.0, 0.0], [0.3, 0.4, 0.0], [-0.2, 0.1, 0.6]]),
        ln_capacity=np.array([0.1, 0.0, 0.0]),
        ocv_V=np.array([nothing, 0.02 * np.cos(3.0 * SOC), nothing]),
        ln_r=np.array([nothing, nothing, 0.5 + 0.1 * SOC]),
        prior="population of layered cells",
    )


@pytest.fixture
def model(posterior):
    return replace(stock_model("nmc-18650"), posterior=posterior)


def draining(hours=0.8, rate=1.0):
    time_s = np.arange(0.0, 3600.0 * hours, 10.0)
    return CellLog(time_s, np.full(time_s.size, 2.9 * rate), np.full(time_s.size, 3.6))


def test_deviations_are_those_of_draws(posterior):
    z = np.random.default_rng(0).standard_normal((200_000, 3)) @ posterior.factor.T
    assert posterior.capacity_std == pytest.approx(np.std(z @ posterior.ln_capacity), rel=0.01)
    np.testing.assert_allclose(posterior.ocv_std_V, np.std(z @ posterior.ocv_V, axis=0), rtol=0.01)
    np.testing.assert_allclose(posterior.ln_r_std, np.std(z @ posterior.ln_r, axis=0), rtol=0.01)


@pytest.mark.parametrize("std", [0.0, 0.03])
def test_another_capacity_leaves_the_marginals_of_the_rest(posterior, std):
    other = posterior.with_capacity_std(std)
    assert other.capacity_std == pytest.approx(std)
    np.testing.assert_allclose(other.ocv_std_V, posterior.ocv_std_V, rtol=1e-6)
    np.testing.assert_allclose(other.ln_r_std, posterior.ln_r_std, rtol=1e-6)
    assert np.all(np.triu(other.factor, 1) == 0.0)


def test_the_model_file_keeps_it(model):
    back = model_from_dict(json.loads(json.dumps(model_to_dict(model)))).posterior
    assert back.directions == model.posterior.directions
    assert back.prior == model.posterior.prior
    for name in ("factor", "ln_capacity", "ocv_V", "ln_r"):
        np.testing.assert_allclose(
            getattr(back, name), getattr(model.posterior, name), rtol=1e-4, atol=1e-12
        )


@pytest.mark.parametrize(
    "wrong", [{"ln_capacity": [0.1]}, {"factor": [[1.0]]}, {"ocv_V": [[float("nan")] * POINTS] * 3}]
)
def test_what_does_not_fit_together_is_refused(posterior, wrong):
    with pytest.raises(InputError, match="posterior of 3 directions"):
        Posterior.of_dict({**posterior.to_dict(), **wrong})


def test_the_capacity_is_known_as_the_posterior_says(model, posterior):
    assert model.capacity_std_Ah == pytest.approx(posterior.capacity_std * model.capacity_Ah)
    assert Noise.of_model(model).capacity_share == pytest.approx(posterior.capacity_std)
    assert model.capacity_share == pytest.approx(max(CAPACITY_STD, posterior.capacity_std))


def test_a_capacity_that_the_user_states_is_the_users(model):
    scaled = scaled_model(model, 5.0)
    assert Noise.of_model(scaled).capacity_share == 0.0
    assert scaled.capacity_std_Ah == scaled_model(stock_model("nmc-18650"), 5.0).capacity_std_Ah
    np.testing.assert_allclose(scaled.posterior.ocv_std_V, model.posterior.ocv_std_V, rtol=1e-6)


def test_the_band_of_a_simulation_grows_with_what_flows_over_an_open_capacity(model):
    known = replace(model, posterior=model.posterior.with_capacity_std(0.0))
    more, band = [], {}
    for hours in (0.05, 0.8):
        log = draining(hours)
        open_V, known_V = (simulate(m, log, 1.0).band_V for m in (model, known))
        more.append(np.sqrt(open_V**2 - known_V**2))
        band[hours] = open_V
    assert more[0] < 0.2 * more[1]
    assert simulate(model, draining(), 1.0).to_dict()["band_V"] == band[0.8]
