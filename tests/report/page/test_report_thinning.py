"""Thinned traces: no peak is lost, the ends stay, missing values break the line."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwise.report.page.traces import thin, thin_band, thin_rows


def pixel_columns(x, columns):
    return np.minimum(((x - x[0]) * (columns / (x[-1] - x[0]))), columns - 1).astype(int)


@given(st.integers(0, 10_000), st.integers(1, 60), st.sampled_from([200, 1000, 5000]))
@settings(max_examples=40, deadline=None)
def test_every_pixel_column_keeps_its_extremes_and_ends(seed, columns, n):
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.exponential(1.0, n) * (rng.random(n) < 0.9))
    y = rng.standard_cauchy(n)
    y[rng.random(n) < 0.1] = np.nan
    rows = thin_rows(x, y, columns)
    assert rows[0] == 0
    assert rows[-1] == n - 1
    assert np.all(np.diff(rows) > 0)
    column = pixel_columns(x, columns)
    for c in np.unique(column):
        inside = y[column == c]
        kept = y[rows][column[rows] == c]
        assert np.isnan(kept).any() == np.isnan(inside).any() or n <= 4 * columns
        if np.isfinite(inside).any():
            assert np.nanmin(kept) == np.nanmin(inside)
            assert np.nanmax(kept) == np.nanmax(inside)


def test_a_million_rows_become_few():
    x = np.arange(1e6)
    y = np.random.default_rng(0).normal(size=x.size)
    y[123_456] = 50.0
    rows = thin_rows(x, y, 900)
    assert rows.size <= 4 * 900
    assert 123_456 in rows


def test_short_traces_are_left_alone():
    x = np.arange(100.0)
    np.testing.assert_array_equal(thin_rows(x, x, 30), np.arange(100))


def test_standing_time_is_left_alone():
    x = np.zeros(50)
    assert thin_rows(x, np.arange(50.0), 4).size == 50


@pytest.mark.parametrize("n", [50, 5000])
def test_a_gap_breaks_the_line(n):
    x = np.concatenate((np.arange(n / 2), np.arange(n / 2) + 10 * n))
    gaps = np.zeros(x.size, dtype=bool)
    gaps[n // 2] = True
    at, shown = thin(x, np.sin(x), 100, gaps)
    broken = np.flatnonzero(np.isnan(shown))
    assert broken.size == 1
    assert at[broken[0] - 1] < x[n // 2]
    assert at[broken[0] + 1] == x[n // 2]


def test_band_encloses_all_rows():
    rng = np.random.default_rng(3)
    x = np.arange(5000.0)
    low, high = -rng.random(5000), rng.random(5000)
    at, lowest, highest = thin_band(x, low, high, 50)
    assert at[0] == 0
    assert at[-1] == 4999
    column = pixel_columns(x, 50)
    for c in range(50):
        assert lowest[c] == low[column == c].min()
        assert highest[c] == high[column == c].max()
