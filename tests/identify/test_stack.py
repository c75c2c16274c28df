"""Models of several temperatures as one: each comes back at its own temperature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import Hysteresis, SlowDiffusion, TemperatureDependence, TimeSkew
from cellwise.cell.model import TABLES, CellModel
from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate
from cellwise.identify.stack import stack_models
from example_cells import curved_cell, random_log

GRID = np.linspace(0.0, 1.0, 101)


def cell_at(temperature_C: float, factor: float = 1.0, **changes) -> CellModel:
    base = curved_cell()
    tables = {n: factor * getattr(base, n) for n in ("r0_ohm", "r1_ohm", "r2_ohm")}
    return replace(base, **tables, temperature_C=np.array([temperature_C]), **changes)


def test_a_single_model_stays_as_it_is():
    model = cell_at(25.0, effects=(TemperatureDependence(2000.0, 25.0),))
    assert stack_models([model]) is model


def test_temperatures_are_sorted_and_tables_follow():
    models = [cell_at(25.0), cell_at(-10.0, 3.0), cell_at(10.0, 1.6)]
    stacked = stack_models(models)
    assert stacked.temperature_C.tolist() == [-10.0, 10.0, 25.0]
    for row, one in enumerate((models[1], models[2], models[0])):
        for name in TABLES:
            np.testing.assert_array_equal(getattr(stacked, name)[row], getattr(one, name)[0])


@pytest.mark.parametrize("temperature_C", [0.0, 25.0])
def test_at_its_own_temperature_a_model_simulates_as_alone(temperature_C):
    # Held log, both models with all effects: the axis changes nothing where a table stands.
    effects = (SlowDiffusion(0.01, 1500.0), Hysteresis(0.01, 50.0), TimeSkew(0.2))
    models = {t: cell_at(t, f, effects=effects) for t, f in ((0.0, 2.5), (25.0, 1.0))}
    log = random_log(np.random.default_rng(1), 400)
    log = replace(log, temperature_C=np.full(len(log), temperature_C))
    stacked = simulate(stack_models(list(models.values())), log, 0.7)
    alone = simulate(models[temperature_C], log, 0.7)
    np.testing.assert_allclose(stacked.voltage_V, alone.voltage_V, atol=1e-12)


def test_half_way_the_tables_are_the_mean():
    stacked = stack_models([cell_at(0.0, 3.0), cell_at(20.0, 1.0)])
    np.testing.assert_allclose(
        stacked.at_temperature(10.0).r0_ohm[0], 2.0 * curved_cell().r0_ohm[0], rtol=1e-12
    )


def test_the_arrhenius_factor_gives_way_to_the_axis():
    # Both at once would count the temperature twice.
    models = [cell_at(t, effects=(TemperatureDependence(2000.0, t),)) for t in (0.0, 25.0)]
    stacked = stack_models(models)
    assert stacked.effect(TemperatureDependence).activation_K == 0.0


def test_an_effect_that_one_lacks_is_neutral_there():
    slow = SlowDiffusion(np.full((1, 101), 0.02), np.full((1, 101), 2000.0))
    stacked = stack_models([cell_at(0.0, effects=(slow,)), cell_at(25.0)])
    r3 = np.asarray(stacked.effect(SlowDiffusion).r3_ohm)
    assert r3.shape == stacked.ocv_V.shape
    assert np.all(r3[0] == 0.02)
    assert np.all(r3[1] == 0.0)
    hysteresis = Hysteresis(0.03, 80.0)
    stacked = stack_models([cell_at(0.0), cell_at(25.0, effects=(hysteresis,))])
    m = np.asarray(stacked.effect(Hysteresis).m_V)
    assert np.all(m[0] == 0.0)
    assert np.all(m[1] == 0.03)
    assert stacked.effect(Hysteresis).gamma == pytest.approx(80.0)


def test_one_rate_of_hysteresis_between_those_found():
    effects = [(Hysteresis(0.02, g),) for g in (20.0, 180.0)]
    stacked = stack_models([cell_at(0.0, effects=effects[0]), cell_at(25.0, effects=effects[1])])
    assert stacked.effect(Hysteresis).gamma == pytest.approx(60.0)  # geometric mean


def test_the_skew_belongs_to_the_instrument():
    models = [cell_at(t, effects=(TimeSkew(s),) if s else ()) for t, s in
              ((0.0, 0.3), (10.0, 0.0), (25.0, 0.5))]  # fmt: skip
    assert stack_models(models).effect(TimeSkew).skew_s == pytest.approx(0.4)


def test_plain_models_get_no_effects():
    assert stack_models([cell_at(0.0), cell_at(25.0)]).effects == ()


def test_the_error_is_the_mean_of_squares():
    flat = ModelError.of_white_and_slow(0.001, (0.006,), 100.0, 0.1)
    bent = ModelError.of_white_and_slow(0.003, (0.002, 0.010), 700.0, 0.0)
    found = stack_models([cell_at(0.0, error=flat), cell_at(25.0, error=bent)]).error
    assert found.white_V == pytest.approx(np.sqrt((0.001**2 + 0.003**2) / 2))
    np.testing.assert_allclose(
        found.at(np.array([0.0, 1.0])),
        np.sqrt((0.006**2 + np.array([0.002, 0.010]) ** 2) / 2),
    )
    assert found.shown_share() == pytest.approx(np.sqrt(0.005))


def test_identity_and_limits_are_those_of_the_coldest():
    # What belongs to the cell is the same in all of them; the pipeline writes it once more.
    models = [cell_at(t, name="cell", chemistry="NMC") for t in (25.0, 0.0)]
    stacked = stack_models(models)
    assert (stacked.name, stacked.chemistry, stacked.capacity_Ah) == ("cell", "NMC", 3.0)
