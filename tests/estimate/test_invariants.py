"""What holds for every estimator with every effect, since all of them step the same cell."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.effects import EFFECTS
from estimator_cases import ACTIVE, NEUTRAL, Rows, follow
from example_cells import curved_cell

WARM = (ACTIVE["temperature_dependence"], ACTIVE["self_heating"])
FLOAT64 = ("ekf", "ukf", "adaptive", "lockstep", "filterpy-ekf", "filterpy-ukf")


def test_every_effect_is_here():
    assert set(ACTIVE) == set(NEUTRAL) == set(EFFECTS)


@pytest.mark.parametrize("name", FLOAT64)
def test_over_a_gap_heat_only_decays(name):
    """Nobody knows what flowed, so nothing heats: exp(-gap / thermal_s) of it is left."""
    model = curved_cell(effects=WARM)
    pause = 1.0 if name == "lockstep" else 300.0  # the lockstep has one time step
    rows = Rows.of([0.0, *[5.0] * 120]).interval(100, pause, gap=True)
    heat = follow(name, model, rows, 0.8).heat_K
    assert heat[99] > 0.1
    left = np.exp(-pause / ACTIVE["self_heating"].thermal_s)
    assert heat[100] == pytest.approx(left * heat[99], rel=1e-12)
    assert heat[101] > heat[100]
