"""Slower diffusion in a cell whose model has a slow branch: no third branch, both have grown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise import simulate
from cellwise.cell.effects import SlowDiffusion
from cellwise.cell.model_error import ModelError
from cellwise.diagnose import diagnose
from cellwise.diagnose.applied import extend_model
from cellwise.diagnose.causes.catalogue import CAUSES, forms_of
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell
from random_loads import random_load

SOC0, R3_OHM, TAU3_S = 0.9, 0.015, 900.0
GROWN, LONGER = 1.8, 1.5
MODEL = replace(
    curved_cell(), error=ModelError.of_white_and_slow(1e-3, (1e-3,), 60.0, 0.01)
).with_effect(SlowDiffusion(R3_OHM, TAU3_S))
SLOW = CAUSES["slow_diffusion"]
SLOWER = {"ln_slow_r": float(np.log(GROWN)), "ln_slow_tau": float(np.log(LONGER))}


def test_both_slow_branches_grow_and_nothing_else():
    coordinates = Coordinates(MODEL)
    changed = extend_model(coordinates, SLOWER, {})
    slow = changed.effect(SlowDiffusion)
    assert changed.r2_ohm == pytest.approx(GROWN * MODEL.r2_ohm)
    assert changed.tau2_s == pytest.approx(LONGER * MODEL.tau2_s)
    assert np.asarray(slow.r3_ohm) == pytest.approx(GROWN * R3_OHM)
    assert np.asarray(slow.tau3_s) == pytest.approx(LONGER * TAU3_S)
    assert changed.r0_ohm == pytest.approx(MODEL.r0_ohm)
    assert changed.r1_ohm == pytest.approx(MODEL.r1_ohm)
    said = forms_of(SLOW, coordinates)[1].values(coordinates, SLOWER, SOC0)
    assert said == pytest.approx({"r3_ohm": GROWN * R3_OHM, "tau3_s": LONGER * TAU3_S})


def test_a_model_without_a_slow_branch_gets_one():
    assert forms_of(SLOW, Coordinates(curved_cell())) == (SLOW,)
    assert len(forms_of(SLOW, Coordinates(MODEL))) == 2


def test_at_a_temperature_that_nobody_has_measured_it_is_what_the_cold_does():
    assert forms_of(SLOW, Coordinates(MODEL, unseen_C=-5.0)) == (SLOW,)


@pytest.mark.slow
def test_it_is_named_with_its_size_and_nothing_beside_it():
    """One branch alone said 488 s where 1350 are true: it stood between the two that had grown."""
    cell = extend_model(Coordinates(MODEL), SLOWER, {})
    rng, logs = np.random.default_rng(8), []
    for _ in range(2):
        load = random_load(
            rng, cell.capacity_Ah, SOC0, rows=4000, rate_hz=1.0, charge=True,
            temperature_C=(25.0, 25.0),
        )  # fmt: skip
        log = CellLog(load.time_s, load.current_A, np.full(load.time_s.size, 3.7))
        voltage = simulate(cell, log, SOC0).voltage_V + 1e-3 * rng.normal(size=len(log))
        logs.append(replace(log, voltage_V=voltage))
    names = ("slow_diffusion", "hysteresis", "resistance_scale", "ocv_shift")
    found = diagnose(MODEL, logs[:1], holdout=logs[1:], soc0=SOC0, causes=names)
    assert [c.name for c in found.causes] == ["slow_diffusion"]
    values = found.causes[0].parameters
    assert values["r3_ohm"] == pytest.approx(GROWN * R3_OHM, rel=0.2)
    assert values["tau3_s"] == pytest.approx(LONGER * TAU3_S, rel=0.2)
