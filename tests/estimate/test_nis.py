"""NIS by time scale: near 1 where a model errs as it states, and off on the scale where not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate as simulate_from
from cellwise.estimate.replay import replay
from example_cells import curved_cell
from virtual_tester import planned

ROWS = 12_000
SCALES_S = (0.1, 1.0, 10.0, 100.0, 1000.0)
STD_V = (0.001, 0.002, 0.002, 0.003, 0.004)
STATED = ModelError(
    scales_s=SCALES_S, std_V=tuple(((v,),) for v in STD_V), share=(0.0,) * 5, persistent_share=0.0
)


def process(scale_s, std_V, rng):
    """A first-order process at rows a second apart."""
    a = np.exp(-1.0 / scale_s)
    x = np.empty(ROWS)
    x[0] = std_V * rng.standard_normal()
    for k in range(1, ROWS):
        x[k] = a * x[k - 1] + std_V * np.sqrt(1.0 - a * a) * rng.standard_normal()
    return x


def drive(seed, factors=(1.0,) * 5):
    rng = np.random.default_rng(seed)
    current = np.repeat(rng.normal(0.6, 1.0, ROWS // 20), 20)
    log = planned(current)
    clean = simulate_from(curved_cell(), log, 0.9).voltage_V
    wrong = sum(process(s, f * v, rng) for s, v, f in zip(SCALES_S, STD_V, factors, strict=True))
    return replace(log, voltage_V=clean + wrong)


def nis(factors=(1.0,) * 5, runs=4):
    model = curved_cell(error=STATED)
    logs = [drive(seed, factors) for seed in range(runs)]
    return np.mean([replay(model, g, soc0=0.9, soc0_std=0.01).nis for g in logs], axis=0)


def test_an_error_as_stated_has_a_nis_near_one():
    # A process spreads over its neighbours; rows a second apart hold no faster one.
    found = nis()
    assert np.all(found[1:4] > 0.5)
    assert np.all(found[1:4] < 2.0)
    assert found[4] < 2.0


def test_an_error_that_is_larger_on_one_scale_shows_there():
    usual, larger = nis(), nis((1.0, 1.0, 1.0, 4.0, 1.0))
    assert np.argmax(larger / usual) == 3
    assert larger[3] / usual[3] > 5.0


@pytest.mark.parametrize(("unseen", "low", "high"), [(0.2, 0.5, 2.0), (0.0, 4.0, np.inf)])
def test_a_polarisation_that_no_test_could_show_is_stated_where_it_moves(unseen, low, high):
    """A fifth of every load's polarisation is missed, with loads that last five minutes."""
    model = curved_cell(error=replace(STATED, unseen_share=unseen))
    current = np.where(np.arange(ROWS) // 300 % 2 == 0, 1.2, 0.0)
    log = planned(current)
    clean = simulate_from(curved_cell(), log, 0.9)
    missed = 0.2 * (np.interp(clean.soc, model.soc, model.ocv_V[0]) - clean.voltage_V)
    found = replay(model, replace(log, voltage_V=clean.voltage_V - missed), soc0=0.9, soc0_std=0.01)
    assert low < found.nis[3] < high


def test_without_voltages_there_is_none():
    model, log = curved_cell(error=STATED), drive(0)
    held = np.where(np.arange(ROWS) < 10, log.voltage_V, np.nan)
    found = replay(model, replace(log, voltage_V=held), "ekf", soc0=0.9)
    assert found.nis is None


@pytest.mark.parametrize("estimator", ["ekf", "ukf", "adaptive"])
def test_every_filter_states_it_by_the_scales_of_the_model(estimator):
    found = replay(curved_cell(error=STATED), drive(1), estimator, soc0=0.9)
    assert len(found.nis) == len(SCALES_S)
    assert found.to_dict()["nis"] == list(found.nis)
