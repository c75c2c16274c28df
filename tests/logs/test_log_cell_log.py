"""`CellLog`: what it accepts, what it means by a row's current, what it does with holes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellwise.errors import InputError
from cellwise.logs import CellLog, find_gaps, read_log
from cellwise.logs.gaps import cut_at_pauses
from cellwise.notices import Code, Notice

TOLD = Notice(Code.GAP, "told")


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
def test_channels_that_are_no_log_are_refused(changes, says):
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
    log = ramp(10, step=np.arange(10), notices=(TOLD,), name="x", format="tidy-csv")
    part = log.part(3, 7)
    np.testing.assert_array_equal(part.time_s, [3, 4, 5, 6])
    np.testing.assert_array_equal(part.step, [3, 4, 5, 6])
    assert (part.notices, part.name, part.format) == ((TOLD,), "x", "tidy-csv")
    np.testing.assert_array_equal(log.rows(log.time_s > 6).time_s, [7, 8, 9])


# Gaps are rows that were not written; slow logging and hiccups are none.
def stamps(*intervals: tuple[float, int]) -> np.ndarray:
    """Time stamps from (interval, count) pairs."""
    return np.concatenate([[0.0], np.cumsum([dt for dt, n in intervals for _ in range(n)])])


def found(*intervals: tuple[float, int]) -> list[int]:
    return np.flatnonzero(find_gaps(stamps(*intervals))).tolist()


# Intervals and how often each follows, and the rows that end a gap.
FAST, EVEN = (0.1, 50), (1.0, 50)
CASES = {
    **{f"pause of {dt} s rows": ([(dt, 50), (2e3, 1), (dt, 50)], [51]) for dt in (0.0074, 60.0)},
    "slow rows at rest": ([FAST, (60.0, 2), FAST], []),
    "one row each slower": ([(0.1, 20), *((3.0**k, 1) for k in range(6)), (0.1, 20)], []),
    "a last row that is cut short": ([EVEN, (60.0, 1), (23.0, 1)], []),
    "hiccup between repetitions": ([(0.1, 500), (0.04, 1), (2.3, 1), (0.1, 500)], []),
    "two gaps near each other": ([EVEN, (500.0, 1), (1.0, 2), (800.0, 1), EVEN], [51, 54]),
    "a row doubled at every edge": ([(60.0, 1), (0.01, 1)] * 30, []),
    "at the beginning": ([(1000.0, 1), EVEN], [1]),
    "at the end": ([EVEN, (1000.0, 1)], [51]),
}


@pytest.mark.parametrize("case", CASES)
def test_pauses_and_what_is_none(case):
    intervals, rows = CASES[case]
    assert found(*intervals) == rows


def test_jitter_does_not_hide_it():
    rng = np.random.default_rng(0)
    dt = rng.uniform(0.02, 0.2, 200)
    dt[120] = 30.0
    assert np.flatnonzero(find_gaps(np.concatenate([[0.0], np.cumsum(dt)]))).tolist() == [121]


def test_repeated_stamps_do_not_hide_a_gap():
    """A clock of whole seconds under 10 Hz rows."""
    time = np.floor(np.arange(0.0, 100.0, 0.1))
    time[500:] += 3600.0
    assert np.flatnonzero(find_gaps(time)).tolist() == [500]
    assert not find_gaps(np.floor(np.arange(0.0, 100.0, 0.1))).any()
    assert not find_gaps(np.floor(np.arange(0.0, 36000.0, 1.0) / 60.0) * 60.0).any()


def test_two_rows_and_equal_stamps():
    assert not find_gaps(np.array([0.0, 1e6])).any()
    assert not find_gaps(np.zeros(5)).any()


def test_a_hundred_thousand_pauses_are_found_quickly():
    time = stamps(*([(1.0, 9), (100.0, 1)] * 100_000))
    assert np.count_nonzero(find_gaps(time)) == 100_000


def test_measured_gaps_are_those_the_readme_names(real_data):
    """Restored interruptions, and the end of the C/20 file; no other log of any lab has one."""
    named = {
        "drive_p10_cycle_2": (639.0, 668304.0),
        "drive_p10_la92": (3748.0, 227433.0),
        "drive_p00_cycle_2": (7433.0, 129436.0),
        "ocv_c20_p25": (146855.0, 48969.0),
    }
    for name, (start, duration) in named.items():
        log = read_log(real_data / "panasonic_18650pf" / f"{name}.csv.gz")
        assert [(round(g.start_s), round(g.duration_s)) for g in log.gaps] == [(start, duration)]
        assert log.gaps[0].charge_Ah == pytest.approx(0.0, abs=1e-4)  # the counter stood still


@pytest.mark.parametrize("alone", [1, 2, 29])
def test_a_row_behind_a_pause_is_left_away(alone):
    """A car that was looked at for a moment: no stretch of its own, and no refusal."""
    time = stamps((5.0, 60), (4000.0, 1), (5.0, alone - 1))
    log = CellLog(time, np.ones(time.size), np.linspace(4.0, 3.8, time.size), name="day")
    assert [len(part) for part in cut_at_pauses(log)] == [61]
