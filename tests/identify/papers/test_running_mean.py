"""Equation (7) of the LFP paper: a mean over 2N+1 samples, and what it may not do at an edge."""

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.identify.papers.signals import running_mean


@pytest.mark.parametrize("n", [1, 5, 20])
def test_is_the_sum_of_the_paper_away_from_the_ends(n):
    x = np.random.default_rng(0).normal(3.7, 0.1, 500)
    expected = [sum(x[i + j] for j in range(-n, n + 1)) / (2 * n + 1) for i in range(n, 500 - n)]
    np.testing.assert_allclose(running_mean(x, n)[n:-n], expected, rtol=0, atol=1e-13)


def test_a_straight_line_passes_unchanged_to_its_ends():
    line = 4.1 - 3e-4 * np.arange(200)
    np.testing.assert_allclose(running_mean(line, 7), line, atol=1e-13)


def test_a_line_passes_unchanged_on_either_side_of_an_edge():
    x = np.concatenate((4.1 - 1e-4 * np.arange(60), 3.9 - 2e-4 * np.arange(80)))
    np.testing.assert_allclose(running_mean(x, 5, edges=[60]), x, atol=1e-13)


def test_without_its_edges_a_step_is_smeared_over_2n_rows():
    x = np.concatenate((np.full(50, 4.0), np.full(50, 3.0)))
    changed = np.flatnonzero(np.abs(running_mean(x, 5) - x) > 1e-9)
    assert changed.tolist() == list(range(45, 55))


def test_white_noise_loses_the_variance_it_should():
    noise = np.random.default_rng(1).normal(size=200_000)
    assert np.var(running_mean(noise, 5)) == pytest.approx(1.0 / 11.0, rel=0.03)


def test_keeps_its_digits_far_into_a_long_log():
    x = np.tile([3.3, 3.3 + 1e-6], 700_000)
    middle = running_mean(x, 5)[-1000:-10]
    assert np.max(np.abs(middle - (3.3 + 0.5e-6))) < 1e-7


def test_a_missing_sample_is_missing_where_it_is_in_reach():
    x = np.ones(30)
    x[15] = np.nan
    assert np.flatnonzero(np.isnan(running_mean(x, 2))).tolist() == [13, 14, 15, 16, 17]


def test_half_width_zero_and_empty_input():
    x = np.array([1.0, 5.0, 2.0])
    np.testing.assert_array_equal(running_mean(x, 0), x)
    assert running_mean(np.zeros(0)).size == 0


@pytest.mark.parametrize(("n", "edges"), [(-1, []), (5, [31]), (5, [-2])])
def test_refuses_what_makes_no_sense(n, edges):
    with pytest.raises(InputError):
        running_mean(np.ones(30), n, edges=edges)
