"""A log on an even step: charge is kept, pauses stay pauses, nothing is made up."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog, resample


def uneven_log(seed=0, rows=500, **changes) -> CellLog:
    rng = np.random.default_rng(seed)
    time = 100.0 + np.concatenate(([0.0], np.cumsum(rng.uniform(0.05, 0.6, rows - 1))))
    current = rng.normal(0.5, 2.0, rows)
    counter = np.cumsum(current * np.diff(time, prepend=time[0])) / 3600.0
    values = {
        "temperature_C": 25.0 + 0.01 * np.arange(rows),
        "charge_Ah": counter,
        "step": np.arange(rows) // 50,
        "name": "uneven",
    }
    return CellLog(time, current, 3.6 + 0.001 * np.arange(rows), **{**values, **changes})


def charge_As(log):
    return np.cumsum(log.known_current_A() * log.interval_s)


@settings(max_examples=40, deadline=None)
@given(dt=st.floats(0.02, 30.0), seed=st.integers(0, 10_000))
def test_the_charge_of_every_interval_is_kept(dt, seed):
    log = uneven_log(seed)
    even = resample(log, dt)
    expected = np.interp(even.time_s, log.time_s, charge_As(log))
    # Rows of a step that holds no sample may be gaps; the current itself always carries the charge.
    found = np.cumsum(even.current_A[1:] * np.diff(even.time_s))
    np.testing.assert_allclose(found, expected[1:], atol=1e-7)


@settings(max_examples=40, deadline=None)
@given(dt=st.floats(0.02, 30.0))
def test_the_step_is_even_and_covers_the_log(dt):
    log = uneven_log()
    even = resample(log, dt)
    np.testing.assert_allclose(np.diff(even.time_s), dt, rtol=1e-9)
    assert even.time_s[0] == log.time_s[0]
    assert log.time_s[-1] - dt < even.time_s[-1] + 1e-6
    assert even.time_s[-1] <= log.time_s[-1] + 1e-6


def test_an_even_log_on_its_own_step_is_itself():
    rng = np.random.default_rng(1)
    log = CellLog(np.arange(300.0), rng.normal(size=300), rng.normal(3.6, 0.1, 300),
                  rng.normal(25.0, 1.0, 300), np.linspace(0.0, 1.0, 300))  # fmt: skip
    even = resample(log, 1.0)
    for field in ("time_s", "current_A", "voltage_V", "temperature_C", "charge_Ah"):
        np.testing.assert_allclose(getattr(even, field), getattr(log, field), atol=1e-10)


def test_voltage_is_the_last_that_was_measured_never_a_later_one():
    log = uneven_log()
    even = resample(log, 1.0)
    for t, v in zip(even.time_s, even.voltage_V, strict=True):
        seen = log.voltage_V[log.time_s <= t + 1e-6]
        assert v == seen[-1]


def test_a_pause_stays_a_pause():
    # Ten minutes without a row: no voltage is made up, and the current is a rest.
    log = uneven_log()
    time = log.time_s.copy()
    time[250:] += 600.0
    paused = CellLog(time, log.current_A, log.voltage_V)
    even = resample(paused, 1.0)
    inside = (even.time_s > time[249] + 1.0) & (even.time_s < time[250])
    assert np.count_nonzero(inside) > 590
    assert np.all(np.isnan(even.voltage_V[inside]))
    assert np.all(even.current_A[inside] == 0.0)
    outside = ~((even.time_s > time[249]) & (even.time_s < time[250] + 1.0))
    assert np.all(np.isfinite(even.voltage_V[outside]))


def test_a_row_that_begins_its_interval_is_turned_round():
    # interval_start: the current of row k flows from row k on; the result says interval_end.
    log = CellLog(np.arange(4.0), np.array([1.0, 2.0, 3.0, 4.0]), np.full(4, 3.6),
                  current_meaning="interval_start")  # fmt: skip
    even = resample(log, 1.0)
    assert even.current_meaning == "interval_end"
    assert even.current_A[1:].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("dt", [0.0, -1.0, float("nan"), float("inf"), 1e9, 1e-9])
def test_a_step_that_is_not_above_zero_is_refused(dt):
    with pytest.raises(InputError, match="step"):
        resample(uneven_log(), dt)
