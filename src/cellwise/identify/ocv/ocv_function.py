"""The open-circuit voltage as a function of SOC: the strictly rising spline through its points.

It rises strictly with SOC, because a filter divides by nothing but relies on the sign of the slope,
and goes on as a straight line beyond its points, because a filter's first guesses may lie there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.optimize import isotonic_regression, nnls

from cellwise.errors import InputError
from cellwise.typing import FloatArray


class _Points(NamedTuple):
    """What a curve is fitted to."""

    slope_V: float = 1e-3  # per unit of SOC: flatter carries no information, it keeps the sign
    fewest: int = 4
    most: int = 400  # a low-rate log has thousands of rows that say the same: so many are kept
    same_soc: float = 1e-4


class _Smoothing(NamedTuple):
    """Of the spline: cells between knots, and the penalty on its second differences.

    Over the normal equations: the best penalty of 32 measured curves, sampled as rests or densely,
    with noise from 0 to 8 mV, was seldom far from it.
    """

    fewest_cells: int = 6
    most_cells: int = 60
    penalty: float = 1e-2


POINTS, SMOOTHING = _Points(), _Smoothing()
Points = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class MonotoneSpline:
    """OCV as a cubic B-spline whose coefficients increase, so that it does.

    The derivative of a B-spline is a positive combination of the differences of its
    coefficients (de Boor, A Practical Guide to Splines, chapter X): increasing coefficients are
    enough for a strictly rising curve.

    Parameters
    ----------
    knots : (m + 4,) float           never decreasing, the ends four times [SOC]
    coefficients : (m,) float        increasing [V]
    """

    knots: FloatArray
    coefficients: FloatArray

    def evaluate(self, soc: FloatArray | float) -> FloatArray:
        """Open-circuit voltage [V], the shape of ``soc``."""
        s = np.asarray(soc, dtype=np.float64)
        inside = np.clip(s, self.knots[0], self.knots[-1])
        voltage = BSpline(self.knots, self.coefficients, 3)(inside)
        return np.asarray(voltage + (s - inside) * self.slope(inside))

    def slope(self, soc: FloatArray | float) -> FloatArray:
        """dOCV/dsoc [V per unit of SOC], the shape of ``soc``."""
        inside = np.clip(soc, self.knots[0], self.knots[-1])
        return np.asarray(BSpline(self.knots, self.coefficients, 3).derivative()(inside))


def fit_monotone_spline(
    soc: FloatArray, voltage_V: FloatArray, weight: FloatArray | None = None
) -> MonotoneSpline:
    """Strictly rising smoothing spline, knots where the curve is long.

    Knots lie at equal steps of the curve's length in the (SOC, voltage) picture: the steep ends
    get as many as they need, the plateau of LFP keeps its own. Second differences of the
    coefficients are penalised (Eilers and Marx 1996, doi:10.1214/ss/1038425655); coefficients are a
    floor that rises by the least slope, plus a running sum of increments, and non-negative least
    squares keeps these positive.

    Raises
    ------
    InputError        as `checked_points`
    """
    s, v, w = _condensed(*checked_points(soc, voltage_V, weight))
    cells = int(np.clip(s.size, SMOOTHING.fewest_cells, SMOOTHING.most_cells))
    inner = np.interp(np.arange(1, cells) / cells, _length(s, v, w), s)
    knots = np.concatenate((np.full(4, s[0]), inner, np.full(4, s[-1])))
    basis = BSpline.design_matrix(s, knots, 3).toarray()
    m = basis.shape[1]
    spacing = (knots[4 : m + 3] - knots[1:m]) / 3.0
    floor = np.append(0.0, POINTS.slope_V * np.cumsum(spacing))
    root = np.sqrt(w / np.mean(w))
    bend = np.sqrt(SMOOTHING.penalty) * np.diff(np.eye(m), 2, axis=0)
    sums = np.tril(np.ones((m, m)))
    q, r = np.linalg.qr(np.vstack((root[:, None] * basis, bend)) @ sums)
    target = np.concatenate((root * (v - basis @ floor), -bend @ floor))
    increments, _ = nnls(r, q.T @ target, maxiter=30 * m)
    return MonotoneSpline(knots, np.cumsum(increments) + floor)


def checked_points(soc: FloatArray, voltage_V: FloatArray, weight: FloatArray | None) -> Points:
    """Points without missing values, by rising SOC, weights of mean 1.

    Raises
    ------
    InputError        too few points, SOC far outside 0..1, all at one SOC, voltage that does not
                      rise with SOC
    """
    w = np.ones(soc.size) if weight is None else weight
    good = np.flatnonzero(np.isfinite(soc) & np.isfinite(voltage_V) & (w > 0.0))
    order = good[np.argsort(soc[good], kind="stable")]
    s, v, w = soc[order], voltage_V[order], w[order]
    if s.size < POINTS.fewest:
        raise InputError(
            f"{s.size} usable point(s) of OCV over SOC",
            f"at least {POINTS.fewest}",
            "Use a log with rests at more levels of SOC, or a low-rate discharge.",
        )
    if s[0] < -0.25 or s[-1] > 1.25:
        raise InputError(
            f"SOC from {s[0]:.3f} to {s[-1]:.3f} in the points of an OCV curve",
            "SOC within 0..1",
            "Check the capacity that SOC was counted with, and percent against fraction.",
        )
    if s[-1] - s[0] < 0.05 or np.polyfit(s, v, 1)[0] <= 0.0:
        raise InputError(
            f"OCV points from SOC {s[0]:.3f} to {s[-1]:.3f} whose voltage does not rise with SOC",
            "points spread over SOC, with the voltage rising",
            "Check the sign of the current: SOC must fall on discharge.",
        )
    return s, v, w / np.mean(w)


def _condensed(s: FloatArray, v: FloatArray, w: FloatArray) -> Points:
    """Means of points that say the same: of equal SOC, then near each other along the curve."""
    s, v, w = _means(np.floor(s / POINTS.same_soc), s, v, w)
    if s.size <= POINTS.most:
        return s, v, w
    return _means(np.floor((POINTS.most - 1) * _length(s, v, w)), s, v, w)


def _means(cell: FloatArray, s: FloatArray, v: FloatArray, w: FloatArray) -> Points:
    group: NDArray[np.intp] = np.unique(cell, return_inverse=True)[1]
    total = np.bincount(group, w).astype(np.float64)
    return np.bincount(group, w * s) / total, np.bincount(group, w * v) / total, total


def _length(s: FloatArray, v: FloatArray, w: FloatArray) -> FloatArray:
    """Length of the rising curve in the (SOC, voltage) picture up to each point, 0 to 1."""
    level = POINTS.slope_V * s
    rising = isotonic_regression(v - level, weights=w).x + level
    steps = np.hypot(np.diff(s), np.diff(rising) / (rising[-1] - rising[0]))
    length = np.append(0.0, np.cumsum(steps))
    return np.asarray(length / length[-1])
