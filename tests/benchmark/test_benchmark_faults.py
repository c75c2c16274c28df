"""Faults are what they say, and never touch the truth."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.benchmark.faults import (
    FAULTS,
    LFP,
    NONE,
    STANDARD,
    Fault,
    applies,
    faulty_log,
    faulty_model,
)
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from example_cells import linear_cell

ROWS = 20_000


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.5, 1.5, ROWS))
    current = rng.normal(1.0, 2.0, ROWS)
    voltage = 3.6 + 0.1 * rng.standard_normal(ROWS)
    charge = np.cumsum(current) / 3600.0
    return CellLog(time, current, voltage, np.full(ROWS, 20.0), charge)


def seen(fault, log, capacity=3.0, seed=0):
    return faulty_log(fault, log, capacity, np.random.default_rng(seed))


@pytest.mark.parametrize("fault", FAULTS.values(), ids=lambda f: f.name)
def test_a_fault_changes_what_is_read_and_never_the_truth(fault, log):
    after = seen(fault, log)
    np.testing.assert_array_equal(after.charge_Ah, log.charge_Ah)
    np.testing.assert_array_equal(after.time_s, log.time_s)
    changed = not (
        np.array_equal(after.current_A, log.current_A)
        and np.array_equal(after.voltage_V, log.voltage_V)
        and np.array_equal(after.temperature_C, log.temperature_C)
    )
    assert changed == (fault.name != NONE and fault.capacity == 1.0)


def test_every_fault_of_the_list_is_there():
    wanted = {
        *(f"offset {s} % of 1C" for s in ("+0.5", "-0.5", "+3", "-3")),
        *(f"gain {s} %" for s in ("+1", "-1", "+3", "-3")),
        "voltage +5 mV", "voltage -5 mV", "noise", "voltage one sample late", "drop-outs",
        "temperature +3 K", "temperature -3 K", "capacity -10 %",
    }  # fmt: skip
    assert {f.name for f in STANDARD} == wanted
    assert {f.name for f in LFP} == {"voltage +30 mV", "voltage -30 mV"}


def test_offset_gain_and_noise_have_their_size(log):
    both = Fault("both", current_offset_C=0.03, current_gain=0.97, current_offset_A=-0.01)
    np.testing.assert_allclose(seen(both, log).current_A, 0.97 * log.current_A + 0.09 - 0.01)
    noisy = seen(FAULTS["noise"], log)
    assert np.std(noisy.current_A - log.current_A) == pytest.approx(0.03, rel=0.05)
    assert np.std(noisy.voltage_V - log.voltage_V) == pytest.approx(0.005, rel=0.05)


def test_a_late_voltage_is_that_of_the_row_before(log):
    late = seen(Fault("late", voltage_lag_samples=3), log)
    np.testing.assert_array_equal(late.voltage_V[3:], log.voltage_V[:-3])


def test_drop_outs_lose_their_share_in_stretches(log):
    lost = seen(Fault("lost", dropout_share=0.2, dropout_s=20.0), log)
    for channel in (lost.current_A, lost.voltage_V):
        gone = np.isnan(channel)
        assert gone.mean() == pytest.approx(0.2, abs=0.05)
        runs = np.count_nonzero(np.diff(gone.astype(int)) == 1)
        assert gone.sum() / runs > 10  # rows of one second, stretches of twenty
        assert not gone[0]


def test_a_fault_that_a_log_cannot_have_does_not_apply(log):
    bare = CellLog(log.time_s, log.current_A, log.voltage_V)
    assert applies(FAULTS["temperature +3 K"], "NMC", log)
    assert not applies(FAULTS["temperature +3 K"], "NMC", bare)
    assert not applies(LFP[0], "NMC", log)
    assert applies(LFP[0], "LFP", log)
    assert applies(STANDARD[0], "", bare)


def test_the_capacity_is_the_models():
    cell = linear_cell()
    assert faulty_model(FAULTS["capacity -10 %"], cell).capacity_Ah == pytest.approx(2.7)
    assert faulty_model(FAULTS["noise"], cell) is cell


@pytest.mark.parametrize(
    "change", [{"current_gain": np.nan}, {"dropout_share": 0.95}, {"capacity": 0.0}]
)
def test_an_impossible_fault_is_refused(change):
    with pytest.raises(InputError):
        Fault("bad", **change)
