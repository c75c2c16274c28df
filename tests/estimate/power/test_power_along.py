"""The state of power along a replay; by the commands: tests/cli/test_power.py."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.power.state_of_power import power_settings
from cellwise.estimate.replay import replay
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell, within_its_error

CELL = curved_cell(voltage_min_V=2.8, voltage_max_V=4.2)
START = 0.7


def drive(rows=400, seed=1, model=CELL):
    """Loads of random size, ten seconds each, with the model's own voltage and a little noise."""
    rng = np.random.default_rng(seed)
    current = np.repeat(rng.uniform(-2.0, 7.0, rows // 10), 10)
    log = CellLog(np.arange(float(rows)), current, np.full(rows, 3.7), name="drive")
    found = simulate(model, log, START)
    return replace(log, voltage_V=found.voltage_V + rng.normal(0.0, 0.001, rows)), found


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["coulomb", "rest-ocv", "adaptive", "fixed-step", "filterpy-ekf", "filterpy-ukf"]
)
def test_every_estimator_has_a_power(name):
    """All know the start and see the model's own voltage: all say what the EKF says."""
    log, _ = drive()
    settings = power_settings(CELL, horizons_s=(10.0,))
    ekf, other = (
        replay(CELL, log, n, soc0=START, soc0_std=0.01, power=settings).power for n in ("ekf", name)
    )
    near = 0.12 if name == "adaptive" else 0.05  # it estimates an offset, too
    np.testing.assert_allclose(other.discharge_W[0, 60:], ekf.discharge_W[0, 60:], rtol=near)
    np.testing.assert_allclose(other.charge_W[0, 60:], ekf.charge_W[0, 60:], rtol=near)
    assert np.all(other.discharge_low_W < other.discharge_W)


@pytest.mark.slow
def test_the_bound_holds_for_a_cell_that_is_not_the_model():
    """Truths drawn within the model's own error: the bound is sustained in 95 of 100, at least.

    Judged by the truth itself: its voltage after ten seconds of the bound's power.
    """
    rng = np.random.default_rng(7)
    settings = power_settings(CELL, horizons_s=(10.0,), hold="current")
    held, worth = [], []
    for seed in range(60):
        truth = within_its_error(CELL, rng)
        log, _ = drive(100 + 10 * (seed % 20), seed, truth)
        found = replay(CELL, log, "ekf", soc0=START, soc0_std=0.03, power=settings)
        low = found.power.last[0].discharge
        current = low.power_low_W / low.voltage_V
        after = CellLog(
            np.concatenate((log.time_s, log.time_s[-1] + np.arange(1.0, 11.0))),
            np.concatenate((log.current_A, np.full(10, current))),
            np.full(len(log) + 10, 3.7),
        )
        held.append(simulate(truth, after, START).voltage_V[-1] >= 2.8)
        worth.append(low.power_low_W / low.power_W)
    assert np.mean(held) >= 0.9
    assert np.mean(worth) > 0.8  # and it is worth something


def test_a_power_without_limits_is_refused():
    log, _ = drive(50)
    with pytest.raises(InputError, match="no lower voltage limit for the power"):
        replay(curved_cell(), log, "ekf", soc0=START, power=True)
