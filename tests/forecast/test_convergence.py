"""Convergence predicted from model and current, against what filters then took."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate
from cellwise.estimate.estimators import make_estimator
from cellwise.estimate.replay import expected_convergence_s, expected_std, replay
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell, lfp_cell, within_its_error

TRUE_START = 0.75


def judged(model, seed, truth=None, wrong=0.15):
    """A replay from a start that is off, over a drive of the truth with a known SOC."""
    rng = np.random.default_rng(seed)
    rows = 3000
    load = np.repeat(rng.uniform(-1.0, 4.0, rows // 20), 20)
    log = CellLog(np.arange(float(rows)), load, np.full(rows, 3.7), name="drive")
    found = simulate(truth or model, log, TRUE_START)
    log = replace(
        log,
        voltage_V=found.voltage_V + rng.normal(0.0, 0.002, rows),
        charge_Ah=np.cumsum(load * log.interval_s) / 3600.0,
    )
    return replay(
        model,
        log,
        "ekf",
        soc0=TRUE_START - wrong,
        soc0_std=0.15,
        reference_soc0=TRUE_START,
        reference_capacity_Ah=model.capacity_Ah,
    )


def test_the_log_s_voltage_is_not_used():
    """Another noise of the voltage leaves it as it is, but for where the replay ends."""
    model = curved_cell()
    run = judged(model, 1)
    ekf = make_estimator("ekf", model)
    expected = expected_std(model, run, ekf)
    other = replace(run, log=replace(run.log, voltage_V=run.log.voltage_V + 0.05))
    assert expected_std(model, other, ekf).tobytes() == expected.tobytes()
    assert expected[0] > 0.05
    assert expected_convergence_s(model, run, ekf) is not None


def test_what_uses_no_voltage_never_converges():
    model = curved_cell()
    run = judged(model, 1)
    coulomb = make_estimator("coulomb", model)
    assert expected_convergence_s(model, run, coulomb) is None
    assert expected_std(model, run, coulomb)[-1] >= 0.15


def test_a_plateau_takes_longer_than_a_slope():
    slope, plateau = (
        expected_std(m, judged(m, 2), make_estimator("ekf", m)) for m in (curved_cell(), lfp_cell())
    )
    assert np.median(plateau) > 2.0 * np.median(slope)


@pytest.mark.slow
def test_of_cells_within_the_model_s_error_half_converge_by_then():
    """Truths whose OCV and resistances are off as the model states: predicted is the median."""
    rng = np.random.default_rng(5)
    base = curved_cell()
    model = replace(base, error=ModelError.of_white_and_slow(slow_V=(0.015,), resistance_share=0.1))
    ekf = make_estimator("ekf", model)
    early, errors = [], []
    for seed in range(40):
        truth = within_its_error(model, rng)
        run = judged(model, seed, truth, wrong=0.15 * np.sign(rng.normal()))
        took, predicted = run.convergence_s, expected_convergence_s(model, run, ekf)
        early.append(
            (np.inf if took is None else took) <= (np.inf if predicted is None else predicted)
        )
        errors.append(run.error / expected_std(model, run, ekf))
    assert 0.35 <= np.mean(early) <= 0.95
    late = np.array(errors)[:, 600:]
    assert np.mean(np.abs(late) <= 2.0) >= 0.8  # the deviation expected is that of the errors
