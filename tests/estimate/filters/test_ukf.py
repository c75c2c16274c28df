"""The UKF against filterpy's, which takes all eleven sigma points, and the Kalman filter."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from test_ekf_oracle import (
    OPEN_GATE,
    assert_is_the_kalman_filter,
    difficult_log,
    kalman_log,
)

from cellwise.cell.effects import (
    ChargeAsymmetry,
    Hysteresis,
    RateDependence,
    SlowDiffusion,
)
from cellwise.errors import InputError
from cellwise.estimate.filters.filterpy_filters import FilterpyEkf, FilterpyUkf
from cellwise.estimate.filters.kalman import Ekf, SigmaPoints, Ukf
from cellwise.estimate.noise import Noise
from example_cells import EFFECTS, curved_cell, linear_cell, random_log, random_model
from virtual_tester import logged

# Every point with the resistances of its own SOC, as filterpy's.
POINTS = tuple(
    SigmaPoints(*shape, resistances_from=0.0)
    for shape in ((1.0, 0.0, -2.0), (1.0, 2.0, 0.0), (0.3, 2.0, -1.0))
)
FIGURES = ("soc", "soc_std", "voltage_V", "innovation_V", "innovation_variance_V2")


def ukf_pair(points):
    return partial(Ukf, points=points, components=1), partial(FilterpyUkf, points=points)


PAIRS = [*map(ukf_pair, POINTS), (Ekf, FilterpyEkf)]
NAMES = ["UKF", "far out", "close", "EKF"]


@pytest.mark.parametrize("pair", PAIRS, ids=NAMES)
@pytest.mark.parametrize("seed", range(3))
def test_it_is_filterpys_which_takes_all_eleven_points(pair, seed):
    """Mean, deviation, prediction and its variance, off the knots; the UKF 10 points wide."""
    rng = np.random.default_rng(20 + seed)
    model = random_model(rng, temperatures=1 + seed)
    noise = Noise(
        current_A=0.02,
        gate=OPEN_GATE,
        mismatch_cap=0.0,
        gap_soc=0.002,
        lasting_share=0.0,
        offset_share=0.0,
    )
    log = difficult_log(rng, model, rows=320)
    std = 0.015 if pair[0] is Ekf else 0.1
    ours, theirs = (kind(model, noise).run(log, 0.503, std) for kind in pair)
    for name in FIGURES:
        np.testing.assert_allclose(
            getattr(ours, name), getattr(theirs, name), rtol=1e-7, atol=1e-9, err_msg=name
        )


@pytest.mark.parametrize(
    "effects",
    [
        (),
        EFFECTS,
        (SlowDiffusion(0.02, 900.0), RateDependence(0.1), ChargeAsymmetry(1.3)),
        (Hysteresis(0.03, 60.0),),
    ],
    ids=["plain", "all", "rate and asymmetry", "hysteresis"],
)
def test_it_agrees_with_filterpy_whatever_the_effects(effects):
    model = curved_cell(effects=effects)
    rng = np.random.default_rng(4)
    noise = Noise(gate=OPEN_GATE, mismatch_cap=0.0, lasting_share=0.0, offset_share=0.0)
    log = random_log(rng, 250, temperature_C=(0.0, 40.0))
    log = logged(model, log, 0.8, 0.003 * rng.standard_normal(250))
    pair = partial(Ukf, components=1), FilterpyUkf
    ours, theirs = (f(model, noise, POINTS[0]).run(log, 0.603, 0.15) for f in pair)
    for name in FIGURES:
        np.testing.assert_allclose(
            getattr(ours, name), getattr(theirs, name), rtol=1e-7, atol=1e-9, err_msg=name
        )


@pytest.mark.parametrize("points", POINTS)
def test_on_a_linear_cell_it_is_the_kalman_filter(points):
    assert_is_the_kalman_filter(
        lambda model, noise: Ukf(model, noise, points, components=1),
        mean=1e-10, covariance=1e-7, likelihood=1e-9,
    )  # fmt: skip


def test_on_a_linear_cell_it_is_the_ekf():
    model = linear_cell(effects=(SlowDiffusion(0.02, 700.0),))
    log = kalman_log(model)
    a, b = (f.run(log, 0.5, 0.1) for f in (Ekf(model, components=1), Ukf(model, components=1)))
    for name in FIGURES:
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("held", [True, False])
def test_resistances_that_change_with_soc_vouch_for_it_only_if_asked(held):
    """On a straight OCV what is left between EKF and UKF are the resistances' slopes."""
    model = linear_cell()
    model = replace(model, r0_ohm=model.r0_ohm * np.linspace(3.0, 1.0, model.r0_ohm.shape[1]))
    log = kalman_log(model)
    points = SigmaPoints(resistances_from=0.02 if held else 0.0)
    ekf, ukf = Ekf(model).run(log, 0.6, 0.01), Ukf(model, points=points).run(log, 0.6, 0.01)
    apart = float(np.max(np.abs(ekf.soc - ukf.soc)))
    assert apart < 1e-9 if held else apart > 1e-5


def test_its_mean_sees_the_bend_of_the_ocv():
    """At one standard deviation the OCV is not on its tangent: the expected voltage is the mean."""
    model = curved_cell()
    soc, std = 0.25, 0.05
    alone = Ukf(model, components=1)
    _, info = alone.step(alone.init(soc, std), 0.0, np.nan, 25.0, dt_s=0.0)
    nodes, weights = np.polynomial.hermite_e.hermegauss(3)
    points = np.interp(soc + std * nodes, model.soc, model.ocv_V[0])
    assert info.voltage_V == pytest.approx(points @ weights / weights.sum(), abs=1e-12)
    tangent = np.interp(soc, model.soc, model.ocv_V[0])
    assert abs(info.voltage_V - tangent) > 1e-4


@pytest.mark.parametrize(
    "changes",
    [
        {"alpha": 0.0},
        {"kappa": -5.0},
        {"beta": np.nan},
        {"alpha": -1.0},
        {"resistances_from": -0.1},
    ],
)
def test_sigma_points_that_make_no_sense_are_refused(changes):
    with pytest.raises(InputError):
        SigmaPoints(**changes)
