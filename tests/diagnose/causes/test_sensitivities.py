"""Steps of the derivatives of a whole log: by every coordinate as by central differences."""

from __future__ import annotations

import numpy as np

from cellwise.cell.effects import Hysteresis, RateDependence, SelfHeating, SlowDiffusion
from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.diagnose.causes.catalogue import CAUSES, UNSEEN_TEMPERATURE
from cellwise.diagnose.causes.coordinates import R_NAMES, Coordinates
from cellwise.diagnose.fit.rows import gather
from example_cells import linear_cell, random_log

START = InitialSoc(0.8, 0.01, "given")
EVERY = {c for cause in (*CAUSES.values(), UNSEEN_TEMPERATURE) for c in cause.coordinates}
EVERY |= {*R_NAMES, "ln_r0", "ln_r2", "ln_tau1", "ln_tau2", "ln_slow_r", "ln_slow_tau"}


def model_with_effects():
    model = linear_cell()
    for effect in (SlowDiffusion(0.01, 900.0), Hysteresis(0.01, 20.0), RateDependence(0.05),
                   SelfHeating(4.0, 300.0)):  # fmt: skip
        model = model.with_effect(effect)
    return model


def test_derivatives_are_those_of_the_simulation():
    log = random_log(np.random.default_rng(3), 400)
    coordinates = Coordinates(model_with_effects())
    evidence = gather(coordinates.model, [(log, START)])
    point = {"offset_A": 0.02, "ln_gain": 0.01, "skew_s": 0.03, "activation_K": 800.0}
    names = [*sorted(EVERY - {"soc0"}), "soc0:0"]
    for name, found in zip(names, evidence.jacobian(coordinates, point, names).T, strict=True):
        step = 1e-5 * (1000.0 if name == "activation_K" else 1.0)
        ends = [
            evidence.simulate(coordinates, {**point, name: point.get(name, 0.0) + sign * step})[0]
            for sign in (1.0, -1.0)
        ]
        expected = (ends[0] - ends[1]) / (2.0 * step)
        near = 1e-3 * np.abs(expected).max() + 1e-8  # an even law has second differences
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=near, err_msg=name)
