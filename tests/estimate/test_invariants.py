"""What holds for every estimator with every effect, since all of them step the same cell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import EFFECTS
from cellwise.estimate.noise import Noise
from cellwise.estimate.status import Status
from estimator_cases import ACTIVE, NEUTRAL, Rows, follow
from example_cells import curved_cell, lfp_cell, linear_cell

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


GATED = ("ekf", "ukf", "adaptive", "lockstep")


def ekf_beside(name, model, rows, soc0, soc0_std=0.01, noise=None):
    """The EKF over the same intervals: the lockstep's first sample ends one, too."""
    return follow("ekf", model, as_taken(name, rows), soc0, soc0_std, noise)


def as_taken(name, rows):
    return rows.interval(0, rows.tick_s) if name == "lockstep" else rows


def driven(model, seconds=400, tick_s=1.0, soc0=0.7, rest_s=5.0, spread_A=1.0):
    """Loads of ten seconds after a rest, with the voltage that the EKF expects of them."""
    steps = np.random.default_rng(4).normal(2.5, spread_A, int(seconds / 10) + 1)
    time = tick_s * np.arange(int(seconds / tick_s))
    current = np.where(time < rest_s, 0.0, steps[(time / 10).astype(int)])
    rows = Rows.of(current, tick_s)
    return replace(rows, voltage_V=follow("ekf", model, rows, soc0).voltage_V)


@pytest.mark.parametrize("name", GATED)
def test_the_gate_counts_alike(name):
    """Rejections that resistances could explain add up to the same sample in every filter.

    At 0.25 s eighty counts of 0.05 x 0.25 are 1, but for the rounding of the sum.
    """
    assert sum([0.05 * 0.25] * 80) < 1.0
    model = linear_cell()
    rows = driven(model, seconds=100, tick_s=0.25, spread_A=0.0)
    jump = rows.voltage_V.copy()
    jump[100:] += 0.2
    rows = replace(rows, voltage_V=jump)
    noise = replace(Noise.of_model(model), recovery_after=1)
    status = follow(name, model, rows, 0.7, noise=noise).status.astype(int)
    assert np.flatnonzero(status & Status.GATE_RECOVERY)[0] == 100 + 79


@pytest.mark.parametrize("make", [curved_cell, lfp_cell])
@pytest.mark.parametrize("name", ["adaptive", "lockstep"])
def test_a_first_voltage_at_rest_says_the_same(name, make):
    """A resting cell shows its OCV: a start that knows little of itself believes it at once."""
    model = make()
    for truth in (0.15, 0.45, 0.95):
        rows = driven(model, seconds=60, soc0=truth)
        mine, ekf = (walk(name, model, rows, 0.7, 0.2) for walk in (follow, ekf_beside))
        assert mine.soc[0] == pytest.approx(ekf.soc[0], abs=1e-12)
        np.testing.assert_allclose(mine.soc, ekf.soc, atol=2e-4)


@pytest.mark.parametrize("name", ["ukf", "adaptive", "lockstep"])
def test_a_lock_out_ends_at_the_same_soc(name):
    """A filter that is sure of a wrong SOC looks for it over the whole range, as the EKF does."""
    model = curved_cell()
    for truth in (0.25, 0.5, 0.85):
        rows = driven(model, seconds=400, soc0=truth)
        mine, ekf = (walk(name, model, rows, 0.65, 0.002) for walk in (follow, ekf_beside))
        ends = [np.flatnonzero(p.status.astype(int) & Status.GATE_RECOVERY) for p in (mine, ekf)]
        np.testing.assert_array_equal(*ends)
        assert ends[0].size > 0
        after = int(ends[0][0])
        assert mine.soc[after] == pytest.approx(ekf.soc[after], abs=1e-3)
        assert abs(mine.soc[-1] - ekf.soc[-1]) < 5e-3
