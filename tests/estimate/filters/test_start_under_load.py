"""A start under load, looked at again: exact where everything is linear, better where it is not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from cellwise.cell.effects import SlowDiffusion
from cellwise.cell.equations import CellState
from cellwise.cell.model import CellModel
from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate
from cellwise.estimate.filters.kalman import Ekf, Ukf
from cellwise.estimate.filters.past_kernels import (
    PAST_RATE,
    PAST_SPREAD,
    TAIL,
    Past,
    branch_of_past,
    reconsidered,
    soc_of_level,
)
from cellwise.estimate.lockstep import LockstepEkf
from cellwise.estimate.noise import Noise
from cellwise.estimate.saved_state import state_from_dict, state_to_dict
from cellwise.logs.cell_log import CellLog

R3_OHM, TAU3_S = 0.02, 300.0
SLOW_V = 0.01
FLAT = np.full(11, 1.0)


def linear(r_slope: float = 0.0, tau3_s: float = TAU3_S) -> CellModel:
    """Every resistance the same at every SOC, but for ``r_slope`` per unit of SOC, OCV a line."""
    bend = 1.0 + r_slope * np.linspace(0.0, 1.0, 11)
    return CellModel(
        capacity_Ah=3.0,
        ocv_V=np.linspace(3.2, 4.2, 11),
        r0_ohm=0.03 * bend,
        r1_ohm=0.01 * bend,
        tau1_s=2.0 * FLAT,
        r2_ohm=0.02 * bend,
        tau2_s=30.0 * FLAT,
        effects=(SlowDiffusion(R3_OHM * bend[None, :], tau3_s),),
        error=ModelError.of_white_and_slow(white_V=0.001, slow_V=(SLOW_V,), resistance_share=0.0),
    )


def test_a_look_is_the_posterior_of_a_start_with_tails_where_everything_is_linear():
    model, noise = linear(), Noise.of_model(linear()).scalars()
    mean_A, since_s = 1.5, 60.0
    prior, prior_std = 0.40, 0.10
    x = CellState(0.5, 0.0, 0.0, 0.03, 0.0, 0.0, 0.0)  # what the filter has: OCV less branch
    past = Past(mean_A, 0.0, 0.004, prior, prior_std**2)
    soc, ss, v3, p33, s3 = soc_of_level(model.parameters(), noise, past, 25.0, x, since_s)

    left = np.exp(-since_s / TAU3_S)
    before = R3_OHM * mean_A  # a discharge from full at that current has long filled the branch
    held = R3_OHM * (1 - left) * mean_A + left * before
    spread = left * (PAST_SPREAD * before + R3_OHM * PAST_RATE * 3.0)
    # Level: 3.2 + s - v3 + e, with e the model's error and the 5 mV of a branch at a start.
    level = 3.2 + 0.5 - 0.03 + 0.004
    e2 = SLOW_V**2 + 0.005**2
    # By brute force: Student's t of the start, a normal branch, a normal error of the level.
    s, b = np.meshgrid(np.linspace(0.0, 1.0, 801), held + spread * np.linspace(-6.0, 6.0, 801))
    weight = stats.t.pdf(s, TAIL, prior, prior_std) * stats.norm.pdf(b, held, spread)
    weight *= stats.norm.pdf(level - 3.2 - (s - b), 0.0, np.sqrt(e2))
    weight /= weight.sum()
    mean_s, mean_b = np.sum(weight * s), np.sum(weight * b)
    assert soc == pytest.approx(mean_s, abs=1e-4)
    assert v3 == pytest.approx(mean_b, abs=1e-4)
    found = [ss - 0.005**2 / 12.0, p33, s3]
    expected = [
        np.sum(weight * (s - mean_s) ** 2),
        np.sum(weight * (b - mean_b) ** 2),
        np.sum(weight * (s - mean_s) * (b - mean_b)),
    ]
    np.testing.assert_allclose(found, expected, rtol=2e-2)


def test_what_flows_after_the_start_is_in_the_branch_whatever_was_before():
    cell = linear().parameters().cell
    held, variance = branch_of_past(cell, R3_OHM, 0.0, 1.5, 1.0)
    assert held == pytest.approx(R3_OHM * 1.5)
    assert variance == 0.0


@pytest.mark.parametrize("mean_A", [2.0, -2.0])
def test_near_the_end_that_a_load_comes_from_a_slow_branch_holds_nothing(mean_A):
    """A charge from empty has just begun near empty: the OCV alone is the level there."""
    model = linear()
    soc = 0.005 if mean_A < 0.0 else 0.995
    past = Past(mean_A, 0.0, 0.0, soc, 1e-6)
    x = CellState(soc, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    found = soc_of_level(model.parameters(), Noise.of_model(model).scalars(), past, 25.0, x, 0.0)
    assert abs(found[2]) < 0.2 * R3_OHM * 2.0


HOURS_S = 5000.0


def left_after(mean_A: float, soc: float) -> float:
    """A branch of :func:`linear` that a discharge from full has come to a SOC with."""
    return R3_OHM * mean_A * (1.0 - np.exp(-(1.0 - soc) * 3.0 * 3600.0 / mean_A / HOURS_S))


def test_another_mean_load_is_another_past():
    model = linear(tau3_s=HOURS_S)
    x = CellState(0.4, 0.0, 0.0, 0.03, 0.0, 0.0, 0.0)
    since_s, looked_A, mean_A = 960.0, 0.3, 1.5
    past = Past(mean_A, looked_A, 0.0, 0.5, 0.01)
    more_V, variance = reconsidered(model.parameters(), past, 25.0, x, since_s)
    began = 0.4 + mean_A * since_s / (3.0 * 3600.0)
    left = np.exp(-since_s / HOURS_S)
    taken, held = left_after(looked_A, began), left_after(mean_A, began)
    assert more_V == pytest.approx(left * (held - taken), rel=0.02)
    spread = left * (PAST_SPREAD * taken + R3_OHM * PAST_RATE * 3.0)
    assert variance == pytest.approx(spread**2, rel=0.04)


@pytest.mark.parametrize("kind", [Ekf, Ukf])
def test_a_use_that_pauses_in_its_first_minutes_is_found_after_some_more(kind):
    """240 s at a fifth of the load before them say too little of a branch of hours."""
    model = linear(tau3_s=HOURS_S)
    time = np.arange(0.0, 3600.0 + 1500.0)
    current = np.full(time.size, 1.5)
    current[3600:3850] = 0.3
    current[3850:] = 1.8
    whole = CellLog(time, current, np.full(time.size, 4.0), temperature_C=np.full(time.size, 25.0))
    done = simulate(model, whole, 1.0)
    rows = slice(3600, None)
    log = CellLog(
        time[rows] - 3600.0, current[rows], done.voltage_V[rows], temperature_C=np.full(1500, 25.0)
    )
    error = kind(model).run(log, float(done.soc[3600]), 0.15).soc - done.soc[rows]
    before, after = error[955], error[965]
    assert abs(before) > 0.003
    assert abs(after) < 0.5 * abs(before)


def use(model: CellModel, soc0: float, seed: int) -> tuple[CellLog, np.ndarray]:
    """A drive's second half, with what its first half has left in the branches; its SOC."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 3000.0)
    current = np.repeat(rng.uniform(-0.5, 3.5, 600), 5)
    whole = CellLog(time, current, np.full(time.size, 4.0), temperature_C=np.full(time.size, 25.0))
    done = simulate(model, whole, soc0)
    rows = slice(1500, None)
    log = CellLog(
        time[rows] - time[1500], current[rows], done.voltage_V[rows],
        temperature_C=np.full(1500, 25.0),
    )  # fmt: skip
    return log, done.soc[rows]


@pytest.mark.parametrize("kind", [Ekf, Ukf])
@pytest.mark.parametrize("wrong", [-0.25, 0.25])
def test_cut_out_of_a_use_the_band_holds_the_truth_and_closes(kind, wrong):
    """Resistances that change by half over SOC: what a tangent at the wrong start cannot know."""
    model = linear(r_slope=-0.5)
    inside, errors = [], []
    for seed in range(6):
        log, truth = use(model, 0.8, seed)
        trace = kind(model).run(log, float(truth[0]) + wrong, 0.15)
        error = trace.soc - truth
        inside.append(np.mean(np.abs(error) < 2.0 * trace.soc_std))
        errors.append(error[300:])
    assert np.mean(inside) > 0.93
    # The model is perfect and claims 10 mV, a point of SOC, and so do branches.
    assert np.sqrt(np.mean(np.square(errors))) < 0.02


def test_a_start_that_is_known_or_at_rest_is_not_looked_at():
    model = linear()
    ekf = Ekf(model)
    known, _ = ekf.step(ekf.init(0.5, 0.005), 2.0, 3.6, dt_s=0.0)
    resting, _ = ekf.step(ekf.init(0.5, 0.15), 0.0, 3.7, dt_s=0.0)
    under_load, _ = ekf.step(ekf.init(0.5, 0.15), 2.0, 3.6, dt_s=0.0)
    assert known.past.first_variance < 0.0
    assert resting.past.first_variance < 0.0
    assert under_load.past.first_variance > 0.0


def test_a_gap_ends_the_looks():
    ekf = Ekf(linear())
    state, _ = ekf.step(ekf.init(0.5, 0.15), 2.0, 3.6, dt_s=0.0)
    state, _ = ekf.step(state, 2.0, 3.6, dt_s=1.0)
    assert state.past.first_variance > 0.0
    state, _ = ekf.step(state, 2.0, 3.6, dt_s=60.0, gap=True)
    assert state.past.first_variance < 0.0


def test_a_restart_goes_on_with_the_looks():
    model = linear(r_slope=-0.5)
    log, truth = use(model, 0.8, 3)
    ekf = Ekf(model)
    straight = put_away = ekf.init(float(truth[0]) - 0.2, 0.15)
    for k in range(970):
        reading = log.current_A[k], log.voltage_V[k], 25.0
        dt_s = 1.0 if k else 0.0
        straight, _ = ekf.step(straight, *reading, dt_s=dt_s)
        put_away, _ = ekf.step(put_away, *reading, dt_s=dt_s)
        if k in (30, 500):
            put_away = state_from_dict(state_to_dict(put_away))
    assert put_away == straight
    assert straight.past.first_variance < 0.0  # nothing more is to come


def test_lockstep_looks_as_the_filter_does():
    model = linear(r_slope=-0.5)
    log, truth = use(model, 0.8, 3)
    start = float(truth[0]) - 0.2
    ekf, fleet = Ekf(model), LockstepEkf(model, 2, 1.0)
    one, many = ekf.init(start, 0.15), fleet.init(np.array([start, 0.6]), 0.15)
    for k in range(300):
        one, _ = ekf.step(one, log.current_A[k], log.voltage_V[k], 25.0, dt_s=1.0)
        both = np.full(2, log.current_A[k]), np.full(2, log.voltage_V[k])
        many, _ = fleet.step(many, *both, 25.0)
    np.testing.assert_allclose(fleet.cell_state(many, 0).soc, one.soc, rtol=1e-9)
