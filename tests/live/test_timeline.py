"""Stamps of a stream: intervals, gaps as in a log, late samples, clocks that are set."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.live.live_filter import AGREEING, Interval, Timeline
from cellwise.logs.gaps import find_gaps


def fed(times, arrived=None):
    line = Timeline()
    arrived = times if arrived is None else arrived
    return [line.advance(float(t), float(a)) for t, a in zip(times, arrived, strict=True)]


def test_intervals_are_the_differences_of_the_stamps():
    times = np.cumsum(np.random.default_rng(1).uniform(0.01, 2.0, 200))
    found = fed(times)
    assert found[0] == Interval(0.0, gap=False)
    np.testing.assert_allclose([i.dt_s for i in found[1:]], np.diff(times))


@pytest.mark.parametrize("seed", range(5))
def test_gaps_are_those_of_the_finished_log(seed):
    rng = np.random.default_rng(seed)
    steps = rng.choice([0.1, 1.0]) * rng.uniform(0.8, 1.2, 400)
    pauses = 8 + 40 * np.arange(9) + rng.integers(0, 20, 9)
    steps[pauses] = rng.uniform(20.0, 3000.0, 9)
    times = np.concatenate(([0.0], np.cumsum(steps)))
    found = np.array([i.gap for i in fed(times)])
    np.testing.assert_array_equal(found, find_gaps(times))
    assert found.sum() == 9


def test_a_late_sample_is_left_out_and_the_next_one_counts_from_the_last_good():
    found = fed([0.0, 1.0, 2.0, 1.5, 3.0])
    assert found[3] is None
    assert found[4] == Interval(1.0, gap=False)


@pytest.mark.parametrize("broken", [1e15, -1e15, np.nan, np.inf])
def test_a_broken_stamp_is_left_out(broken):
    found = fed([0.0, 1.0, broken, 2.0, 3.0])
    assert found[2] is None
    assert found[3:] == [Interval(1.0, gap=False)] * 2


@pytest.mark.parametrize("jump", [-5000.0, 1e6])
def test_a_clock_that_was_set_is_a_gap_as_long_as_our_own_clock_says(jump):
    times = np.arange(0.0, 40.0)
    arrived = 100.0 + times
    times[20:] += jump
    found = fed(times, arrived)
    assert found[20 : 20 + AGREEING - 1] == [None] * (AGREEING - 1)
    assert found[20 + AGREEING - 1] == Interval(float(AGREEING), gap=True)
    assert all(i == Interval(1.0, gap=False) for i in found[20 + AGREEING :])


def test_after_a_restart_the_first_sample_ends_the_gap():
    line = Timeline()
    line.resume(500.0)
    assert line.advance(3.0) == Interval(500.0, gap=True)
    assert line.advance(4.0) == Interval(1.0, gap=False)
