"""Cubic B-splines over SOC as four values per sample, for compiled loops."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import cached
from cellwise.typing import FloatArray, IndexArray

DEGREE = 3
SOC_GRID = np.linspace(0.0, 1.0, 201)  # of curves and tables that are read off

# SOC knots: closer together at low SOC, where every cell's resistance turns up.
TABLE_KNOTS = np.concatenate((np.arange(0.0, 0.2, 0.05), np.linspace(0.2, 1.0, 9)))
# An OCV turns sharply near empty and full; a plateau of LFP has steps of some per cent.
OCV_KNOTS = np.concatenate(
    (np.linspace(0.0, 0.1, 9), np.linspace(0.125, 0.9, 32), np.linspace(0.9125, 1.0, 8))
)


class SplineRows(NamedTuple):
    """First active spline of each sample, the values of the four that are active, their slopes."""

    first: IndexArray
    values: FloatArray
    slopes: FloatArray


def spline_count(breakpoints: FloatArray) -> int:
    """Number of cubic B-splines over the given break points."""
    return breakpoints.size + DEGREE - 1


def _knots(breakpoints: FloatArray) -> FloatArray:
    ends = np.repeat(breakpoints[0], DEGREE), np.repeat(breakpoints[-1], DEGREE)
    return np.concatenate((ends[0], breakpoints, ends[1]))


def spline_rows(soc: FloatArray, breakpoints: FloatArray) -> SplineRows:
    """B-spline values and slopes at each SOC; outside the break points the end value holds.

    Parameters
    ----------
    soc : (n,) float
    breakpoints : (k,) float      ascending

    Returns
    -------
    SplineRows                    first (n,) int64, values and slopes per unit of SOC (n, 4)
    """
    rows = SplineRows(
        np.empty(soc.size, dtype=np.int64),
        np.empty((soc.size, DEGREE + 1)),
        np.empty((soc.size, DEGREE + 1)),
    )
    fill_rows(np.asarray(soc, dtype=np.float64), _knots(breakpoints), *rows)
    return rows


@cached(error_model="numpy")
def fill_rows(
    soc: FloatArray, knots: FloatArray, first: IndexArray, values: FloatArray, slopes: FloatArray
) -> None:
    """Values and slopes of the four active cubic B-splines, by the recursion of Cox and de Boor.

    C. de Boor, A Practical Guide to Splines (1978), chapter X.
    """
    last = knots.size - DEGREE - 2
    for k in range(soc.size):
        x = min(max(soc[k], knots[0]), knots[-1])
        low, high = DEGREE, last + 1
        while high - low > 1:
            middle = (low + high) // 2
            if knots[middle] <= x:
                low = middle
            else:
                high = middle
        n = values[k]
        n[0], n[1], n[2], n[3] = 1.0, 0.0, 0.0, 0.0
        for d in range(1, DEGREE + 1):
            if d == DEGREE:  # the slope is that of the splines of one degree less
                before = 0.0
                for j in range(DEGREE + 1):
                    now = 0.0
                    if j < DEGREE:
                        now = DEGREE * n[j] / (knots[low + j + 1] - knots[low + j + 1 - DEGREE])
                    slopes[k, j] = before - now
                    before = now
            saved = 0.0
            for j in range(d):
                right, left = knots[low + j + 1], knots[low + j + 1 - d]
                part = n[j] / (right - left)
                n[j] = saved + (right - x) * part
                saved = (x - left) * part
            n[d] = saved
        if x != soc[k]:
            slopes[k, :] = 0.0
        first[k] = low - DEGREE


def spline_values(rows: SplineRows, coefficients: FloatArray) -> FloatArray:
    """Value of the spline with the given coefficients at each sample, shape (n,).

    Coefficients of shape (splines, m) are those of m splines, their values of shape (n, m).
    """
    index = rows.first[:, None] + np.arange(DEGREE + 1)
    return np.asarray(np.einsum("ij,ij...->i...", rows.values, coefficients[index]))


def spline_matrix(soc: FloatArray, breakpoints: FloatArray) -> FloatArray:
    """Spline values as a matrix, shape (n, splines)."""
    rows = spline_rows(soc, breakpoints)
    found = np.zeros((soc.size, spline_count(breakpoints)))
    found[np.arange(soc.size)[:, None], rows.first[:, None] + np.arange(DEGREE + 1)] = rows.values
    return found


def greville(breakpoints: FloatArray) -> FloatArray:
    """SOC at which each B-spline's coefficient acts, shape (splines,)."""
    knots = _knots(breakpoints)
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
