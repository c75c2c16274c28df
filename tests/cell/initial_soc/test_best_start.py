"""The search for the best start finds the smallest error of all simulations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.initial_soc.best_start import best_start_soc
from cellwise.cell.simulate import simulate
from example_cells import curved_cell, lfp_cell, random_log

GRID = np.linspace(0.0, 1.0, 51)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("cell", [curved_cell, lfp_cell])
def test_it_is_the_best_of_all_simulations(cell, seed):
    rng = np.random.default_rng(seed)
    model = cell()
    log = random_log(rng, rows=80)
    voltage = simulate(model, log, float(rng.uniform())).voltage_V
    voltage = voltage + rng.normal(0.0, 0.003, 80)
    voltage[rng.integers(0, 80, 10)] = np.nan
    log = replace(log, voltage_V=voltage)
    cost = [np.nanmean(simulate(model, log, float(s)).error_V ** 2) for s in GRID]
    soc, rms = best_start_soc(model, log, GRID)
    assert soc == GRID[int(np.argmin(cost))]
    assert rms == pytest.approx(np.sqrt(min(cost)), rel=1e-12)


def test_of_equal_ones_it_is_the_first():
    model = curved_cell()
    log = random_log(np.random.default_rng(0), rows=20)
    log = replace(log, voltage_V=simulate(model, log, 0.5).voltage_V)
    assert best_start_soc(model, log, np.array([0.2, 0.5, 0.5]))[0] == 0.5
    soc, _ = best_start_soc(model, log, np.array([0.4, 0.4]))
    assert soc == 0.4
