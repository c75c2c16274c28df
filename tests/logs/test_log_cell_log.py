"""`CellLog`: what it accepts, what it means by a row's current, what it does with holes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellwise.errors import InputError
from cellwise.logs import CellLog


def ramp(n: int = 10, **more) -> CellLog:
    time = np.arange(float(n))
    return CellLog(time, np.linspace(1.0, 2.0, n), np.linspace(4.0, 3.9, n), **more)


def test_the_callers_arrays_stay_writeable_and_the_logs_do_not():
    time, current, voltage = np.arange(3.0), np.ones(3), np.full(3, 3.7)
    step = np.array([1, 1, 2], dtype=np.int32)
    log = CellLog(time, current, voltage, step=step)
    time[0] = current[0] = voltage[0] = 0.5
    step[0] = 7
    for field in ("time_s", "current_A", "voltage_V", "step"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(log, field)[0] = 0


@pytest.mark.parametrize(
    ("changes", "says"),
    [*(({field: np.ones(4)}, field) for field in ("current_A", "temperature_C", "step")),
     ({"time_s": [], "current_A": [], "voltage_V": []}, "row"),
     ({"time_s": [0.0], "current_A": [1.0], "voltage_V": [3.7]}, "row"),
     ({"time_s": [0.0, 2.0, 1.0]}, "backwards"), ({"time_s": [0.0, np.nan, 1.0]}, "finite time"),
     ({"current_meaning": "end"}, "current_meaning 'end'"),
     *(({"soc0": soc0}, "soc0") for soc0 in (-0.1, 1.1, np.nan))],
)  # fmt: skip
def test_what_is_no_log(changes, says):
    channels = {"time_s": np.arange(3.0), "current_A": np.ones(3), "voltage_V": np.ones(3)}
    with pytest.raises(InputError, match=says):
        CellLog(**channels | changes)


def test_interval_start_shifts_the_current_by_one_interval():
    log = ramp(current_meaning="interval_start")
    np.testing.assert_array_equal(log.interval_current_A[1:], log.current_A[:-1])
    assert log.counted_charge_Ah()[-1] == pytest.approx(log.current_A[:-1].sum() / 3600.0)


def test_interval_end_counts_each_row_over_the_interval_before_it():
    time = np.array([0.0, 1.0, 5.0, 6.0])
    log = CellLog(time, np.array([9.0, 1.0, 2.0, 3.0]), np.full(4, 3.7))
    assert log.counted_charge_Ah()[-1] == pytest.approx((1 + 8 + 3) / 3600.0)


def test_a_gap_is_a_rest_without_a_counter_and_the_counters_with_one():
    time = np.concatenate([np.arange(0.0, 10.0), np.arange(1000.0, 1010.0)])
    current = np.full(20, 2.0)
    log = CellLog(time, current, np.full(20, 3.7))
    assert log.known_current_A()[10] == 0.0
    assert log.gaps[0].charge_Ah is None
    charge = np.cumsum(np.where(np.arange(20) == 10, 100.0, 2.0)) / 3600.0
    log = CellLog(time, current, np.full(20, 3.7), charge_Ah=charge)
    assert log.known_current_A()[10] == pytest.approx(100.0 / 991.0)
    assert log.gaps[0].charge_Ah == pytest.approx(100.0 / 3600.0)
    assert log.gaps[0].start_s == 9.0
    assert log.gaps[0].duration_s == 991.0


def test_short_holes_take_the_last_value_whatever_the_counters_steps():
    """A counter of 0.01 Ah steps says 36 A over a second."""
    current = np.full(20, 2.0)
    current[5] = np.nan
    charge = np.zeros(20)
    charge[5:] = 0.01
    log = CellLog(np.arange(20.0), current, np.full(20, 3.7), charge_Ah=charge)
    np.testing.assert_array_equal(log.known_current_A(), np.full(20, 2.0))


def test_long_holes_take_the_counters_mean():
    time = np.arange(600.0)
    true = np.where(time < 300, 2.0, 1.0)
    charge = np.cumsum(true) / 3600.0
    current = true.copy()
    current[100:500] = np.nan
    log = CellLog(time, current, np.full(600, 3.7), charge_Ah=charge)
    np.testing.assert_allclose(log.known_current_A()[100:500], np.mean(true[100:500]))
    summed = np.cumsum(log.known_current_A() * log.interval_s) / 3600.0
    assert summed[-1] == pytest.approx(charge[-1] - charge[0])


def test_missing_current_at_the_beginning_is_none():
    current = np.array([np.nan, np.nan, 1.0, np.nan])
    log = CellLog(np.arange(4.0), current, np.full(4, 3.7))
    np.testing.assert_array_equal(log.known_current_A(), [0, 0, 1, 1])


def test_holes_in_the_counter_are_carried_by_the_current():
    time = np.arange(100.0)
    current = np.where(time < 50, 1.0, 3.0)
    charge = 5.0 + np.cumsum(current) / 3600.0
    whole = CellLog(time, current, np.full(100, 3.7), charge_Ah=charge)
    holed = charge.copy()
    holed[20:80] = np.nan
    log = CellLog(time, current, np.full(100, 3.7), charge_Ah=holed)
    np.testing.assert_allclose(log.counted_charge_Ah(), whole.counted_charge_Ah(), atol=1e-12)
    assert log.counted_charge_Ah()[0] == 0.0


@given(
    st.lists(st.floats(-5, 5), min_size=3, max_size=40),
    st.lists(st.booleans(), min_size=40, max_size=40),
)
def test_known_current_is_finite_and_true_where_known(values, holes):
    current = np.array(values)
    missing = np.array(holes[: current.size])
    missing[0] = False
    log = CellLog(
        np.arange(float(current.size)), np.where(missing, np.nan, current), np.full(current.size, 3)
    )
    known = log.known_current_A()
    assert np.isfinite(known).all()
    np.testing.assert_array_equal(known[~missing], current[~missing])


def test_parts_keep_channels_time_and_notices():
    log = ramp(10, step=np.arange(10), notices=("told",), name="x", format="tidy-csv")
    part = log.part(3, 7)
    np.testing.assert_array_equal(part.time_s, [3, 4, 5, 6])
    np.testing.assert_array_equal(part.step, [3, 4, 5, 6])
    assert (part.notices, part.name, part.format) == (("told",), "x", "tidy-csv")
    np.testing.assert_array_equal(log.rows(log.time_s > 6).time_s, [7, 8, 9])
