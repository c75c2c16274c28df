"""Cubic B-splines over SOC as four values per sample, for compiled loops."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline

from cellwise.typing import FloatArray, IndexArray

DEGREE = 3

# SOC knots: closer together at low SOC, where every cell's resistance turns up.
TABLE_KNOTS = np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
OCV_KNOTS = np.array(
    [0.0, 0.025, 0.05, 0.075, 0.1, *np.arange(0.15, 0.96, 0.05).round(2).tolist(), 1.0]
)


class SplineRows(NamedTuple):
    """First active spline of each sample and the values of the four that are active."""

    first: IndexArray
    values: FloatArray


def spline_count(breakpoints: FloatArray) -> int:
    """Number of cubic B-splines over the given break points."""
    return breakpoints.size + DEGREE - 1


def spline_rows(soc: FloatArray, breakpoints: FloatArray) -> SplineRows:
    """B-spline values at each SOC; outside the break points the end value holds.

    Parameters
    ----------
    soc : (n,) float
    breakpoints : (k,) float      ascending

    Returns
    -------
    SplineRows                    first (n,) int64, values (n, 4)
    """
    knots = np.concatenate(
        (np.repeat(breakpoints[0], DEGREE), breakpoints, np.repeat(breakpoints[-1], DEGREE))
    )
    inside = np.clip(soc, breakpoints[0], breakpoints[-1])
    matrix = BSpline.design_matrix(inside, knots, DEGREE).tocsr()
    values = np.ascontiguousarray(matrix.data.reshape(-1, DEGREE + 1))
    first = matrix.indices.reshape(-1, DEGREE + 1)[:, 0].astype(np.int64)
    return SplineRows(first, values)


def spline_values(rows: SplineRows, coefficients: FloatArray) -> FloatArray:
    """Value of the spline with the given coefficients at each sample, shape (n,).

    Coefficients of shape (splines, m) are those of m splines, their values of shape (n, m).
    """
    index = rows.first[:, None] + np.arange(DEGREE + 1)
    return np.asarray(np.einsum("ij,ij...->i...", rows.values, coefficients[index]))


def greville(breakpoints: FloatArray) -> FloatArray:
    """SOC at which each B-spline's coefficient acts, shape (splines,)."""
    knots = np.concatenate(
        (np.repeat(breakpoints[0], DEGREE), breakpoints, np.repeat(breakpoints[-1], DEGREE))
    )
    count = spline_count(breakpoints)
    return np.array([knots[i + 1 : i + 1 + DEGREE].mean() for i in range(count)])


def curvature_penalty(breakpoints: FloatArray) -> FloatArray:
    """Matrix of the squared second divided differences of the coefficients, per unit SOC step.

    Uneven knots: the second difference is taken along the Greville points, scaled so that an even
    grid of a tenth gives the plain second difference.
    """
    x = greville(breakpoints)
    mean = 0.5 * (x[2:] - x[:-2])
    d = (0.1**2 / mean * np.sqrt(mean / 0.1))[:, None] * second_differences(x)
    return np.asarray(d.T @ d)


def second_differences(x: FloatArray) -> FloatArray:
    """Divided differences of slopes between neighbouring values at ``x``, shape (n - 2, n)."""
    if x.size < 3:
        return np.zeros((0, x.size))
    slopes = np.diff(np.eye(x.size), axis=0) / np.diff(x)[:, None]
    return np.diff(slopes, axis=0)
