"""The filter is as wrong as it says: data drawn with the very noise that it assumes.

No error of the data stays for good, so the filter is told of none (``test_persistent_error.py``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_error import ModelError
from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.noise import Noise
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell, lfp_cell, linear_cell

RUNS = 200


def draw(model, noise, rows, dt, soc0, soc0_std, rng):
    """RUNS cells and logs at once: every state and every reading with the noise assumed.

    Returns true SOC, seen current and seen voltage, each (rows, RUNS).
    """

    def table(values, soc):
        return np.interp(soc, model.soc, values[0])

    def white(scale):
        return scale * rng.standard_normal(RUNS)

    soc = soc0 + white(soc0_std)
    # At rest a branch holds 5 mV of its past, and what a tenth of a rate leaves there.
    tenth = 0.1 * model.capacity_Ah
    v1, v2 = (
        white(1.0) * np.hypot(0.005, tenth * table(r, soc)) for r in (model.r1_ohm, model.r2_ohm)
    )
    slow = rng.standard_normal(RUNS)
    hold = np.exp(-dt / noise.slow_s) if noise.slow_s > 0 else 0.0
    walk = noise.soc_per_sqrt_h / 60 * np.sqrt(dt)
    current = np.zeros(RUNS)
    found = []
    for k in range(rows):
        h = dt if k else 0.0
        if k and k % 20 == 1:
            # About as much charge as discharge, so that the cells stay within their tables.
            current = rng.normal(0.0, 1.0, RUNS) * model.capacity_Ah
            current = np.where(soc < 0.15, -abs(current), current)
            current = np.where(soc > 0.85, abs(current), current)
        soc = soc - current * h / (3600 * model.capacity_Ah) + white(walk if k else 0.0)
        r1, r2 = table(model.r1_ohm, soc), table(model.r2_ohm, soc)
        a1, a2 = np.exp(-h / table(model.tau1_s, soc)), np.exp(-h / table(model.tau2_s, soc))
        share = noise.branch_share * current
        v1 = a1 * v1 + r1 * (1 - a1) * current + white(1.0) * share * r1 * np.sqrt(1 - a1**2)
        v2 = a2 * v2 + r2 * (1 - a2) * current + white(1.0) * share * r2 * np.sqrt(1 - a2**2)
        slow = hold * slow + np.sqrt(1 - hold**2) * white(1.0)
        r0 = table(model.r0_ohm, soc)
        drops = white(noise.branch_share) * (abs(r0 * current) + abs(v1) + abs(v2))
        error = noise.error_scale * model.error.at(soc) * slow + white(noise.voltage_V)
        ocv = table(model.ocv_V, soc + white(noise.ocv_soc))
        found.append(
            (soc, current + white(noise.current_A), ocv - r0 * current - v1 - v2 + drops + error)
        )
    return (np.array(x) for x in zip(*found, strict=True))


def replayed(model, noise, rows, dt, soc0=0.5, soc0_std=0.05, seed=1):
    """SOC error, its standard deviation and NIS, each (rows, RUNS)."""
    rng = np.random.default_rng(seed)
    truth, current, voltage = draw(model, noise, rows, dt, soc0, soc0_std, rng)
    ekf = Ekf(model, noise)
    time = dt * np.arange(rows)
    error, std, nis = (np.empty((rows, RUNS)) for _ in range(3))
    for j in range(RUNS):
        trace = ekf.run(CellLog(time, current[:, j], voltage[:, j]), soc0, soc0_std)
        error[:, j] = trace.soc - truth[:, j]
        std[:, j] = trace.soc_std
        nis[:, j] = trace.innovation_V**2 / trace.innovation_variance_V2
    return error, std, nis


WHITE = Noise(
    current_A=0.05, soc_per_sqrt_h=0.02, voltage_V=0.005, slow_s=0.0, gate=1e9, mismatch_cap=0.0,
    lasting_share=0.0, offset_share=0.0,
)  # fmt: skip
BLOCKS = "89.5 % inside: a block's mean of 100 independent samples is taken for its end"


MINUTES = Noise(
    current_A=0.01, soc_per_sqrt_h=0.005, slow_s=300.0, lasting_share=0.0, offset_share=0.0
)


@pytest.mark.parametrize(
    ("model", "dt"),
    [
        (linear_cell(), 1.0),
        (curved_cell(), 1.0),
        pytest.param(curved_cell(), 0.1, marks=pytest.mark.xfail(strict=True, reason=BLOCKS)),
        (curved_cell(), 10.0),
    ],
)
def test_with_independent_samples(model, dt):
    """NIS has mean 1 and the band of two standard deviations holds 95 of 100 errors.

    Some 200 x 1200 innovations put the mean NIS within 0.01; 200 runs looked at ten times give
    the coverage within 2 points at the very least.
    """
    error, std, nis = replayed(model, WHITE, 1200, dt)
    assert np.mean(nis) == pytest.approx(1.0, abs=0.05)
    looks = slice(119, None, 120)
    inside = np.abs(error[looks]) <= 2 * std[looks]
    assert 0.90 <= np.mean(inside) <= 0.99
    # And the normalised error has the variance that it claims.
    assert np.mean((error[looks] / std[looks]) ** 2) == pytest.approx(1.0, abs=0.3)
    assert np.mean(error[looks] / std[looks]) == pytest.approx(0.0, abs=0.3)


@pytest.mark.parametrize(
    ("cell", "dt", "least"),
    [(curved_cell, 2.0, 0.92), (curved_cell, 10.0, 0.92), (lfp_cell, 10.0, 0.85)],
)
def test_with_a_model_error_that_lasts_for_minutes(cell, dt, least):
    """The error is 10 mV and lasts 300 s: thousands of samples must not be taken for thousands.

    The filter's treatment is an approximation (an exact one carries the error as a state): on a
    curved OCV it covers, on an LFP plateau a tangent cannot follow the OCV and a few points are
    lost. A filter that forgot the duration covers less than 70 % (below).
    """
    model = replace(cell(), error=ModelError.of_white_and_slow(slow_V=(0.010,)))
    noise = replace(MINUTES, gate=1e9, mismatch_cap=0.0)
    rows = int(10_000 / dt)
    error, std, nis = replayed(model, noise, rows, dt, soc0_std=0.1)
    looks = slice(rows // 10, None, rows // 10)
    coverage = np.mean(np.abs(error[looks]) <= 2 * std[looks])
    assert least <= coverage <= 0.99
    assert 0.7 <= np.mean(nis) <= 1.2


def test_a_start_that_is_20_points_unsure_is_not_overtrusted_after_one_voltage():
    """The OCV bends over such a spread: the first rows must cover nearly as well as the last.

    The filter takes a model to be wrong on every time scale; an error of one scale, as here, costs
    a few points of coverage in the first minutes.
    """
    model = replace(curved_cell(), error=ModelError.of_white_and_slow(slow_V=(0.010,)))
    noise = MINUTES
    error, std, _ = replayed(model, noise, 1000, 10.0, soc0_std=0.2, seed=5)
    for rows, least in ((slice(0, 20), 0.89), (slice(200, None, 100), 0.92)):
        assert np.mean(np.abs(error[rows]) <= 2 * std[rows]) >= least
    assert np.sqrt(np.mean(error[500:] ** 2)) < 0.01


def test_taking_every_sample_for_new_evidence_would_not_cover():
    """The same data to a filter that believes in independent samples: the check can fail."""
    model = curved_cell()
    told = replace(MINUTES, gate=1e9, mismatch_cap=0.0)
    rng = np.random.default_rng(2)
    truth, current, voltage = draw(model, told, 4000, 1.0, 0.5, 0.1, rng)
    naive = Ekf(model, replace(told, slow_s=0.0))
    inside = []
    for j in range(40):
        log = CellLog(np.arange(4000.0), current[:, j], voltage[:, j])
        trace = naive.run(log, 0.5, 0.1)
        inside.append(abs(trace.soc[-1] - truth[-1, j]) <= 2 * trace.soc_std[-1])
    assert np.mean(inside) < 0.7
