"""A counted charge that the voltages contradict: deviations say so, EKF and UKF follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.adaptive import Adaptive, AdaptiveSettings
from cellwise.estimate.filters.coulomb import Coulomb
from cellwise.estimate.filters.kalman import Ekf, Ukf
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.noise import Noise
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell, linear_cell

MODEL = replace(curved_cell(), error=ModelError.of_white_and_slow(white_V=0.001, slow_V=(0.012,)))
OFFSETS_C = (-0.05, -0.03, -0.01, 0.01, 0.03, 0.05)
DT_S = 2.0


def fixed_step(model, noise):
    """What a target computes, with the watch over its sensors."""
    return FixedStep(model, noise, dt_s=DT_S)


def asking_fixed_step(model, noise):
    """The same with the hypothesis of an offset."""
    return FixedStep(model, noise, dt_s=DT_S, offset=True)


FILTERS = (Ekf, Ukf, fixed_step)


def driven(seed=0, rows=2700, dt=DT_S):
    """A drive from 90 to 30 %, the model's own voltage, and its SOC."""
    rng = np.random.default_rng(seed)
    current = np.repeat(rng.normal(0.4, 0.8, rows // 10 + 1), 10)[:rows] * MODEL.capacity_Ah
    current *= 0.6 * 3600 * MODEL.capacity_Ah / (np.sum(current) * dt)
    current[0] = 0.0
    log = CellLog(dt * np.arange(rows), current, np.full(rows, 3.7))
    run = simulate(MODEL, log, 0.9)
    return replace(log, voltage_V=run.voltage_V), run.soc


def inside(filter_, noise, offsets_C):
    """Share of rows within two stated deviations, over offsets of the current sensor."""
    log, truth = driven()
    shares = []
    for offset_share in offsets_C:
        off = replace(log, current_A=log.current_A + offset_share * MODEL.capacity_Ah)
        trace = filter_(MODEL, noise).run(off, 0.9, 0.005)
        shares.append(np.mean(np.abs(trace.soc - truth) <= 2.0 * trace.soc_std))
    return np.array(shares)


@pytest.mark.parametrize("filter_", FILTERS)
def test_from_a_known_start_the_band_holds_the_drift_of_a_sensor(filter_):
    told = Noise.of_model(MODEL)
    assert np.mean(inside(filter_, told, OFFSETS_C)) > 0.93
    assert np.mean(inside(filter_, replace(told, offset_share=0.0), OFFSETS_C)) < 0.75


@pytest.mark.parametrize("filter_", [fixed_step])
def test_the_estimate_itself_is_the_same(filter_):
    log, _ = driven()
    log = replace(log, current_A=log.current_A + 0.1)
    told = Noise.of_model(MODEL)
    with_, without = (filter_(MODEL, replace(told, offset_share=c)).run(log, 0.9, 0.005)
                      for c in (0.03, 0.0))  # fmt: skip
    np.testing.assert_array_equal(with_.soc, without.soc)
    np.testing.assert_array_equal(with_.innovation_variance_V2, without.innovation_variance_V2)
    assert np.all(with_.soc_std >= without.soc_std)
    assert with_.soc_std[-1] > 1.5 * without.soc_std[-1]


@pytest.mark.parametrize("filter_", FILTERS)
def test_nothing_contradicted_nothing_stated(filter_):
    log, _ = driven()
    told = Noise.of_model(MODEL)
    with_, without = (filter_(MODEL, replace(told, offset_share=c)).run(log, 0.9, 0.005)
                      for c in (0.03, 0.0))  # fmt: skip
    assert np.all(with_.soc_std <= 1.03 * without.soc_std)


@pytest.mark.parametrize("filter_", FILTERS)
def test_on_a_plateau_a_voltage_contradicts_little(filter_):
    """An error that the model states is no drift where millivolts are many points of SOC."""
    flat = replace(MODEL, ocv_V=3.3 + 0.05 * MODEL.soc)
    log, _ = driven()
    run = simulate(flat, log, 0.9)
    trace = filter_(flat, Noise.of_model(flat)).run(
        replace(log, voltage_V=run.voltage_V + 0.012), 0.9, 0.005
    )
    # 12 mV are 24 points of SOC there. In hours of load they may be the drop of an offset, too.
    assert trace.soc_std[-1] < 0.04
    error = np.abs(trace.soc - run.soc)
    assert np.sqrt(np.mean(error**2)) < 0.02
    assert np.mean(error <= 2.0 * trace.soc_std) > 0.98


@pytest.mark.parametrize("filter_", [Ekf, Ukf])
@pytest.mark.parametrize("offset_share", [-0.03, 0.03])
def test_from_a_known_start_the_estimate_follows_the_voltages(filter_, offset_share):
    """Against counting with the same current at most 0.6 times the error; nothing wrong: none."""
    log, truth = driven()
    off = replace(log, current_A=log.current_A + offset_share * MODEL.capacity_Ah)

    def rmse(of, rows):
        return float(np.sqrt(np.mean(np.square(of(MODEL).run(rows, 0.9, 0.005).soc - truth))))

    assert rmse(filter_, off) < 0.6 * rmse(Coulomb, off)
    assert rmse(filter_, log) < 0.001


def adaptive(model, noise):
    """Offset and capacity free, neither of them wandering."""
    still = AdaptiveSettings(
        learn=("current_offset", "capacity"), offset_C_per_sqrt_h=0.0, charge_per_sqrt_h=0.0
    )
    return Adaptive(model, noise, still)


@pytest.mark.parametrize("filter_", [Ekf, Ukf, adaptive])
def test_on_a_linear_cell_what_is_free_is_one_more_state_of_a_filter(filter_):
    """SOC, offset and capacity together as a Kalman filter of matrices, from the same voltages."""
    tiny = np.full(11, 1e-9)
    error = ModelError.of_white_and_slow(white_V=0.001, slow_V=(1e-9,))
    model = linear_cell(r1_ohm=tiny, r2_ohm=tiny, error=error)
    noise = Noise(
        current_A=0.0, branch_share=0.0, ocv_soc=0.0, voltage_V=0.01, slow_s=0.0, gate=1e9,
        mismatch_cap=0.0, soc_per_sqrt_h=0.0,
    )  # fmt: skip
    many = 3 if filter_ is adaptive else 2
    dt, rows, offset_A = 10.0, 600, 0.03 * model.capacity_Ah
    current = 0.6 + 0.6 * np.sign(np.sin(np.arange(rows) / 40.0))
    log = CellLog(dt * np.arange(rows), current, np.full(rows, 3.7))
    log = CellLog(log.time_s, current + 0.5 * offset_A, simulate(model, log, 0.9).voltage_V)
    ours = filter_(model, noise)
    state = ours.init(0.9, 0.005)
    r0, slope = float(model.r0_ohm.mean()), float(np.ptp(model.ocv_V)) / float(np.ptp(model.soc))
    x, p = np.array([0.9, 0.0, 0.0])[:many], np.diag([0.005**2, 1.0, 1.0][:many])
    h = np.array([slope, r0 * offset_A, 0.0])[:many]
    for interval, amps, voltage in zip(log.interval_s, log.current_A, log.voltage_V, strict=True):
        grow = interval / (3600.0 * model.capacity_Ah)
        f = np.eye(many)
        f[0, 1:] = np.array([grow * offset_A, -grow * amps * AdaptiveSettings().charge])[: many - 1]
        x = f @ x
        x[0] -= grow * amps
        p = f @ p @ f.T
        k = p @ h / (h @ p @ h + noise.voltage_V**2)
        predicted = model.ocv_V.flat[0] + slope * x[0] - r0 * (amps - offset_A * x[1])
        x = x + k * (voltage - predicted)
        p = p - np.outer(k, h @ p)
        state, _ = ours.step(state, amps, voltage, dt_s=interval)
    d = state.filter.drift if filter_ is adaptive else state.drift
    information, score = np.array([[d.information]]), [d.score]
    reach, believed = [d.reach], d.believed * d.reach
    if filter_ is adaptive:
        c = state.free.capacity
        information = np.array([[d.information, c.cross], [c.cross, c.information]])
        score, reach = [*score, c.score], [*reach, c.reach]
        believed += c.believed * c.reach
    mean = np.linalg.solve(information, score)
    np.testing.assert_allclose(mean, x[1:], atol=5e-3)
    # Its branches begin 5 mV unsure, which the matrices leave out.
    np.testing.assert_allclose(np.linalg.inv(information), p[1:, 1:], rtol=0.1, atol=1e-3)
    assert state.soc - believed + mean @ reach == pytest.approx(x[0], abs=1e-3)


@pytest.mark.parametrize("offset_share", [-0.03, 0.03])
def test_what_a_target_asks_of_an_offset_is_what_the_ekf_asks(offset_share):
    """Estimate and band to two hundredths of a point; without the hypothesis it is off by more."""
    log, truth = driven()
    off = replace(log, current_A=log.current_A + offset_share * MODEL.capacity_Ah)
    told = Noise.of_model(MODEL)
    ekf, asks, does_not = (f(MODEL, told).run(off, 0.9, 0.005)
                           for f in (Ekf, asking_fixed_step, fixed_step))  # fmt: skip
    np.testing.assert_allclose(asks.soc, ekf.soc, atol=2e-4)
    np.testing.assert_allclose(asks.soc_std, ekf.soc_std, atol=2e-4)
    assert np.std(asks.soc - truth) < 0.5 * np.std(does_not.soc - truth)


def test_a_lean_step_asks_for_no_offset():
    with pytest.raises(InputError, match="lean"):
        FixedStep(MODEL, dt_s=DT_S, wide=False, offset=True)
