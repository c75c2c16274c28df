"""The judgement of a replay: figures by hand, and a reference that nothing of ours can touch."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.cell.protocol import ConstantCurrent, DriveProfile, Rest, run_protocol
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.estimators import ESTIMATORS, make_estimator
from cellwise.estimate.replay import Replay, converged_row, reference_soc, replay, soc_errors
from cellwise.estimate.status import Status
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog
from example_cells import EFFECTS, curved_cell, random_log

MODEL = curved_cell()


def drive(rows=1800):
    current = np.random.default_rng(1).normal(1.0, 2.0, rows)
    profile = DriveProfile(time_s=np.arange(1.0, rows + 1.0), current_A=current)
    return run_protocol(MODEL, [Rest(900.0), profile, Rest(300.0)], 0.8)


class TestConvergedRow:
    time = np.arange(0.0, 4000.0)

    def error(self, *outside):
        """0.01 everywhere but 0.05 in the given ranges of seconds."""
        e = np.full(4000, 0.01)
        for start, stop in outside:
            e[start:stop] = -0.05 if start % 2 else 0.05
        return e

    @pytest.mark.parametrize(
        ("outside", "row"),
        [
            ((), 0),
            (((0, 4000),), None),
            (((0, 300),), 300),
            (((0, 300), (899, 905)), 905),  # 599 s inside are not enough
            (((0, 300), (900, 905)), 300),  # 600 s are
            (((0, 300), (1000, 2000)), 300),  # once converged, whatever comes later
            (((0, 3900),), 3900),  # to the end of the log
            (((0, 1), (300, 301), (600, 601)), 601),
        ],
    )
    def test_first_row_of_ten_minutes_within_2_points(self, outside, row):
        assert converged_row(self.time, self.error(*outside)) == row

    def test_time_counts_and_not_rows(self):
        slow = 60.0 * np.arange(4000)
        assert converged_row(slow, self.error((0, 300), (305, 400))) == 400
        assert converged_row(slow, self.error((0, 300), (310, 400))) == 300

    def test_the_border_itself_is_within(self):
        assert converged_row(self.time, np.full(4000, 0.02)) == 0
        assert converged_row(self.time, np.full(4000, 0.0201)) is None


def by_hand(error, std=0.01, innovation=None, variance=None, status=None, dt=1.0):
    n = error.size
    time = dt * np.arange(n)
    log = CellLog(time, np.zeros(n), np.full(n, 3.7))
    zero = np.zeros(n)
    innovation = zero if innovation is None else innovation
    trace = Trace(
        time_s=time,
        soc=0.5 + error,
        soc_std=np.full(n, std),
        voltage_V=zero,
        innovation_V=innovation,
        innovation_variance_V2=np.ones(n) if variance is None else variance,
        test_ratio=zero,
        status=np.zeros(n, np.int32) if status is None else status,
    )
    start = InitialSoc(0.5, 0.1, "given")
    return Replay(log, "by hand", start, trace, 1.0, np.full(n, 0.5))


class TestFigures:
    def test_errors_are_their_definitions(self):
        e = np.array([0.1, -0.3, 0.2])
        errors = soc_errors(e)
        assert errors.rmse == pytest.approx(np.sqrt(0.14 / 3))
        assert errors.mae == pytest.approx(0.2)
        assert errors.max == pytest.approx(0.3)
        assert soc_errors(np.append(e, np.nan)) == errors

    def test_settled_begins_at_convergence(self):
        error = np.concatenate((np.full(400, 0.3), np.full(1600, 0.01)))
        r = by_hand(error)
        assert r.convergence_s == 400.0
        assert r.settled.rmse == pytest.approx(0.01)
        assert r.settled.max == pytest.approx(0.01)
        assert r.errors.max == pytest.approx(0.3)
        assert r.errors.mae == pytest.approx(0.2 * 0.3 + 0.8 * 0.01)

    def test_what_never_converged_is_judged_by_its_second_half(self):
        error = np.concatenate((np.full(1000, 0.3), np.full(1000, 0.1)))
        r = by_hand(error)
        assert r.convergence_s is None
        assert r.settled.rmse == pytest.approx(0.1, rel=0.01)

    def test_coverage_counts_rows_within_two_deviations(self):
        error = np.array([0.0, 0.019, -0.019, 0.021, -0.5])
        assert by_hand(error, std=0.01).coverage_2sigma == pytest.approx(0.6)

    def test_without_a_reference_there_is_no_judgement(self):
        r = replace_reference(by_hand(np.zeros(10)), None)
        assert r.errors is None
        assert r.settled is None
        assert r.convergence_s is None
        assert r.coverage_2sigma is None
        figures = r.to_dict()
        assert figures["soc_rmse"] is None
        assert figures["settled"] is None

    def test_rows_without_a_reading_of_the_counter_do_not_count(self):
        r = by_hand(np.array([0.0, 0.5, 0.0, 0.5]))
        reference = np.array([0.5, np.nan, 0.5, np.nan])
        r = replace_reference(r, reference)
        assert r.errors.max == 0.0
        assert r.coverage_2sigma == 1.0


def replace_reference(r, reference):
    return Replay(r.log, r.estimator, r.start, r.trace, r.ns_per_step, reference)


class TestReference:
    def test_it_is_the_counter_over_the_capacity(self):
        log = drive()
        moved = log.charge_Ah + 7.0  # wherever the counter began
        found = reference_soc(replace(log, charge_Ah=moved), 0.75, 2.9)
        np.testing.assert_allclose(found, 0.75 - log.charge_Ah / 2.9, atol=1e-12)

    def test_it_is_none_without_a_counter(self):
        log = replace(drive(), charge_Ah=None)
        assert reference_soc(log, 0.75, 2.9) is None
        blank = replace(drive(), charge_Ah=np.full(len(log), np.nan))
        assert reference_soc(blank, 0.75, 2.9) is None

    def test_a_counter_that_begins_late(self):
        log = drive()
        late = log.charge_Ah.copy()
        late[:3] = np.nan
        found = reference_soc(replace(log, charge_Ah=late), 0.75, 2.9)
        assert np.all(np.isnan(found[:3]))
        np.testing.assert_allclose(found[3:], 0.75 - (late[3:] - late[3]) / 2.9)

    @pytest.mark.parametrize("capacity", [0.0, -1.0, np.nan, np.inf])
    def test_a_capacity_that_is_none_is_refused(self, capacity):
        with pytest.raises(InputError, match="capacity"):
            reference_soc(drive(), 0.75, capacity)

    @pytest.mark.parametrize(
        "estimator",
        [
            pytest.param(name, marks=[pytest.mark.slow] if name == "filterpy-ukf" else [])
            for name in ESTIMATORS
        ],
    )
    def test_neither_the_seen_current_nor_the_models_capacity_touch_it(self, estimator):
        log = drive(60)
        known = {"soc0": 0.7, "reference_soc0": 0.8, "reference_capacity_Ah": 3.0}
        plain = replay(MODEL, log, estimator, **known)
        biased = replace(log, current_A=1.2 * log.current_A + 0.3)
        other_current = replay(MODEL, biased, estimator, **known)
        other_model = replay(replace(MODEL, capacity_Ah=4.0), log, estimator, **known)
        for other in (other_current, other_model):
            np.testing.assert_array_equal(other.reference_soc, plain.reference_soc)
            assert np.max(np.abs(other.trace.soc - plain.trace.soc)) > 1e-4  # but the filter is
        np.testing.assert_allclose(plain.reference_soc, 0.8 - log.charge_Ah / 3.0, atol=1e-12)

    def test_no_capacity_means_no_judgement(self):
        assert replay(MODEL, drive(100), soc0=0.8).reference_soc is None


@pytest.mark.parametrize("name", ["coulomb", "ekf", "ukf", "adaptive", "rest-ocv"])
@pytest.mark.parametrize("effects", [(), EFFECTS], ids=["plain", "all effects"])
def test_one_step_at_a_time_is_the_compiled_loop(name, effects):
    """Loads and rests, missing readings, a repeated stamp, a gap; a step leaves its state alone."""
    model = curved_cell(effects=effects)
    log = random_log(np.random.default_rng(2), 2000, jitter=0.5, temperature_C=(0.0, 40.0))
    current = np.where(np.arange(2000) % 1000 < 200, log.current_A, 0.0)
    current[0], current[[50, 51]] = 1.0, np.nan  # it begins under load
    time, voltage = log.time_s.copy(), simulate(model, log, 0.65).voltage_V
    time[100] = time[99]
    time[300:] += 900.0
    voltage[120:125] = np.nan
    log = replace(log, current_A=current, time_s=time, voltage_V=voltage)
    one = make_estimator(name, model)
    trace = one.run(log, 0.6, 0.1)
    state = one.init(0.6, 0.1)
    for k in range(len(log)):
        readings = log.current_A[k], log.voltage_V[k], log.temperature_C[k]
        readings = readings[: 1 if name == "coulomb" else 3]
        before = repr(state)
        after, info = one.step(state, *readings, dt_s=log.interval_s[k], gap=bool(log.gap_rows[k]))
        assert repr(state) == before
        state = after
        for field in set(info._fields) & set(vars(trace)):
            want = getattr(trace, field)[k]
            found = float(getattr(info, field))
            assert found == pytest.approx(want, rel=1e-12, abs=1e-12, nan_ok=True), (k, field)
    seen = np.bitwise_or.reduce(trace.status)
    assert seen & Status.CURRENT_INVALID
    assert seen & Status.DUPLICATE
    assert seen & Status.SEQUENCE_GAP


class TestReplay:
    @pytest.mark.parametrize("estimator", ESTIMATORS)
    def test_every_estimator_has_the_keys_of_the_contract(self, estimator):
        r = replay(MODEL, drive(300), estimator, soc0=0.8, reference_capacity_Ah=3.0)
        figures = json.loads(json.dumps(r.to_dict(), allow_nan=False))
        for key in ("estimator", "samples", "soc_final", "soc_rmse", "soc_mae", "soc_max_error",
                    "convergence_s", "settled", "coverage_2sigma", "nis_mean", "voltage_rmse_V",
                    "ns_per_step"):  # fmt: skip
            assert key in figures
        assert figures["estimator"] == estimator
        assert figures["samples"] == len(r.log)
        assert set(figures["settled"]) == {"rmse", "mae", "max"}
        assert figures["ns_per_step"] > 0
        assert figures["soc_final"] == r.trace.soc[-1]

    def test_the_ekf_finds_the_way_where_counting_cannot(self):
        log = drive()
        known = {"soc0": 0.6, "reference_soc0": 0.8, "reference_capacity_Ah": 3.0}
        ekf, counter = (replay(MODEL, log, name, **known) for name in ("ekf", "coulomb"))
        assert counter.convergence_s is None
        assert counter.errors.rmse == pytest.approx(0.2, abs=1e-6)
        assert ekf.convergence_s < 1200
        assert ekf.settled.rmse < 0.02
        assert ekf.coverage_2sigma > 0.9

    def test_start_is_found_where_nobody_says_it(self):
        log = drive()
        r = replay(MODEL, log, reference_capacity_Ah=3.0)
        assert r.start.how.startswith("rest of 900 s")
        assert r.start.soc == pytest.approx(0.8, abs=2e-3)
        assert r.reference_soc[0] == r.start.soc
        # A stated start of the filter is not taken for the truth.
        wrong = replay(MODEL, log, soc0=0.4, reference_capacity_Ah=3.0)
        assert wrong.reference_soc[0] == r.start.soc
        assert wrong.start.std == 0.15
        assert replay(MODEL, log, soc0=0.4, soc0_std=0.02).start.std == 0.02

    @pytest.mark.parametrize("field", ["voltage_V", "current_A"])
    def test_a_log_that_begins_with_missing_values(self, field):
        log = drive(300)
        values = getattr(log, field).copy()
        values[:3] = np.nan
        holey = replace(log, **{field: values})
        r = replay(MODEL, holey, soc0=0.8, reference_soc0=0.8, reference_capacity_Ah=3.0)
        assert r.errors.max < 0.03
        json.dumps(r.to_dict(), allow_nan=False)

    def test_any_object_that_can_run_a_log_is_an_estimator(self):
        class Still:
            name = "still"

            def run(self, log, soc0, soc0_std=0.15):
                n = len(log)
                nan = np.full(n, np.nan)
                return Trace(log.time_s, np.full(n, soc0), nan, nan, nan, nan, nan,
                             np.zeros(n, np.int32))  # fmt: skip

        r = replay(MODEL, drive(100), Still(), soc0=0.6)
        assert r.estimator == "still"
        assert r.trace.soc[-1] == 0.6
        assert r.nis_mean is None

    def test_unknown_names_and_impossible_starts_are_refused(self):
        with pytest.raises(InputError, match="coulomb, ekf"):
            make_estimator("kalman", MODEL)
        with pytest.raises(InputError, match="from 0 to 1"):
            replay(MODEL, drive(100), soc0=70.0)

    def test_repr_names_the_estimator_and_its_settled_error(self):
        r = replay(MODEL, drive(100), soc0=0.8, reference_soc0=0.8, reference_capacity_Ah=3.0)
        assert "ekf" in repr(r)
        assert "settled RMSE" in repr(r)


def test_a_drive_through_gaps_is_followed():
    steps = [Rest(900.0), ConstantCurrent(current_A=2.0, duration_s=900.0), Rest(1800.0)]
    log = run_protocol(MODEL, steps, 0.8)
    kept = np.flatnonzero((log.time_s < 1200) | (log.time_s > 1500))
    holey = log.rows(kept)
    r = replay(MODEL, holey, soc0=0.8, reference_soc0=0.8, reference_capacity_Ah=3.0)
    row = int(np.flatnonzero(holey.gap_rows)[0])
    assert r.trace.status[row] & Status.SEQUENCE_GAP
    missed = 2.0 * 301 / (3600 * 3.0)
    assert 0 <= r.error[row] <= missed  # it cannot know, but the voltage tells the direction
    assert abs(r.error[-1]) < 0.2 * missed  # and it finds out
    assert r.coverage_2sigma > 0.9


def test_the_sums_of_a_trace_are_those_of_its_arrays():
    rng = np.random.default_rng(5)
    innovation = rng.normal(0.0, 0.01, 500)
    innovation[rng.integers(0, 500, 20)] = np.nan
    variance = rng.uniform(1e-5, 1e-3, 500)
    variance[:5] = np.nan
    status = rng.choice([0, 0, 0, Status.INNOVATION_REJECTED, Status.VOLTAGE_FROZEN], 500)
    run = by_hand(np.zeros(500), innovation=innovation, variance=variance, status=status)
    known = innovation[np.isfinite(innovation)]
    nis = (innovation**2 / variance)[(status == 0) & np.isfinite(innovation**2 / variance)]
    assert run.voltage_rmse_V == pytest.approx(np.sqrt(np.mean(known**2)), rel=1e-12)
    assert run.nis_mean == pytest.approx(np.mean(nis), rel=1e-12)
    assert run.trace.rejected == np.mean(status == Status.INNOVATION_REJECTED)
