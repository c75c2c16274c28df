"""Anatomy of a residual: what was put in is found where it was put, and nothing is lost."""

from __future__ import annotations

import json

import numpy as np
import pytest

from cellwise.cell.simulate import simulate
from cellwise.diagnose.residual import residual_analysis
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell

CELL = curved_cell()  # 3 Ah
ROWS = 6000
GROUPS = (
    "by_soc",
    "by_current_C",
    "by_edge_s",
    "by_temperature_C",
    "by_time_s",
    "by_charge_Ah",
)


def current(rows=ROWS):
    """Steps of a minute: discharge at C/3 and 1.5C, charge at C/2, rest."""
    return np.tile(np.repeat([1.0, 4.5, -1.5, 0.0], 60), rows // 240 + 1)[:rows]


def cell_log(error_V, *, dt=1.0, amp=None, temperature=None):
    """A log that the model misses by exactly ``error_V``."""
    n = len(error_V)
    t = dt * np.arange(n)
    log = CellLog(t, current(n) if amp is None else amp, np.zeros(n), temperature_C=temperature)
    return CellLog(
        t, log.current_A, simulate(CELL, log, 0.9).voltage_V + error_V, temperature_C=temperature
    )


def of(error_V, **kwargs):
    return residual_analysis(CELL, cell_log(error_V, **kwargs), 0.9)


def noise(sigma, rows=ROWS, seed=1):
    return sigma * np.random.default_rng(seed).standard_normal(rows)


def share(found, key, low):
    """Share of the squared error in the group that begins at ``low``."""
    return sum(g["share"] for g in found[key] if g["from"] == low)


def test_every_division_shares_out_the_whole_error():
    warm = 20.0 + 15.0 * np.linspace(0.0, 1.0, ROWS)
    error = noise(2e-3) + 5e-3 * np.sin(np.arange(ROWS) / 40.0) + 1e-3
    found = of(error, temperature=warm)
    for key in GROUPS:
        assert sum(g["share"] for g in found[key]) == pytest.approx(1.0)
        assert sum(g["rows"] for g in found[key]) == ROWS
        square = sum(g["rows"] * g["rmse_V"] ** 2 for g in found[key])
        assert square == pytest.approx(float(error @ error))
        assert sum(g["rows"] * g["mean_V"] for g in found[key]) == pytest.approx(error.sum())
    parts = found["constant"]["share"] + sum(g["share"] for g in found["by_period_s"])
    assert parts == pytest.approx(1.0)
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_an_error_sits_where_it_was_put():
    amp = current()
    rate = amp / CELL.capacity_Ah
    charging = of(np.where(amp < 0, 0.01, 0.0))
    assert share(charging, "by_current_C", -0.75) == pytest.approx(1.0)
    high = of(np.where(rate > 0.75, -0.01, 0.0))
    assert share(high, "by_current_C", 1.25) == pytest.approx(1.0)
    second = np.arange(ROWS) % 60
    late = of(np.where((second >= 10) & (second < 60), 0.01, 0.0))
    assert share(late, "by_edge_s", 10.0) == pytest.approx(1.0, abs=0.05)
    third = np.arange(ROWS) // (ROWS // 10) == 3
    assert of(np.where(third, 0.01, 0.0))["by_time_s"][3]["share"] > 0.99
    warm = np.where(np.arange(ROWS) < 3000, 21.0, 33.0)
    hot = of(np.where(warm > 30.0, 0.01, 0.0), temperature=warm)
    assert share(hot, "by_temperature_C", 30.0) == pytest.approx(1.0)
    log = cell_log(np.zeros(ROWS))
    soc = simulate(CELL, log, 0.9).soc
    low = of(np.where((soc >= 0.6) & (soc < 0.7), 0.01, 0.0))
    assert share(low, "by_soc", 0.6) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("period", "low"), [(0.5, None), (6.0, 2.0), (60.0, 20.0), (600.0, 200.0), (5400.0, 2000.0)]
)
def test_an_oscillation_is_in_the_band_of_its_period(period, low):
    t = 0.1 * np.arange(108000)
    found = of(0.01 * np.sin(2 * np.pi * t / period), dt=0.1, amp=np.full(t.size, 0.3))
    by = {g["from"]: g["share"] for g in found["by_period_s"]}
    assert max(by, key=by.get) == low
    assert by[low] > 0.6


def test_white_noise_has_its_floor_and_nothing_else():
    found = of(noise(3e-3))
    assert found["noise"]["floor_V"] == pytest.approx(3e-3, rel=0.05)
    assert found["noise"]["share"] == pytest.approx(1.0, abs=0.1)


def test_the_floor_of_a_coarse_digit_is_not_zero():
    assert of(np.round(noise(2e-4), 3))["noise"]["floor_V"] >= 0.0
    coarse = np.where(np.arange(ROWS) % 4 == 0, 1e-3, 0.0)
    assert of(coarse)["noise"]["floor_V"] > 0.0


def test_a_perfect_model_and_a_short_log_are_answered():
    assert of(np.zeros(ROWS))["rmse_V"] == 0.0
    short = of(np.array([0.001, 0.002]))
    assert short["rows"] == 2
    json.dumps(short, allow_nan=False)
