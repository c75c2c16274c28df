"""Splines over SOC: theorems of B-splines, and what the curvature penalty leaves alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from cellwise.fit.splines import (
    OCV_KNOTS,
    TABLE_KNOTS,
    curvature_penalty,
    greville,
    spline_count,
    spline_rows,
    spline_values,
)

EVEN_KNOTS = np.linspace(0.0, 1.0, 11)
UNEVEN_KNOTS = np.array([0.0, 0.01, 0.3, 0.35, 1.0])
KNOTS = pytest.mark.parametrize(
    "knots", [TABLE_KNOTS, OCV_KNOTS, EVEN_KNOTS, UNEVEN_KNOTS], ids=["table", "ocv", "even", "odd"]
)


def soc_samples(knots):
    """Random SOC, the break points themselves, and what lies a hair beside them."""
    rng = np.random.default_rng(7)
    return np.concatenate(
        (rng.uniform(0.0, 1.0, 400), knots, knots[:-1] + 1e-12, knots[1:] - 1e-12)
    )


@KNOTS
def test_values_are_those_of_scipys_spline(knots):
    rng = np.random.default_rng(1)
    coefficients = rng.normal(size=spline_count(knots))
    full = np.concatenate((np.repeat(knots[0], 3), knots, np.repeat(knots[-1], 3)))
    soc = soc_samples(knots)
    expected = BSpline(full, coefficients, 3)(soc)
    np.testing.assert_allclose(
        spline_values(spline_rows(soc, knots), coefficients), expected, atol=1e-12
    )


@KNOTS
def test_slopes_are_the_derivatives_of_the_values(knots):
    coefficients = np.random.default_rng(3).normal(size=spline_count(knots))
    full = np.concatenate((np.repeat(knots[0], 3), knots, np.repeat(knots[-1], 3)))
    soc = soc_samples(knots)
    rows = spline_rows(soc, knots)
    slopes = spline_values(rows._replace(values=rows.slopes), coefficients)
    expected = BSpline(full, coefficients, 3).derivative()(soc)
    np.testing.assert_allclose(slopes, expected, atol=1e-9 * np.abs(expected).max())
    outside = spline_rows(np.array([-0.1, 1.1]), knots)
    assert np.all(outside.slopes == 0.0), "where the end value holds"


@KNOTS
def test_beyond_the_break_points_the_end_value_holds(knots):
    coefficients = np.random.default_rng(2).normal(size=spline_count(knots))
    outside = spline_values(
        spline_rows(np.array([-0.3, -1e-9, 1.0 + 1e-9, 1.7]), knots), coefficients
    )
    np.testing.assert_allclose(outside, coefficients[[0, 0, -1, -1]], atol=1e-12)


@KNOTS
def test_greville_coefficients_reproduce_a_straight_line(knots):
    # Linear precision: coefficients on a line at the Greville points give that line.
    soc = soc_samples(knots)
    line = spline_values(spline_rows(soc, knots), 0.3 - 2.0 * greville(knots))
    np.testing.assert_allclose(line, 0.3 - 2.0 * soc, atol=1e-12)


@KNOTS
def test_curvature_penalty_is_zero_for_straight_lines_only(knots):
    penalty = curvature_penalty(knots)
    at = greville(knots)
    for line in (np.ones(at.size), at, 3.0 - 0.7 * at):
        assert line @ penalty @ line == pytest.approx(0.0, abs=1e-18 + 1e-15 * np.trace(penalty))
    values = np.linalg.eigvalsh(penalty)
    assert values[0] > -1e-9 * values[-1]
    assert np.count_nonzero(values < 1e-9 * values[-1]) == 2, "only constant and slope are free"


def test_curvature_penalty_on_an_even_grid_is_the_plain_second_difference():
    # Away from the ends, where Greville points crowd, an even grid of a tenth gives 1, -2, 1.
    penalty = curvature_penalty(np.linspace(0.0, 1.0, 11))
    bump = np.zeros(13)
    bump[6] = 1.0
    assert bump @ penalty @ bump == pytest.approx(1.0 + 4.0 + 1.0, rel=1e-9)
