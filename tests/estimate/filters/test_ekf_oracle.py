"""The EKF against filterpy: the same filter as matrices, and the Kalman filter where it is one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter
from scipy.stats import norm

from cellwise.cell.effects import Hysteresis, SlowDiffusion, TemperatureDependence, TimeSkew
from cellwise.cell.simulate import simulate
from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.noise import Noise
from example_cells import EFFECTS, curved_cell, linear_cell, random_log, random_model
from virtual_tester import logged

OPEN_GATE = 1e9


def mean_of(state):
    return np.array(state.cell[:5])


def covariance_of(state):
    matrix = np.zeros((5, 5))
    matrix[np.triu_indices(5)] = state.p
    return matrix + np.triu(matrix, 1).T


class Tables:
    """The model's equations from its documentation, on numpy and scipy."""

    def __init__(self, model):
        self.model = model
        self.grid = (model.temperature_C, model.soc)
        self.hysteresis = model.effect(Hysteresis)
        self.slow = model.effect(SlowDiffusion)
        self.thermal = model.effect(TemperatureDependence)
        self.skew_s = model.effect(TimeSkew).skew_s

    def at(self, table, soc, temperature):
        table = np.broadcast_to(table, self.model.ocv_V.shape)
        if table.shape[0] == 1:
            return np.interp(soc, self.model.soc, table[0])
        # Straight between temperatures, each straight over its SOC.
        over_soc = [np.interp(soc, self.model.soc, row) for row in table]
        return np.interp(temperature, self.grid[0], over_soc)

    def slope(self, soc, temperature):
        k = min(int(soc * (self.model.points - 1)), self.model.points - 2)
        ends = [
            self.at(self.model.ocv_V, self.model.soc[j], temperature) for j in (k, k + 1)
        ]  # fmt: skip
        return (ends[1] - ends[0]) * (self.model.points - 1)

    def resistances(self, soc, temperature):
        kelvin = temperature + 273.15
        reference = self.thermal.reference_C + 273.15
        scale = np.exp(self.thermal.activation_K * (1 / kelvin - 1 / reference))
        tables = (self.model.r0_ohm, self.model.r1_ohm, self.model.r2_ohm, self.slow.r3_ohm)
        return scale * np.array([self.at(t, soc, temperature) for t in tables])

    def time_constants(self, soc, temperature):
        tables = (self.model.tau1_s, self.model.tau2_s, self.slow.tau3_s)
        return np.array([self.at(t, soc, temperature) for t in tables])


def start_of_branches(model, current):
    """Current that the branches have settled under, its spread, and most volts of that spread."""
    if abs(current) < 0.01 * model.capacity_Ah:
        return 0.0, 0.1 * model.capacity_Ah, 0.03
    return 0.5 * current, max(0.5 * abs(current), 0.25 * model.capacity_Ah), np.inf


def samples_of_one_error(noise, evidence, dt, resting):
    """Factor on a voltage's variance; ``evidence`` is the time since the first, None before it."""
    if noise.slow_s == 0 or (evidence is None and resting):
        return 1.0
    early = noise.slow_half_s * min(noise.slow_first_s / noise.slow_s, 1.0)
    after = evidence or 0.0
    memory = noise.slow_s * (after + early) / (after + noise.slow_half_s)
    return max(2 * memory / dt, 1.0) if dt > 0 else np.inf


def matrix_filter(model, noise, log, soc0, soc0_std):
    """Mean, covariance, predicted voltage, its variance per row, by filterpy in matrix form."""
    gaps = log.gap_rows
    t = Tables(model)
    ekf = ExtendedKalmanFilter(dim_x=5, dim_z=1)
    ekf.x = np.array([soc0, 0.0, 0.0, 0.0, 1.0 if soc0 > 0.5 else -1.0])
    has_hysteresis = bool(np.any(t.hysteresis.m_V))
    ekf.P = np.diag([soc0_std**2, 0.0, 0.0, 0.0, 1.0 * has_hysteresis])
    gamma = t.hysteresis.gamma if has_hysteresis else 0.0
    charge = 3600 * model.capacity_Ah
    previous, mismatch, evidence, begun = log.current_A[0], 1.0, None, False
    for gap, dt, now, volts, temperature in zip(
        gaps, log.interval_s, log.current_A, log.voltage_V, log.temperature_C, strict=True
    ):
        now = previous if np.isnan(now) else now
        weight = min(t.skew_s / dt, 1.0) if dt > 0 else 0.0
        seen = now + weight * (previous - now)
        # Over a gap nothing is known to flow; either current may have filled the branches.
        current = 0.0 if gap else seen
        unknown = seen**2 + previous**2 if gap else 0.0
        previous = now
        used = current * (1.0 if current > 0 else model.charge_efficiency)
        soc = ekf.x[0] - used * dt / charge
        r0, *r = t.resistances(soc, temperature)
        r = np.array(r)
        if not begun:
            begun = True
            mean, spread, limit = start_of_branches(model, seen)
            ekf.x[1:4], ekf.P[[1, 2, 3], [1, 2, 3]] = (
                mean * r,
                np.where(r > 0, 0.005**2 + np.minimum(spread * r, limit) ** 2, 0.0),
            )
        a = np.where(r > 0, np.exp(-dt / t.time_constants(soc, temperature)), 1.0)
        hold = np.exp(-gamma * abs(current) * dt / charge)
        ekf.F = np.diag([1.0, *a, hold])
        ekf.x = np.array(
            [soc, *(a * ekf.x[1:4] + r * (1 - a) * current),
             hold * ekf.x[4] - (1 - hold) * np.sign(current)]
        )  # fmt: skip
        drive = np.array([-dt / charge, *(r * (1 - a)), 0.0])
        walk = (noise.soc_per_sqrt_h / 60) ** 2 * dt
        share = (noise.branch_share * current * r) ** 2 * (1 - a**2)
        ekf.Q = noise.current_A**2 * np.outer(drive, drive) + np.diag([walk, *share, 0.0])
        branches = np.array([0.0, *drive[1:4], 0.0])
        ekf.Q += unknown * np.outer(branches, branches)
        rate = max(0.5 * model.capacity_Ah, np.sqrt(unknown))
        unseen = min(noise.gap_soc, rate * dt / (3600.0 * model.capacity_Ah))
        ekf.P[0, 0] += unseen**2 if gap else 0.0
        ekf.P = ekf.F @ ekf.P @ ekf.F.T + ekf.Q
        m = t.at(t.hysteresis.m_V, soc, temperature)
        slope = t.slope(soc, temperature)
        jacobian = np.array([[slope, -1.0, -1.0, -1.0, m]])
        predicted = t.at(model.ocv_V, soc, temperature) - r0 * seen - ekf.x[1:4].sum()
        predicted += m * ekf.x[4]
        one = noise.voltage_V**2 + (noise.error_scale * model.error.at(soc)) ** 2
        one += (noise.ocv_soc * slope) ** 2
        drops = abs(r0 * seen) + np.abs(ekf.x[1:4]).sum()
        one += (noise.branch_share * drops) ** 2 + (noise.current_A * r0) ** 2
        variance = (jacobian @ ekf.P @ jacobian.T)[0, 0] + one
        if noise.mismatch_cap and noise.slow_s and np.isfinite(volts):
            seen_so_far = min((volts - predicted) ** 2 / variance, noise.mismatch_cap)
            mismatch += min(dt / noise.slow_s, 1.0) * (seen_so_far - mismatch)
        resting = abs(seen) < 0.01 * model.capacity_Ah
        shared = samples_of_one_error(noise, evidence, dt, resting)
        if np.isfinite(volts) and np.isfinite(shared):
            ekf.update(
                np.array([volts]),
                HJacobian=lambda _, h=jacobian: h,
                Hx=lambda _, v=predicted: np.array([v]),
                R=np.array([[one * shared * max(mismatch, 1.0)]]),
            )
            ekf.x[4] = np.clip(ekf.x[4], -1, 1)
        if np.isfinite(volts) and evidence is None:
            evidence = 0.0
        if evidence is not None:
            evidence += dt
        yield ekf.x.copy(), ekf.P.copy(), predicted, variance


def difficult_log(rng, model, rows=400):
    """Jitter, temperature, repeated stamps, missing values; voltages of the model plus noise."""
    log = random_log(
        rng, rows, scale_A=model.capacity_Ah, jitter=0.8, temperature_C=(-25.0, 55.0)
    )  # fmt: skip
    time = log.time_s.copy()
    time[100] = time[99]
    time[200:203] = time[199]
    time[300:] += 500.0  # a gap
    log = replace(log, time_s=time)
    voltage = simulate(model, log, 0.52).voltage_V + 0.005 * rng.standard_normal(rows)
    current = log.current_A + 0.01 * rng.standard_normal(rows)
    voltage[:2] = np.nan  # the first that is read is in the middle of things
    voltage[rng.choice(np.arange(5, rows), 20, replace=False)] = np.nan
    current[rng.choice(np.arange(5, rows), 20, replace=False)] = np.nan
    return replace(log, voltage_V=voltage, current_A=current)


@pytest.mark.parametrize(
    ("slow_s", "mismatch_cap"), [(0.0, 0.0), (300.0, 0.0), (300.0, 100.0), (20.0, 1.5)]
)
@pytest.mark.parametrize("seed", range(6))
def test_mean_and_covariance_are_those_of_the_matrix_form(seed, slow_s, mismatch_cap):
    rng = np.random.default_rng(seed)
    model = random_model(rng, temperatures=1 + seed % 3, effects=seed != 5)
    noise = Noise(
        current_A=0.02, slow_s=slow_s, gate=OPEN_GATE, mismatch_cap=mismatch_cap, gap_soc=0.002,
        lasting_share=0.0, offset_share=0.0,
    )  # fmt: skip
    log = difficult_log(rng, model)
    ekf = Ekf(model, noise, components=1)
    state = ekf.init(0.5, 0.018, log.current_A[0])
    oracle = matrix_filter(model, noise, log, 0.5, 0.018)
    for k, (x, p, predicted, variance) in enumerate(oracle):
        state, info = ekf.step(
            state, log.current_A[k], log.voltage_V[k], log.temperature_C[k],
            dt_s=log.interval_s[k], gap=bool(log.gap_rows[k]),
        )  # fmt: skip
        assert state.p.ss < 4e-4  # where the tangent is used
        np.testing.assert_allclose(mean_of(state), x, rtol=0, atol=1e-10)
        np.testing.assert_allclose(covariance_of(state), p, rtol=1e-9, atol=1e-12)
        assert info.voltage_V == pytest.approx(predicted, abs=1e-10)
        assert info.innovation_variance_V2 == pytest.approx(variance, rel=1e-9)
        wider = max(state.mismatch, 1.0)
        assert info.soc_std == pytest.approx(np.sqrt(p[0, 0] * wider), rel=1e-9)


def kalman_log(model, rows=300):
    rng = np.random.default_rng(3)
    log = random_log(rng, rows, jitter=0.5)
    return logged(model, log, 0.6, 0.01 * rng.standard_normal(rows))


def assert_is_the_kalman_filter(make, *, mean, covariance, likelihood):
    """Mean (V, SOC), covariance (relative) and likelihood of a linear cell, step by step.

    ``make`` gives the filter of a model and its noise.
    """
    model = linear_cell(effects=(SlowDiffusion(0.02, 700.0),))
    noise = Noise(
        current_A=0.03, voltage_V=0.01, slow_s=0.0, gate=OPEN_GATE, mismatch_cap=0.0,
        offset_share=0.0,
    )  # fmt: skip
    log = kalman_log(model)
    ours = make(model, noise)
    state = ours.init(0.5, 0.1)
    kf = KalmanFilter(dim_x=4, dim_z=1, dim_u=1)
    kf.x = np.array([0.5, 0.0, 0.0, 0.0])
    r, tau = np.array([0.012, 0.020, 0.02]), np.array([7.0, 90.0, 700.0])
    kf.P = np.diag([0.01, *(0.005**2 + (0.1 * 3.0 * r) ** 2)])
    kf.H = np.array([[0.9, -1.0, -1.0, -1.0]])
    found = [0.0, 0.0]
    for k, (dt, current) in enumerate(zip(log.interval_s, log.current_A, strict=True)):
        a = np.exp(-dt / tau)
        drive = np.array([-dt / (3600 * 3.0), *(r * (1 - a))])
        share = (noise.branch_share * current * r) ** 2 * (1 - a**2)
        walk = (noise.soc_per_sqrt_h / 60) ** 2 * dt
        kf.predict(
            u=np.array([current]),
            B=drive[:, None],
            F=np.diag([1.0, *a]),
            Q=noise.current_A**2 * np.outer(drive, drive) + np.diag([walk, *share]),
        )
        one = noise.voltage_V**2 + float(model.error.at(0.5)) ** 2 + (noise.ocv_soc * 0.9) ** 2
        drops = abs(0.030 * current) + np.abs(kf.x[1:]).sum()
        one += (noise.branch_share * drops) ** 2 + (noise.current_A * 0.030) ** 2
        kf.update(np.array([log.voltage_V[k] - 3.2 + 0.030 * current]), R=np.array([[one]]))
        state, info = ours.step(state, current, log.voltage_V[k], dt_s=dt)
        np.testing.assert_allclose(mean_of(state)[:4], kf.x.ravel(), atol=mean)
        np.testing.assert_allclose(
            covariance_of(state)[:4, :4], kf.P, rtol=covariance, atol=1e-4 * covariance
        )
        scale = np.sqrt(info.innovation_variance_V2)
        found[0] += norm.logpdf(info.innovation_V, scale=scale)
        found[1] += kf.log_likelihood
    assert found[0] == pytest.approx(found[1], rel=likelihood)


def test_on_a_linear_cell_it_is_the_kalman_filter():
    """From a start that knows nothing, within 0..1."""
    assert_is_the_kalman_filter(
        lambda model, noise: Ekf(model, noise, components=1),
        mean=1e-11,
        covariance=1e-10,
        likelihood=1e-10,
    )


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_the_voltage_predicted_without_corrections_is_the_simulation(effect):
    model = curved_cell(effects=(effect,))
    log = random_log(np.random.default_rng(5), 500, temperature_C=(0.0, 40.0))
    blind = replace(log, voltage_V=np.where(np.arange(500) == 499, 3.7, np.nan))
    trace = Ekf(model, components=1).run(blind, 0.7)
    run = simulate(model, log, 0.7)
    np.testing.assert_allclose(trace.voltage_V[:-1], run.voltage_V[:-1], atol=1e-12)
    np.testing.assert_allclose(trace.soc[:-1], run.soc[:-1], atol=1e-13)
