"""The fixed step: what it conserves, what bad input does, how near it is to the float64 EKF."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from cellwise.data import load_dataset
from cellwise.estimate.equations.constants import BLOCK_S
from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.fixed.fixed_step import FixedStep, samples_of
from cellwise.estimate.fixed.layout import INPUT, OUTPUT
from cellwise.estimate.fixed.lookup import Place
from cellwise.estimate.fixed.stepper import compiled, numba_stepper, start_state
from cellwise.estimate.status import Status
from cellwise.logs.cell_log import CellLog, resample
from example_cells import curved_cell
from firmware_cases import stress_samples, tables_of
from virtual_tester import logged

STEPPER = numba_stepper(tables_of("lean"))


def steady(rows, current_A=1.0, voltage_V=np.nan, start=0):
    samples = np.zeros(rows, dtype=INPUT)
    samples["current_A"] = current_A
    samples["voltage_V"] = voltage_V
    samples["temperature_C"] = 25.0
    samples["sequence"] = start + np.arange(rows)
    return samples


def begun(soc=0.9, std=0.05, stepper=STEPPER):
    """A state that has seen its first sample, at rest."""
    state = start_state(stepper, soc, std)
    stepper.rows(state, steady(1, current_A=0.0))
    return state


def test_no_charge_is_lost_to_rounding():
    # A step takes less than half of float32's last digit near 1: plain summation would never move.
    rows, current = 200_000, 0.0002
    state = begun(0.9)
    out = STEPPER.rows(state, steady(rows, current, start=1))
    assert 0.9 - out["soc"][-1] == pytest.approx(rows * current / (3600.0 * 3.0), rel=1e-3)


def test_a_duplicate_moves_nothing_and_says_so():
    state = begun()
    STEPPER.rows(state, steady(5, 1.0, 4.0, start=1))
    before = state.copy()
    out = STEPPER.rows(state, steady(1, 50.0, 3.0, start=5))
    assert out["status"][0] == Status.DUPLICATE
    assert state.tobytes() == before.tobytes()


@pytest.mark.parametrize("missing", [1, 3])
@pytest.mark.parametrize("build", ["lean", "plain"])
def test_a_short_gap_is_bridged_and_told(build, missing):
    stepper = STEPPER if build == "lean" else numba_stepper(tables_of(build))
    whole, gappy = begun(stepper=stepper), begun(stepper=stepper)
    stepper.rows(whole, steady(21 + missing, 2.0, start=1))
    stepper.rows(gappy, steady(10, 2.0, start=1))
    out = stepper.rows(gappy, steady(11, 2.0, start=11 + missing))
    assert out["status"][0] & Status.SEQUENCE_GAP
    assert gappy["soc"][0] == pytest.approx(whole["soc"][0], abs=1e-7)
    # A lean build counts the charge of a gap; what its branches missed is a few seconds' worth.
    late = 0.02 if build == "plain" else 0.3
    assert gappy["v2_V"][0] == pytest.approx(whole["v2_V"][0], rel=late)
    assert gappy["ss"][0] > whole["ss"][0]


def test_a_long_gap_moves_nothing_and_widens_the_variance():
    state = begun()
    STEPPER.rows(state, steady(10, 2.0, start=1))
    soc, variance = float(state["soc"][0]), float(state["ss"][0])
    out = STEPPER.rows(state, steady(1, 0.0, start=100_000))
    assert out["status"][0] & Status.SEQUENCE_GAP
    assert out["soc"][0] == pytest.approx(soc, abs=1e-7)
    assert out["soc_variance"][0] >= variance + 0.05**2 * 0.99


def test_an_invalid_current_holds_the_last_and_is_told_and_widens():
    held, told = begun(), begun()
    STEPPER.rows(held, steady(20, 1.5, start=1))
    STEPPER.rows(told, steady(10, 1.5, start=1))
    out = STEPPER.rows(told, steady(10, np.nan, start=11))
    assert np.all(out["status"] & Status.CURRENT_INVALID)
    assert told["soc"][0] == held["soc"][0]
    assert told["ss"][0] > held["ss"][0]


@pytest.mark.parametrize("voltage", [np.nan, np.inf, -1.0, 900.0])
def test_an_invalid_voltage_gives_a_prediction(voltage):
    state = begun()
    out = STEPPER.rows(state, steady(3, 1.0, voltage, start=1))
    assert np.all(out["status"] & Status.VOLTAGE_INVALID)
    assert np.all(out["innovation_V"] == 0.0)
    assert np.all((out["status"] & Status.OUT_OF_RANGE != 0) == np.isfinite(voltage))


def test_any_bits_in_input_and_state_give_finite_outputs_and_recover():
    rng = np.random.default_rng(3)
    samples = stress_samples(20_000)
    state = begun()
    for k in range(0, samples.size, 20):
        if k % 400 == 0:
            state.view(np.uint8)[:] = rng.integers(0, 256, state.nbytes)
        out = STEPPER.rows(state, samples[k : k + 20])
        assert all(np.all(np.isfinite(out[name])) for name in OUTPUT.names)
        assert np.all((out["soc"] >= 0) & (out["soc"] <= 1) & (out["soc_variance"] > 0))
    model = curved_cell()
    voltage = np.interp(0.6, model.soc, model.ocv_V[0])
    out = STEPPER.rows(state, steady(3000, 0.0, voltage, start=int(samples["sequence"][-1]) + 1))
    assert out["soc"][-1] == pytest.approx(0.6, abs=0.02)


def test_an_unsound_state_starts_anew_and_says_so():
    state = begun()
    state["p12"] = np.nan
    out = STEPPER.rows(state, steady(1, 1.0, 3.7, start=1))
    assert out["status"][0] & Status.STATE_RESET


def test_cleared_memory_is_no_state():
    """All bits 0: once an empty cell, known exactly."""
    state = begun()
    state.view(np.uint8)[:] = 0
    out = STEPPER.rows(state, steady(1, 0.0, 3.7, start=1))
    assert out["status"][0] & Status.STATE_RESET
    assert out["soc_variance"][0] > 0.0


def test_the_covariance_stays_positive():
    state = begun()
    for part in np.array_split(stress_samples(20_000, seed=1), 500):
        STEPPER.rows(state, part)
        x = {name: float(state[name][0]) for name in state.dtype.names}
        rows = (("ss", "s1", "s2"), ("s1", "p11", "p12"), ("s2", "p12", "p22"))
        p = np.array([[x[name] for name in row] for row in rows])
        scale = np.sqrt(np.maximum(np.diag(p), 1e-30))
        assert np.linalg.eigvalsh(p / np.outer(scale, scale)).min() > -1e-5


@pytest.mark.parametrize("dt_s", [0.1, 1.0])
def test_as_good_as_the_float64_ekf(dt_s):
    model = curved_cell(201, capacity_Ah=5.1)
    drive = load_dataset("nmc_drive_b")
    noise = 0.003 * np.random.default_rng(0).normal(size=len(drive))
    drive = logged(model, drive, 0.95, noise)
    log = resample(drive, dt_s)
    reference, ours = Ekf(model), FixedStep(model, dt_s=dt_s)
    for start, std in ((0.95, 0.01), (0.7, 0.15), (0.2, 0.3), (0.5, 0.05)):
        error = ours.run(log, start, std).soc - reference.run(log, start, std).soc
        # Until its components, which follow one by one, have seen the first two blocks.
        error = error[int(3 * BLOCK_S / dt_s) if std > 0.02 else 0 :]
        # Components are weighed by an exponential that is right to 1e-4.
        assert np.sqrt(np.mean(error**2)) < (2e-4 if std < 0.02 else 5e-4), start


def test_compiled_code_is_single_precision_without_liberties():
    cached = compiled("rows", STEPPER.tables.options)
    options = {k: v for k, v in cached.targetoptions.items() if k != "nopython"}
    rows = njit(**options)(cached.py_func)  # numba keeps no text of what it has cached
    tables = STEPPER.tables
    samples = steady(2)
    rows(tables.constants, tables.table, begun()[0], samples, np.zeros(2, OUTPUT), np.uint32(2))
    text = "".join(rows.inspect_llvm().values())
    assert "define" in text
    assert "fpext" not in text
    assert not any(flag in text for flag in (" fast ", " contract ", " reassoc "))


def test_uneven_logs_keep_their_charge_and_their_gaps():
    rng = np.random.default_rng(2)
    time = np.cumsum(rng.uniform(0.5, 1.5, 400))
    time[200:] += 500.0
    log = CellLog(time - time[0], rng.normal(1.0, 2.0, 400), np.full(400, 3.8))
    found = samples_of(curved_cell(), log, 1.0)
    step = np.diff(found.records["sequence"].astype(np.int64))
    assert step.max() == pytest.approx(501, abs=3)
    assert np.sum(step != 1) == 1
    flowed = np.sum(log.current_A[1:200] * np.diff(log.time_s[:200]))
    cut = int(np.argmax(step))
    assert np.sum(found.records["current_A"][1 : cut + 1]) == pytest.approx(flowed, abs=8.0)


def test_step_is_run():
    filter_ = FixedStep(curved_cell(), dt_s=1.0, wide=False)
    state = filter_.init(0.8, 0.1)
    infos = [filter_.step(state, 1.0, 3.9, sequence=k) for k in range(50)]
    log = CellLog(np.arange(50.0), np.ones(50), np.full(50, 3.9))
    trace = filter_.run(log, 0.8, 0.1)
    assert [i.soc for i in infos] == trace.soc.tolist()


def test_what_the_past_says_drives_no_component_below_empty():
    """It would be no sound state, and the whole bank would begin again."""
    stepper = numba_stepper(tables_of("slow"))
    state = start_state(stepper, 1e-4, 0.05)
    state["p33"], state["s3"] = 1e-4, -4e-4  # a slow branch that holds more means a lower SOC
    place = Place(np.uint32(0), np.float32(0.0), np.float32(1.0), np.float32(0.0))
    stepper.call("know_past_better", place, state, 240.0, 2.0, 0.3)
    assert state["v3_V"][0] > 0.0
    assert state["soc"][0] == 0.0
