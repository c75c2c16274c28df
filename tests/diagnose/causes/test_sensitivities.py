"""Derivatives of a whole log against finite differences; what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import cellwise
from cellwise.cell.effects import Hysteresis, RateDependence, SelfHeating, SlowDiffusion
from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.cell.simulate import simulate
from cellwise.diagnose import diagnose
from cellwise.diagnose.causes.catalogue import CAUSES, UNSEEN_TEMPERATURE
from cellwise.diagnose.causes.coordinates import R_NAMES, Coordinates
from cellwise.diagnose.fit.rows import gather
from cellwise.logs.cell_log import CellLog
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


@pytest.mark.parametrize("name", [*sorted(EVERY - {"soc0"}), "soc0:0"])
def test_derivatives_are_those_of_the_simulation(name):
    log = random_log(np.random.default_rng(3), 400)
    coordinates = Coordinates(model_with_effects())
    evidence = gather(coordinates.model, [(log, START)])
    point = {"offset_A": 0.02, "ln_gain": 0.01, "skew_s": 0.03, "activation_K": 800.0}
    step = 1e-5 * (1000.0 if name == "activation_K" else 1.0)
    ends = [
        evidence.simulate(coordinates, {**point, name: point.get(name, 0.0) + sign * step})[0]
        for sign in (1.0, -1.0)
    ]
    expected = (ends[0] - ends[1]) / (2.0 * step)
    found = evidence.jacobian(coordinates, point, [name])[:, 0]
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-3 * (np.abs(expected).max() + 1e-9))


def test_a_neutral_point_is_the_plain_simulation():
    log = random_log(np.random.default_rng(4), 400)
    model = model_with_effects()
    voltage, _ = gather(model, [(log, START)]).simulate(Coordinates(model), {})
    assert voltage == pytest.approx(simulate(model, log, 0.8).voltage_V, abs=1e-12)


def test_too_little_and_another_cell_are_undetermined_and_say_why():
    model = linear_cell()
    time = np.arange(600.0)
    quiet = CellLog(time, np.zeros(600), np.full(600, 3.7))
    assert diagnose(model, quiet).verdict == "undetermined"
    assert "too quiet" in diagnose(model, quiet).reasons[0]
    short = CellLog(time[:40], np.ones(40), np.full(40, 3.7))
    assert "too short" in diagnose(model, short).reasons[0]
    other = CellLog(time, np.ones(600) * model.capacity_Ah, np.full(600, 1.2))
    found = diagnose(model, other, soc0=0.5)
    assert found.verdict == "undetermined"
    assert "another cell" in found.reasons[0]
    assert not found.causes


@pytest.mark.parametrize("causes", [["rust"], ["current_offset", "moon"]])
def test_unknown_causes_are_refused(causes):
    log = random_log(np.random.default_rng(6), 400)
    with pytest.raises(cellwise.InputError, match=causes[-1]):
        diagnose(linear_cell(), log, causes=causes)
