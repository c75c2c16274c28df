"""Noise from innovations: the mean NIS comes to one, the sensors keep what is known of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.noise import Noise
from cellwise.estimate.tune_noise import MODEL_FACTOR, tune_noise
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell

CELL = curved_cell()


def drive(seed, error_V, rows=7200, memory_s=300.0):
    """A drive of a cell whose voltage is off by a slow error of the given size."""
    rng = np.random.default_rng(seed)
    current = np.repeat(rng.normal(0.3, 2.0, rows // 10), 10)
    current[0] = 0.0
    log = CellLog(np.arange(float(rows)), current, np.full(rows, 3.7), name=f"drive {seed}")
    hold = np.exp(-1.0 / memory_s)
    slow = np.empty(rows)
    value = rng.standard_normal()
    for k in range(rows):
        value = hold * value + np.sqrt(1 - hold**2) * rng.standard_normal()
        slow[k] = value
    voltage = simulate(CELL, log, 0.8).voltage_V + error_V * slow
    return replace(log, voltage_V=voltage + 0.002 * rng.standard_normal(rows))


@pytest.mark.parametrize(("told_V", "true_V"), [(0.040, 0.010), (0.003, 0.015), (0.010, 0.010)])
def test_mean_nis_comes_to_one(told_V, true_V):
    model = replace(
        CELL, error=ModelError.of_white_and_slow(slow_V=(told_V,), resistance_share=0.001)
    )
    found = tune_noise(model, [drive(k, true_V) for k in range(4)], soc0=[0.8] * 4)
    assert 0.5 < np.mean(found.nis_after) < 2.0
    off = abs(np.log(np.mean(found.nis_after)))
    assert off <= abs(np.log(np.mean(found.nis_before))) + 0.1
    assert found.log_likelihood[1] >= found.log_likelihood[0]
    # And on a log that it has not seen.
    scale = found.noise.error_scale * told_V
    assert scale == pytest.approx(true_V, rel=0.5)


def test_the_sensors_stay_near_their_data():
    sensors = replace(Noise.of_model(CELL), voltage_V=0.004, current_A=0.02)
    found = tune_noise(CELL, [drive(9, 0.010)], sensors=sensors, soc0=[0.8])
    for name in ("voltage_V", "current_A"):
        assert 0.4 < getattr(found.noise, name) / getattr(sensors, name) < 2.5
    assert 1 / MODEL_FACTOR**3 < found.noise.error_scale < MODEL_FACTOR**3
    assert found.noise.gate == sensors.gate
    assert found.noise.slow_s == sensors.slow_s
    assert "mean NIS" in repr(found)
    assert found.logs == ("drive 9",)


def test_what_cannot_be_tuned_with_is_refused():
    log = drive(1, 0.01, rows=600)
    with pytest.raises(InputError, match="no log"):
        tune_noise(CELL, [])
    with pytest.raises(InputError, match="one each"):
        tune_noise(CELL, [log], soc0=[0.8, 0.7])
    blind = replace(log, voltage_V=np.full(len(log), 60.0))
    with pytest.raises(InputError, match="drive 1"):
        tune_noise(CELL, [blind], soc0=[0.8])
