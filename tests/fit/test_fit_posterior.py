"""The posterior: the prior where logs say nothing, less of it where they say something."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_file import model_from_dict, model_to_dict, read_model, write_model
from cellwise.cell.posterior import Posterior
from cellwise.cell.stock import named_model
from cellwise.errors import InputError
from cellwise.estimate.noise import Noise
from cellwise.estimate.replay import replay
from cellwise.fit.posterior import posterior_of, whole_resistance
from cellwise.fit.splines import OCV_KNOTS, spline_rows, spline_values
from cellwise.fit.unknowns import FitSettings
from fit_cases import CURVED, cells_like, fit_of, prior_for, two_logs
from synthetic import drive_current, driven_log, nmc_cell

SETTINGS = FitSettings(branches=2, ln_capacity_std=0.05)
GRID = np.linspace(0.0, 1.0, 21)


def fitted(weight: float):
    """Result, prior and posterior of two logs that count as much."""
    logs = [replace(item, weight=weight) for item in two_logs(CURVED, noise=5e-4)]
    cells = cells_like(1.3)
    result = fit_of(logs, cells, SETTINGS)
    prior, _ = prior_for(logs, cells, SETTINGS)
    return result, prior, posterior_of(result, prior, "made")


@pytest.fixture(scope="module")
def silent():
    return fitted(1e-12)


@pytest.fixture(scope="module")
def known():
    return fitted(1.0)


def test_logs_that_say_nothing_give_the_prior_back(silent):
    result, prior, posterior = silent
    np.testing.assert_allclose(result.theta, prior.mean, atol=1e-4)
    np.testing.assert_allclose(posterior.std, 1.0, atol=1e-4)
    np.testing.assert_allclose(posterior.factor, np.eye(posterior.std.size), atol=1e-4)
    assert posterior.capacity_std == pytest.approx(0.05, rel=1e-3)
    assert posterior.prior == "made"


def test_the_whole_resistance_is_that_of_all_branches_and_has_its_derivative(known):
    layout, theta = known[0].layout, known[0].theta
    soc = np.array([0.1, 0.47, 0.9])
    whole, slopes = whole_resistance(layout, theta, soc)
    doubled = whole_resistance(layout, theta + np.log(2.0) * layout.resistances(), soc)[0]
    np.testing.assert_allclose(doubled - whole, np.log(2.0), atol=1e-12)
    for k in np.flatnonzero(layout.resistances()):
        step = 1e-6 * np.eye(layout.size)[k]
        there = whole_resistance(layout, theta + step, soc)[0]
        np.testing.assert_allclose((there - whole) / 1e-6, slopes[:, k], atol=1e-5)


def test_a_draw_scatters_as_the_posterior_says(known):
    rng = np.random.default_rng(4)
    posterior = known[2]
    ln_capacity, ocv_V, ln_r = zip(*(posterior.draw(rng) for _ in range(4000)), strict=True)
    assert np.std(ln_capacity) == pytest.approx(posterior.capacity_std, rel=0.06)
    np.testing.assert_allclose(np.std(ocv_V, axis=0), posterior.ocv_std_V, rtol=0.1)
    np.testing.assert_allclose(np.std(ln_r, axis=0), posterior.ln_r_std, rtol=0.1)


def test_directions_hold_nearly_all_of_the_priors_ocv(silent):
    # Eight modes: what they leave is of short range.
    whole = np.sqrt(np.diag(cells_like(1.3).ocv_covariance(GRID)))
    np.testing.assert_allclose(silent[2].ocv_std_V, whole, rtol=0.15)


def test_evidence_narrows_every_direction_and_widens_none(known, silent):
    posterior = known[2]
    assert posterior.directions == silent[2].directions
    assert np.all(posterior.std <= 1.0 + 1e-6)
    assert posterior.std[posterior.directions.index("capacity_Ah")] < 0.7
    assert posterior.std[posterior.directions.index("resistance_mode_1")] < 0.5
    inside = slice(8, 19)
    assert np.all(posterior.ocv_std_V[inside] < 0.6 * silent[2].ocv_std_V[inside])


def test_what_is_stated_holds_the_truth(known):
    result, _, posterior = known
    assert abs(np.log(result.fitted_Ah / 3.0)) < 2.5 * posterior.capacity_std
    soc = GRID[4:20]
    found = spline_values(spline_rows(soc, OCV_KNOTS), result.theta[: result.layout.knots_ocv])
    assert np.all(np.abs(found) < 2.5 * posterior.ocv_std_V[4:20])


def carrying(posterior: Posterior):
    return replace(named_model("nmc-18650", 3.0), posterior=posterior)


def test_the_model_file_keeps_the_posterior(known, tmp_path):
    model = carrying(known[2])
    write_model(model, tmp_path / "model.json")
    read = read_model(tmp_path / "model.json")
    assert read.posterior is not None
    assert read.posterior.directions == known[2].directions
    assert read.posterior.prior == "made"
    for name in ("factor", "ln_capacity", "ocv_V", "ln_r"):
        one, other = getattr(read.posterior, name), getattr(known[2], name)
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-12)
    again = model_to_dict(read)["posterior"]
    written = json.loads((tmp_path / "model.json").read_text(encoding="utf-8"))["posterior"]
    assert {**again, "std": None} == {**written, "std": None}
    np.testing.assert_allclose(again["std"], written["std"], rtol=1e-4)


def test_a_model_without_one_has_no_entry():
    assert "posterior" not in model_to_dict(named_model("nmc-18650", 3.0))


@pytest.mark.parametrize(
    "change",
    [
        {"factor": [[1.0]]},
        {"ln_capacity": [0.0]},
        {"ocv_V": [[0.1, 0.2]]},
        {"ln_r": None},
        {"factor": "many"},
    ],
)
def test_tables_that_do_not_fit_are_refused(known, change):
    data = model_to_dict(carrying(known[2]))
    data["posterior"] = {**data["posterior"], **change}
    with pytest.raises(InputError):
        model_from_dict(data)


@pytest.mark.parametrize("estimator", ["ekf", "ukf", "adaptive"])
def test_a_capacity_that_is_open_widens_the_band_with_the_charge_that_flows(estimator):
    cell = nmc_cell(3.0)
    current = drive_current(2500, 1.0, 8.0, np.random.default_rng(3))
    log = replace(driven_log(cell, current, 1.0, soc=0.95, noise_V=1e-3), soc0=0.95)
    model = named_model("nmc-18650", 3.0)
    deaf = replace(Noise.of_model(model), error_scale=100.0)  # nothing but counting
    narrow, wide = (
        replay(model, log, estimator, noise=replace(deaf, capacity_share=share)).trace.soc_std
        for share in (0.0, 0.1)
    )
    used = float(np.ptp(log.counted_charge_Ah())) / 3.0
    assert used > 0.2
    assert np.all(wide >= narrow - 1e-12)
    assert wide[-1] > 1.2 * narrow[-1]


def test_the_filters_take_it_from_the_model(known):
    assert Noise.of_model(carrying(known[2])).capacity_share == known[2].capacity_std
    assert Noise.of_model(named_model("nmc-18650", 3.0)).capacity_share == 0.0
