"""What an online filter meets: outliers, missing values, gaps, repeated stamps, wrong starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_ekf_oracle import covariance_of, mean_of

from cellwise.cell.effects import Hysteresis
from cellwise.cell.protocol import ConstantCurrent, Rest, run_protocol
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.filters.kalman import Ekf, Ukf
from cellwise.estimate.noise import WANDERS, Noise
from cellwise.estimate.status import Status
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell, lfp_cell, random_model
from virtual_tester import logged

CURVED = curved_cell()


def driven(model, soc0, rows=3600, seed=1, noise_V=0.001, mean_A=0.3, **log):
    rng = np.random.default_rng(seed)
    current = np.repeat(rng.normal(mean_A, 2.0, rows // 10 + 1), 10)[:rows]
    current[0] = 0.0
    drive = CellLog(np.arange(float(rows)), current, np.full(rows, 3.7), **log)
    run = simulate(model, drive, soc0)
    return replace(drive, voltage_V=run.voltage_V + noise_V * rng.standard_normal(rows)), run.soc


def bits(trace, row):
    return Status(int(trace.status[row]))


class TestConvergence:
    @pytest.mark.parametrize("kind", [Ekf, Ukf])
    @pytest.mark.parametrize("soc0", [0.2, 0.5, 0.95])
    def test_from_a_wrong_start(self, kind, soc0):
        log, truth = driven(CURVED, 0.8)
        trace = kind(CURVED).run(log, soc0, 0.3)
        error = np.abs(trace.soc - truth)
        assert error[0] < abs(soc0 - 0.8) + 1e-9
        assert np.max(error[600:]) < 0.03
        assert np.max(error[-600:]) < 0.015

    @pytest.mark.parametrize("rate", [0.2, 0.5, 1.0, 2.0])
    def test_30_points_off_under_a_steady_load(self, rate):
        """No rest and no dynamics: neither the curve of the OCV nor the gate may lock it in."""
        log = run_protocol(CURVED, [ConstantCurrent(current_A=3.0 * rate, soc=0.15)], 0.9)
        truth = 0.9 - log.charge_Ah / 3.0
        trace = Ekf(CURVED).run(log, 0.6, 0.15)
        error = np.abs(trace.soc - truth)
        assert np.max(error[log.time_s > 300]) < 0.02
        assert np.mean(error <= 2 * trace.soc_std) > 0.9

    @pytest.mark.parametrize("kind", [Ekf, Ukf])
    @pytest.mark.parametrize("off", [-0.3, 0.15])
    def test_off_at_a_rest(self, kind, off):
        log = run_protocol(CURVED, [Rest(1800.0)], 0.8)
        trace = kind(CURVED).run(log, 0.8 + off, 0.15)
        error = np.abs(trace.soc - 0.8)
        assert np.max(error[300:]) < 0.02
        assert np.mean(error <= 2 * trace.soc_std) > 0.9

    def test_an_ideal_log_keeps_a_right_start_right(self):
        log, truth = driven(CURVED, 0.8, noise_V=0.0)
        trace = Ekf(CURVED, components=1).run(log, 0.8, 0.05)
        np.testing.assert_allclose(trace.soc, truth, atol=1e-10)
        # Components lie within 0..1, which is nearer above than below.
        trace = Ekf(CURVED).run(log, 0.8, 0.05)
        np.testing.assert_allclose(trace.soc, truth, atol=0.005)


class TestGate:
    @pytest.mark.parametrize("jump_V", [1.0, -0.8])
    def test_an_outlier_changes_nothing(self, jump_V):
        log, _ = driven(CURVED, 0.8)
        spoilt, missing = log.voltage_V.copy(), log.voltage_V.copy()
        spoilt[1800] += jump_V
        missing[1800] = np.nan
        a = Ekf(CURVED).run(replace(log, voltage_V=spoilt), 0.8)
        b = Ekf(CURVED).run(replace(log, voltage_V=missing), 0.8)
        assert bits(a, 1800) == Status.INNOVATION_REJECTED
        assert bits(b, 1800) == Status.VOLTAGE_INVALID
        assert a.test_ratio[1800] > 1
        np.testing.assert_array_equal(a.soc, b.soc)
        np.testing.assert_array_equal(a.soc_std, b.soc_std)

    def test_it_recovers_from_a_start_that_locks_the_truth_out(self):
        log, truth = driven(CURVED, 0.9, rows=7200)
        trace = Ekf(CURVED).run(log, 0.5, 0.01)
        assert bits(trace, 0) & Status.INNOVATION_REJECTED
        recoveries = np.flatnonzero(trace.status & Status.GATE_RECOVERY)
        assert recoveries.size >= 1
        assert (
            recoveries[0] == Noise.of_model(CURVED).recovery_after
        )  # no time has passed at the first row
        assert np.max(np.abs(trace.soc - truth)[3600:]) < 0.02
        assert not np.any(trace.status[recoveries[-1] + 1 :] & Status.INNOVATION_REJECTED)

    def test_a_resistance_that_is_wrong_is_rejected_and_moves_the_soc_late(self):
        """Off by twice the drop that the model expects, under loads that change: not in a row."""
        log, truth = driven(replace(CURVED, r0_ohm=CURVED.r0_ohm + 0.07), 0.8, mean_A=2.0)
        trace = Ekf(CURVED).run(log, 0.8, 0.02)
        rejected = np.cumsum((trace.status & Status.INNOVATION_REJECTED) > 0)
        recovered = np.flatnonzero(trace.status & Status.GATE_RECOVERY)
        assert rejected[-1] > 400
        assert rejected[recovered[0]] >= Noise().recovery_after
        assert np.max(np.abs(trace.soc - truth)[: recovered[0]]) < 0.05
        # Such a drop looks like a current that is off, too: without that hypothesis below 0.08.
        assert np.median(np.abs(trace.soc - truth)) < 0.15

    def test_a_start_that_is_too_sure_is_let_go_under_a_steady_load(self):
        """Under load the polarisation could explain the voltage for ever: it must not."""
        log = run_protocol(CURVED, [ConstantCurrent(current_A=3.0, soc=0.3)], 0.9)
        truth = 0.9 - log.charge_Ah / 3.0
        trace = Ekf(CURVED).run(log, 0.7, 0.01)
        assert np.any(trace.status & Status.GATE_RECOVERY)
        assert abs(trace.soc[-1] - truth[-1]) < 0.03

    def test_without_recovery_it_would_stay_locked_out(self):
        log, truth = driven(CURVED, 0.9)
        never = replace(Noise.of_model(CURVED), recovery_after=10**9)
        trace = Ekf(CURVED, never).run(log, 0.5, 0.01)
        assert abs(trace.soc[-1] - truth[-1]) > 0.2


class TestMissing:
    @pytest.mark.parametrize("rows", [1, 50])
    def test_current_missing_from_the_first_row_is_a_rest(self, rows):
        log, truth = driven(CURVED, 0.8)
        holes = log.current_A.copy()
        holes[:rows] = np.nan
        trace = Ekf(CURVED).run(replace(log, current_A=holes), 0.8, 0.05)
        assert np.all(np.isfinite(trace.soc))
        assert not np.any(trace.status & (Status.STATE_RESET | Status.VOLTAGE_INVALID))
        assert np.max(np.abs(trace.soc - truth)) < 0.02

    @pytest.mark.parametrize("wild", [np.nan, np.inf, -np.inf])
    def test_online_nothing_but_finite_numbers_is_used(self, wild):
        ekf = Ekf(CURVED)
        state = ekf.init(0.5, 0.1)
        state, _ = ekf.step(state, 1.0, 3.6, 25.0, dt_s=1.0)
        state, info = ekf.step(state, wild, 3.6, wild, dt_s=1.0)
        assert info.status == Status.CURRENT_INVALID
        assert state.current_A == 1.0
        state, info = ekf.step(state, 1.0, wild, None, dt_s=1.0)
        assert info.status == Status.VOLTAGE_INVALID
        assert np.all(np.isfinite(mean_of(state)))
        assert np.all(np.isfinite(covariance_of(state)))


class TestStatus:
    def test_a_gap_widens_and_moves_no_charge(self):
        log, _ = driven(CURVED, 0.8)
        time = log.time_s.copy()
        time[2000:] += 3600.0
        current, voltage = log.current_A.copy(), log.voltage_V.copy()
        current[2000], voltage[2000] = 50.0, np.nan  # what the row says of the gap is not used
        late = replace(log, time_s=time, current_A=current, voltage_V=voltage)
        noise = Noise(gap_soc=0.07)
        trace = Ekf(CURVED, noise).run(late, 0.8)
        assert bits(trace, 2000) == Status.SEQUENCE_GAP | Status.VOLTAGE_INVALID
        assert trace.soc[2000] == trace.soc[1999]
        walk = (noise.soc_per_sqrt_h / 60 * WANDERS) ** 2 * 3601
        sensor = (noise.current_A * 3601 / (3600 * 3.0)) ** 2
        grown = trace.soc_std[2000] ** 2 - trace.soc_std[1999] ** 2
        assert grown == pytest.approx(0.07**2 + walk + sensor, rel=1e-9)

    @pytest.mark.parametrize("copies", [2, 5])
    def test_repeated_stamps_are_told_and_are_no_new_evidence(self, copies):
        log, _ = driven(CURVED, 0.8)
        once = Ekf(CURVED).run(log, 0.6)
        rows = np.repeat(np.arange(len(log)), copies)
        again = Ekf(CURVED).run(log.rows(rows), 0.6)
        repeated = np.arange(rows.size) % copies > 0
        assert np.all(again.status[repeated] & Status.DUPLICATE)
        assert not np.any(again.status[~repeated][1:] & Status.DUPLICATE)
        np.testing.assert_allclose(again.soc[copies - 1 :: copies], once.soc, atol=1e-12)
        np.testing.assert_allclose(again.soc_std[copies - 1 :: copies], once.soc_std, rtol=1e-9)

    @pytest.mark.parametrize(("soc0", "current", "bound"), [(0.001, 3.0, 0.0), (0.999, -3.0, 1.0)])
    def test_soc_is_held_at_its_bounds(self, soc0, current, bound):
        log = CellLog(
            np.arange(200.0), np.append(0.0, np.full(199, current)),
            np.append(3.7, np.full(199, np.nan)),
        )  # fmt: skip
        blind = replace(log, voltage_V=np.append(np.nan, np.append(np.full(198, np.nan), 3.7)))
        trace = Ekf(CURVED).run(blind, soc0, 0.01)
        held = trace.soc == bound
        assert np.count_nonzero(held) > 150
        assert np.all(trace.status[held] & Status.CLAMPED)
        assert not np.any(trace.status[~held] & Status.CLAMPED)

    @pytest.mark.parametrize("field", ["soc", "ss"])
    def test_a_state_that_is_not_finite_is_started_anew(self, field):
        ekf = Ekf(CURVED)
        state = ekf.init(0.5, 0.1)
        part = "cell" if field == "soc" else "p"
        state = state._replace(**{part: getattr(state, part)._replace(**{field: np.nan})})
        state, info = ekf.step(state, 1.0, 3.9, dt_s=1.0)
        assert info.status & Status.STATE_RESET
        assert np.all(np.isfinite(mean_of(state)))
        assert np.all(np.isfinite(covariance_of(state)))
        assert info.soc_std > 0.05  # it knows that it knows nothing
        state, info = ekf.step(state, 1.0, 3.9, dt_s=1.0)
        assert not info.status & Status.STATE_RESET


def random_walk(ekf, model, steps, seed):
    """States of a filter that is fed anything: noise, holes, gaps, repeated stamps."""
    rng = np.random.default_rng(seed)
    current = rng.normal(0.0, 2.0 * model.capacity_Ah, steps)
    voltage = rng.normal(3.7, 0.4, steps)
    temperature = rng.uniform(-30.0, 60.0, steps)
    dt = 10.0 ** rng.uniform(-2.0, 2.0, steps)
    gap = rng.random(steps) < 0.01
    current[rng.random(steps) < 0.05] = np.nan
    voltage[rng.random(steps) < 0.05] = np.nan
    temperature[rng.random(steps) < 0.05] = np.nan
    dt[rng.random(steps) < 0.05] = 0.0
    state = ekf.init(0.5, 0.3)
    for k in range(steps):
        state, info = ekf.step(
            state, current[k], voltage[k], temperature[k], dt_s=dt[k], gap=bool(gap[k])
        )
        yield state, info


@pytest.mark.parametrize(
    ("kind", "model"),
    [
        (Ekf, random_model(np.random.default_rng(1))),
        (Ekf, lfp_cell().with_effect(Hysteresis(0.03, 200.0))),
        (Ekf, CURVED),
        (Ukf, CURVED),
    ],
    ids=["every effect", "flat with hysteresis", "plain", "sigma points"],
)
def test_covariance_stays_positive_semidefinite_and_soc_in_bounds(kind, model):
    matrices, socs, seen = [], [], 0
    for state, info in random_walk(kind(model), model, 8_000, 3):
        matrices.append(covariance_of(state))
        socs.append(state.soc)
        assert -1.0 <= state.cell.h <= 1.0
        seen |= info.status
    matrices, socs = np.array(matrices), np.array(socs)
    assert np.all(np.isfinite(matrices))
    assert np.all((socs >= 0) & (socs <= 1))
    # In units of each state's own deviation, so that no state hides behind another's scale.
    scale = np.sqrt(np.maximum(np.diagonal(matrices, axis1=1, axis2=2), 1e-18))
    correlation = matrices / (scale[:, :, None] * scale[:, None, :])
    assert np.all(np.diagonal(matrices, axis1=1, axis2=2) >= 0)
    assert np.linalg.eigvalsh(correlation).min() > -1e-6
    # Under a current this wild the branches explain any misfit, and components differ for ever,
    # whose mean lies within 0..1: recovery and clamp have their own tests.
    expected = Status(255) & ~Status.STATE_RESET & ~Status.GATE_RECOVERY & ~Status.CLAMPED
    assert Status(seen) & expected == expected


@pytest.mark.parametrize("current_A", [3.0, -3.0])
def test_long_rows_beyond_the_ends_keep_a_slope(current_A):
    """Rows of ten minutes at an end of the range: the chord must not close to nothing."""
    rows = 40
    log = CellLog(600.0 * np.arange(rows), np.full(rows, current_A), np.full(rows, 3.3))
    trace = Ekf(CURVED).run(log, 0.5, 0.15)
    for values in (trace.soc, trace.soc_std, trace.innovation_variance_V2):
        assert np.all(np.isfinite(values))
    assert not np.any(trace.status & Status.STATE_RESET)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Ekf(CURVED).init(1.2),
        lambda: Ekf(CURVED).init(-0.1),
        lambda: Ekf(CURVED).init(np.nan),
        lambda: Ekf(CURVED).init(0.5, 0.0),
        lambda: Ekf(CURVED).init(0.5, np.nan),
        lambda: Noise(voltage_V=0.0),
        lambda: Noise(gate=0.0),
        lambda: Noise(current_A=-1.0),
        lambda: Noise(slow_s=np.nan),
        lambda: Noise(lasting_share=1.5),
        lambda: Noise(offset_share=-0.01),
    ],
)
def test_starts_and_noise_that_make_no_sense_are_refused(make):
    with pytest.raises(InputError):
        make()


def test_a_log_of_any_rate_ends_with_about_the_same_certainty():
    """1 Hz and 10 Hz rows of one drive hold the same evidence where the error is slow."""
    log, _ = driven(CURVED, 0.8)
    fine = CellLog(
        np.arange(0.0, 3599.01, 0.1),
        np.append(log.current_A[0], np.repeat(log.current_A[1:], 10)),
        np.full(35991, 3.7),
    )
    noise = Noise(current_A=0.0, soc_per_sqrt_h=0.0)
    fine = logged(CURVED, fine, 0.8)
    a, b = (Ekf(CURVED, noise).run(x, 0.8, 0.1).soc_std[-1] for x in (log, fine))
    assert b == pytest.approx(a, rel=0.03)
