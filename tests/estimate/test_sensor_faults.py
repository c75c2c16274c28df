"""Every fault of a sensor has a defined answer and a status bit, in both Kalman filters."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import TemperatureDependence
from cellwise.cell.protocol import ConstantCurrent, ConstantVoltage, Rest, run_protocol
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.filters.kalman import Ekf, Ukf
from cellwise.estimate.saved_state import (
    read_state,
    state_from_dict,
    state_to_dict,
    write_state,
)
from cellwise.estimate.status import Status
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell

CURVED = curved_cell()
FILTERS = pytest.mark.parametrize("make", [Ekf, Ukf])
UNUSED = Status.VOLTAGE_FROZEN | Status.VOLTAGE_INVALID | Status.OUT_OF_RANGE


def driven(model, soc0=0.8, rows=2400, seed=1, noise_V=0.001, mean_A=0.5, dt=1.0, jitter=0.0):
    """A drive of ten-second steps, its voltage the model's, and the true SOC."""
    rng = np.random.default_rng(seed)
    time = dt * (np.arange(float(rows)) + jitter * rng.uniform(-0.45, 0.45, rows))
    time -= time[0]
    steps = rng.normal(mean_A, 2.0, int(time[-1] / 10) + 2)
    current = steps[np.ceil(time / 10).astype(int)]
    current[0] = 0.0
    log = CellLog(time, current, np.full(rows, 3.7))
    run = simulate(model, log, soc0)
    return replace(log, voltage_V=run.voltage_V + noise_V * rng.standard_normal(rows)), run.soc


def bits(trace, rows):
    return np.bitwise_or.reduce(trace.status[rows])


@FILTERS
@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("voltage_V", 0.0, Status.VOLTAGE_INVALID),
        ("voltage_V", 65.535, Status.VOLTAGE_INVALID),
        ("current_A", 32767.0, Status.CURRENT_INVALID),
        ("current_A", -32768.0, Status.CURRENT_INVALID),
    ],
)
def test_a_reading_that_no_cell_gives_counts_as_missing(make, field, value, told):
    log, _ = driven(CURVED)
    spoilt, missing = getattr(log, field).copy(), getattr(log, field).copy()
    spoilt[1003:1006] = value
    missing[1003:1006] = np.nan
    a, b = (make(CURVED).run(replace(log, **{field: v}), 0.8, 0.02) for v in (spoilt, missing))
    assert np.all(a.status[1003:1006] == (told | Status.OUT_OF_RANGE))
    assert np.all(b.status[1003:1006] == told)
    np.testing.assert_array_equal(a.soc, b.soc)
    np.testing.assert_array_equal(a.soc_std, b.soc_std)


class TestFrozenVoltage:
    @FILTERS
    def test_it_is_found_and_charge_is_counted(self, make):
        log, truth = driven(CURVED)
        voltage = log.voltage_V.copy()
        voltage[1000:1600] = voltage[1000]
        trace = make(CURVED).run(replace(log, voltage_V=voltage), 0.8, 0.02)
        frozen = (trace.status & Status.VOLTAGE_FROZEN) > 0
        assert np.flatnonzero(frozen)[0] < 1060
        assert np.mean(frozen[1060:1600]) == 1.0
        assert not frozen[:1000].any()
        assert not frozen[1600:].any()
        assert trace.status[1599] & Status.VOLTAGE_LOST
        assert np.max(np.abs(trace.soc - truth)) < 0.01

    @FILTERS
    def test_its_last_digits_may_dither(self, make):
        log, truth = driven(CURVED)
        voltage = log.voltage_V.copy()
        dither = np.random.default_rng(2).uniform(-0.001, 0.001, 600)
        voltage[1000:1600] = voltage[1000] + dither
        trace = make(CURVED).run(replace(log, voltage_V=voltage), 0.8, 0.02)
        assert np.mean((trace.status[1060:1600] & Status.VOLTAGE_FROZEN) > 0) == 1.0
        assert np.max(np.abs(trace.soc - truth)) < 0.01

    @FILTERS
    def test_a_coarse_sensor_on_a_resting_cell_is_not_frozen(self, make):
        log = run_protocol(
            CURVED, [ConstantCurrent(current_A=3.0, duration_s=600.0), Rest(3600.0)], 0.8
        )
        coarse = replace(log, voltage_V=np.round(log.voltage_V / 0.01) * 0.01)
        assert not bits(make(CURVED).run(coarse, 0.7, 0.1), slice(None)) & UNUSED

    @FILTERS
    def test_a_held_voltage_is_not_frozen(self, make):
        steps = [
            ConstantCurrent(current_A=-1.5, voltage_max_V=4.1),
            ConstantVoltage(voltage_V=4.1, until_current_A=0.1),
        ]
        log = run_protocol(CURVED, steps, 0.6)
        held = np.count_nonzero(np.abs(log.voltage_V - 4.1) < 1e-6)
        assert held > 100
        exact = replace(log, voltage_V=np.round(log.voltage_V, 6))
        assert not bits(make(CURVED).run(exact, 0.6, 0.02), slice(None)) & UNUSED


class TestDeadCurrent:
    """A sensor that repeats its last reading while the load goes on."""

    dead = slice(600, 1800)

    @FILTERS
    @pytest.mark.parametrize("reading_A", [0.0, 1.7])
    def test_it_is_missing_and_the_band_says_so(self, make, reading_A):
        log, truth = driven(CURVED)
        current = log.current_A.copy()
        current[self.dead] = reading_A
        trace = make(CURVED).run(replace(log, current_A=current), 0.8, 0.02)
        invalid = (trace.status & Status.CURRENT_INVALID) > 0
        assert not invalid[:600].any()
        assert np.mean(invalid[800:1800]) == 1.0
        assert not invalid[1800:].any()
        error = np.abs(trace.soc - truth)
        assert np.mean(error <= 2.0 * trace.soc_std) > 0.9

    @FILTERS
    def test_a_constant_load_and_a_rest_are_none(self, make):
        steps = [ConstantCurrent(current_A=3.0, soc=0.02), Rest(3600.0)]
        log = run_protocol(CURVED, steps, 1.0)
        noisy = log.voltage_V + 0.003 * np.random.default_rng(5).standard_normal(len(log))
        trace = make(CURVED).run(replace(log, voltage_V=noisy), 1.0, 0.01)
        assert not bits(trace, slice(None)) & Status.CURRENT_INVALID


@FILTERS
def test_more_than_twice_a_short_circuit_is_the_sensors_fault(make):
    log, truth = driven(CURVED)
    shorted_A = CURVED.ocv_V.max() / CURVED.r0_ohm.min()
    current = log.current_A.copy()
    current[1000:1010] = 2.1 * shorted_A
    trace = make(CURVED).run(replace(log, current_A=current), 0.8, 0.02)
    told = Status.CURRENT_INVALID | Status.OUT_OF_RANGE
    assert np.all(trace.status[1000:1010] & told == told)
    assert np.max(np.abs(trace.soc - truth)) < 0.02


class TestLostCurrent:
    lost = slice(600, 1800)

    def holey(self, **changes):
        log, truth = driven(CURVED, **changes)
        current = log.current_A.copy()
        current[self.lost] = np.nan
        return replace(log, current_A=current), truth

    @FILTERS
    def test_the_voltage_alone_leads_and_the_doubt_is_honest(self, make):
        log, truth = self.holey()
        trace = make(CURVED).run(log, 0.8, 0.02)
        held = round(trace.time_s[600] + 10.0)
        assert trace.status[held - 5] == Status.CURRENT_INVALID
        assert np.all(trace.status[held + 1 : 1800] & Status.CURRENT_LOST)
        assert not trace.status[1800] & Status.CURRENT_LOST
        error = np.abs(trace.soc - truth)
        assert np.max(error[self.lost]) < 0.1
        assert np.mean(error[self.lost] <= 2 * trace.soc_std[self.lost]) > 0.9
        assert trace.soc_std[1799] > 3 * trace.soc_std[599]
        assert error[-1] < 0.03

    @FILTERS
    def test_without_either_the_doubt_grows_as_the_current_could_flow(self, make):
        log, _ = self.holey()
        voltage = log.voltage_V.copy()
        voltage[self.lost] = np.nan
        trace = make(CURVED).run(replace(log, voltage_V=voltage), 0.8, 0.02)
        assert trace.soc[1799] == trace.soc[620]  # nothing is counted
        half_rate = 0.5 * (1799 - 620) / 3600
        assert trace.soc_std[1799] - trace.soc_std[620] == pytest.approx(half_rate, rel=0.02)


@FILTERS
def test_a_lost_voltage_leaves_counting_and_says_so(make):
    log, truth = driven(CURVED)
    voltage = log.voltage_V.copy()
    voltage[600:1800] = np.nan
    trace = make(CURVED).run(replace(log, voltage_V=voltage), 0.8, 0.02)
    assert trace.status[605] == Status.VOLTAGE_INVALID
    assert np.all(trace.status[615:1800] == (Status.VOLTAGE_INVALID | Status.VOLTAGE_LOST))
    assert trace.status[1800] == 0
    counted = trace.soc[599] - np.cumsum(log.current_A[600:1800]) / (3600 * 3.0)
    np.testing.assert_allclose(trace.soc[600:1800], counted, atol=1e-5)  # and a believed offset
    assert np.all(np.diff(trace.soc_std[600:1800]) > 0)
    assert np.max(np.abs(trace.soc - truth)) < 0.01


@FILTERS
def test_a_jittering_clock_costs_less_than_two_points(make):
    """Rows that come up to half a second early or late: the interval is what was measured."""
    log, truth = driven(CURVED, jitter=1.0)
    assert np.ptp(log.interval_s[1:]) > 0.5
    trace = make(CURVED).run(log, 0.6, 0.15)
    assert not bits(trace, slice(1, None))
    assert np.max(np.abs(trace.soc - truth)[900:]) < 0.02


class TestTemperature:
    model = curved_cell(effects=(TemperatureDependence(activation_K=3000.0, reference_C=25.0),))

    @FILTERS
    def test_a_missing_one_is_the_last_that_was_measured(self, make):
        log, _ = driven(self.model)
        cold = np.linspace(25.0, 20.0, len(log))
        holes, held = cold.copy(), cold.copy()
        holes[1000:1500] = np.nan
        held[1000:1500] = cold[999]
        wild = holes.copy()
        wild[1200] = 999.0
        a, b, c = (
            make(self.model).run(replace(log, temperature_C=t), 0.8, 0.05)
            for t in (holes, held, wild)
        )
        np.testing.assert_array_equal(a.soc[:1000], b.soc[:1000])
        np.testing.assert_array_equal(a.soc, c.soc)
        # It may have changed meanwhile: the voltage says less, and the prediction is as unsure.
        assert np.all(a.innovation_variance_V2[1000:1500] > b.innovation_variance_V2[1000:1500])
        assert np.all(a.status[1000:1500] & Status.TEMPERATURE_INVALID)
        assert not bits(a, slice(0, 1000)) & Status.TEMPERATURE_INVALID
        assert not bits(b, slice(None)) & Status.TEMPERATURE_INVALID

    @FILTERS
    def test_a_cell_that_cools_unseen_stays_within_its_band(self, make):
        """25 degC when the sensor broke, -10 an hour later: resistances three times as large."""
        log, _ = driven(self.model, mean_A=0.6, rows=3600)
        warm = np.clip(25.0 - 0.02 * (log.time_s - 600.0), -10.0, 25.0)
        known = replace(log, temperature_C=warm)
        run = simulate(self.model, known, 0.8)
        lost = np.where(log.time_s < 600.0, warm, np.nan)
        cold = replace(known, voltage_V=run.voltage_V, temperature_C=lost)
        trace = make(self.model).run(cold, 0.8, 0.02)
        error = np.abs(trace.soc - run.soc)
        assert np.mean(error < 2.0 * trace.soc_std) > 0.93
        assert error.max() < 0.04

    @FILTERS
    def test_where_nobody_measures_it_is_the_models_and_told(self, make):
        log, _ = driven(self.model)
        a = make(self.model).run(log, 0.8, 0.05)
        b = make(self.model).run(replace(log, temperature_C=np.full(len(log), 25.0)), 0.8, 0.05)
        np.testing.assert_array_equal(a.soc, b.soc)
        assert np.all(a.status & Status.TEMPERATURE_INVALID)

    @FILTERS
    def test_a_model_that_does_not_ask_for_it_does_not_miss_it(self, make):
        log, _ = driven(CURVED)
        assert not bits(make(CURVED).run(log, 0.8, 0.05), slice(None)) & Status.TEMPERATURE_INVALID


class TestRestart:
    def halves(self, make):
        log, _ = driven(CURVED, rows=400)
        filter_ = make(CURVED)
        state = filter_.init(0.7, 0.1)
        for k in range(200):
            state, _ = filter_.step(state, log.current_A[k], log.voltage_V[k], dt_s=1.0)
        return log, filter_, state

    @FILTERS
    def test_a_saved_state_goes_on_bit_for_bit(self, make, tmp_path):
        log, filter_, state = self.halves(make)
        write_state(state, tmp_path / "state.json", filter_.name)
        again = read_state(tmp_path / "state.json", filter_.name)
        assert str(again) == str(state)  # a missing temperature is no number and so not equal
        for k in range(200, 400):
            state, a = filter_.step(state, log.current_A[k], log.voltage_V[k], dt_s=1.0)
            again, b = filter_.step(again, log.current_A[k], log.voltage_V[k], dt_s=1.0)
            assert a == b

    @FILTERS
    def test_a_fresh_and_a_frozen_state_are_saved_too(self, make):
        filter_ = make(CURVED)
        state = filter_.init(0.7, 0.1)
        assert str(state_from_dict(json.loads(json.dumps(state_to_dict(state))))) == str(state)
        for current in (0.0, 0.0, 0.0, 0.0, 9.0, 9.0):
            state, info = filter_.step(state, current, 4.0, 25.0, dt_s=1.0)
        assert info.status & Status.VOLTAGE_FROZEN
        saved = json.dumps(state_to_dict(state), allow_nan=False)
        assert state_from_dict(json.loads(saved)) == state

    def test_what_passed_meanwhile_is_a_gap(self):
        _, filter_, state = self.halves(Ekf)
        after, info = filter_.step(state, 0.0, np.nan, dt_s=7200.0, gap=True)
        assert info.status == Status.SEQUENCE_GAP | Status.VOLTAGE_INVALID
        assert after.soc == state.soc
        assert after.soc_std > state.soc_std

    @pytest.mark.parametrize(
        "spoil",
        [
            lambda d: d.update(schema_version=0),
            lambda d: d.update(estimator="ukf"),
            lambda d: d["state"]["cell"].pop("soc"),
            lambda d: d["state"]["cell"].update(soc=None),
            lambda d: d["state"]["cell"].update(soc="0.5"),
            lambda d: d["state"]["cell"].update(soc=float("nan")),
            lambda d: d["state"].pop("watch"),
            lambda d: d["state"]["watch"].update(extra=1.0),
        ],
    )
    def test_a_state_that_is_none_is_refused(self, spoil):
        saved = state_to_dict(Ekf(CURVED).init(0.5))
        spoil(saved)
        with pytest.raises(InputError, match="Start again"):
            state_from_dict(saved)

    @pytest.mark.parametrize("text", ["", "{", "[1]", "3"])
    def test_a_file_that_is_none_is_refused(self, tmp_path, text):
        (tmp_path / "state.json").write_text(text)
        with pytest.raises(InputError):
            read_state(tmp_path / "state.json")
        with pytest.raises(InputError):
            read_state(tmp_path / "nowhere.json")


@FILTERS
def test_a_jump_that_stays_is_rejected_at_first_and_not_for_ever(make):
    log, _ = driven(CURVED, mean_A=0.0)
    voltage = log.voltage_V.copy()
    voltage[1000:] -= 0.3
    trace = make(CURVED).run(replace(log, voltage_V=voltage), 0.8, 0.02)
    assert trace.status[1000] & Status.INNOVATION_REJECTED
    assert bits(trace, slice(1000, 1600)) & Status.GATE_RECOVERY
    after = trace.status[1600:] & Status.INNOVATION_REJECTED
    assert np.mean(after > 0) < 0.1
    assert trace.soc_std[1600] > trace.soc_std[999]


@FILTERS
@pytest.mark.parametrize("pause_s", [1.0, 5.0])
def test_a_pause_of_seconds_costs_what_flows_in_seconds(make, pause_s):
    log, _ = driven(CURVED, rows=600)
    filter_ = make(CURVED)
    state = filter_.init(0.8, 0.005)
    for k in range(600):
        state, before = filter_.step(
            state, log.current_A[k], log.voltage_V[k], 25.0, dt_s=1.0 if k else 0.0
        )
    _, after = filter_.step(state, 2.0, np.nan, 25.0, dt_s=pause_s, gap=True)
    at_most = 3.0 * (2.0 + abs(log.current_A[-1]) + 1.5) * pause_s / (3600.0 * CURVED.capacity_Ah)
    assert before.soc_std < after.soc_std < before.soc_std + at_most
