"""Intervals and shares against what they are by definition."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.studies.capacity_study import axis_share, difference


def test_difference_of_rmse_is_exact():
    a = [np.array([3.0, -3.0, 3.0]), np.array([1.0])]
    b = [np.array([1.0, 1.0, -1.0]), np.array([1.0])]
    assert difference(a, b).value == pytest.approx(np.sqrt(28 / 4) - 1.0)


def test_an_error_is_not_told_from_itself_and_twice_of_it_is():
    e = [np.random.default_rng(1).normal(size=4000)]
    same = difference(e, e)
    assert (same.value, same.low, same.high) == (0.0, 0.0, 0.0)
    twice = difference([2 * e[0]], e)
    assert twice.low > 0.5 * twice.value > 0.0


def test_the_interval_covers_as_often_as_it_says():
    rng = np.random.default_rng(2)
    inside = 0
    for _ in range(100):
        common = rng.normal(size=(2, 3000))
        a = common + rng.normal(scale=0.5, size=(2, 3000))
        d = difference(list(a), list(common), rng)
        inside += d.low <= np.sqrt(1.25) - 1.0 <= d.high
    assert inside >= 85


def test_long_waves_leave_a_wide_interval():
    rng = np.random.default_rng(3)
    slow = np.repeat(rng.normal(size=20), 200)
    quick = rng.normal(size=4000)
    other = np.zeros(4000)
    wide, narrow = difference([slow], [other]), difference([quick], [other])
    assert wide.high - wide.low > 3 * (narrow.high - narrow.low)


def test_missing_rows_do_not_count():
    a = [np.array([3.0, np.nan, 3.0, np.nan])]
    assert axis_share(a, [np.array([3.0, 0.0, 3.0, 0.0])]) == pytest.approx(1.0)


@pytest.mark.parametrize(("part", "share"), [(1.0, 1.0), (0.0, 0.0), (0.5, 0.75), (-1.0, -3.0)])
def test_axis_share_is_the_part_of_the_square_that_goes(part, share):
    e = np.random.default_rng(4).normal(size=50)
    assert axis_share([e], [part * e]) == pytest.approx(share)
