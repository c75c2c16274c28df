"""Gaps are rows that were not written; slow logging and hiccups are not."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.logs import CellLog, find_gaps, read_log
from cellwise.logs.gaps import cut_at_pauses


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
