"""How hidden effects are counted, and that hiding one in a log does what it says."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from emulator import Sensor, emulate, flat, measure
from emulator_cells import MODEL_POINTS, Misfit, known_model, random_cell
from emulator_drives import random_load
from emulator_effects import EFFECTS, NAMES, World, draw_effect
from hidden_cases import Plan, hidden_case
from hidden_score import judge
from hide import emulated_cell, hide_in

PERFECT = Misfit(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def told(verdict: str, parameters: dict[str, float], before: float = 0.01, after: float = 0.002):
    """A diagnosis as the package gives it, made by hand."""
    cause = SimpleNamespace(
        name=verdict,
        parameters=parameters,
        holdout_rmse_before_V=before,
        holdout_rmse_after_V=after,
    )
    causes = () if verdict in ("none", "undetermined") else (cause,)
    return SimpleNamespace(verdict=verdict, causes=causes, candidates=(), extended_model=None)


@pytest.mark.parametrize("name", [n for n in NAMES if n != "ocv_shift"])
def test_the_truth_itself_has_no_error_and_neutral_has_all_of_it(name):
    def case():
        return hidden_case(5, (name,), 0.01, Plan(rows=600, model="known", misfit=PERFECT))

    truth = case().open(told("none", {}))
    right = judge(case(), told(name, truth.effects[0].parameters))
    assert right.right
    assert right.parameter_error == 0.0
    wrong = judge(case(), told("undetermined", {}))
    assert not wrong.right
    assert math.isnan(wrong.parameter_error)
    neutral = {
        "current_gain": {"gain": 1.0},
        "initial_soc": {"soc0": truth.soc0[0]},
        "capacity": {"capacity_Ah": case().model.capacity_Ah},
        "resistance_scale": {"scale": 1.0},
        "charge_asymmetry": {"charge_scale": 1.0},
        "charge_transfer": {"exchange_scale": 1.0},
    }.get(name, dict.fromkeys(truth.effects[0].parameters, 0.0))
    assert judge(case(), told(name, neutral)).parameter_error == pytest.approx(1.0)


def test_what_is_gained_is_counted_against_what_can_be_gained():
    case = hidden_case(5, ("capacity",), 0.01, Plan(rows=600))
    possible = case.open(told("none", {})).possible_rmse_V
    half = told("capacity", {"capacity_Ah": 1.0}, 0.01, 0.5 * (0.01 + possible))
    assert judge(case, half).gain_share == pytest.approx(0.5)


@pytest.mark.parametrize("name", NAMES)
def test_hiding_in_a_log_gives_the_log_of_a_cell_that_has_it(name):
    """An emulated log stands for a measured one: then what should come out is known."""
    rng = np.random.default_rng(3)
    warm = 2500.0 if name == "self_heating" else 0.0
    cell = random_cell(rng, "nmc", activation_K=warm)
    model = known_model(cell, rng, PERFECT)
    cell = emulated_cell(model)  # the emulator's own, on the model's grid
    load = random_load(
        rng, cell.capacity_Ah, 0.9, rows=1500, rate_hz=1.0, charge=True, temperature_C=(10, 40)
    )
    plain = World(cell)
    changed, _ = EFFECTS[name][0](plain, replace(draw_effect(rng), sign=-1.0), 3.0)
    state = (load.time_s, load.current_A, load.temperature_C)
    log = measure(emulate(cell, *state, 0.9), Sensor(), rng)
    run = emulate(changed.cell, *state, 0.9 + changed.soc0_shift)
    expected = measure(run, changed.sensor, rng)
    hidden = hide_in(log, plain, changed, 0.9, "log")
    assert np.allclose(hidden.current_A, expected.current_A, atol=1e-12)
    assert np.allclose(hidden.voltage_V, expected.voltage_V, atol=1e-9)


def test_a_models_tables_are_the_emulated_cells():
    rng = np.random.default_rng(4)
    cell = random_cell(rng, "lfp", third=True, activation_K=2000.0)
    back = emulated_cell(known_model(cell, rng, PERFECT))
    soc = np.linspace(0.0, 1.0, MODEL_POINTS)
    for name in ("ocv_V", "r0_ohm", "r1_ohm", "tau1_s", "r2_ohm", "tau2_s", "r3_ohm", "tau3_s"):
        assert np.allclose(getattr(back, name)(soc), getattr(cell, name)(soc), rtol=1e-12)
    assert back.m_V(soc) == pytest.approx(flat(0.0)(soc))
