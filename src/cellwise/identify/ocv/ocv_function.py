"""The open-circuit voltage as a function of SOC: the strictly rising spline through its points.

It rises strictly with SOC, because a filter divides by nothing but relies on the sign of the slope,
and goes on as a straight line outside 0..1, because a filter's first guesses may lie there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from cellwise.identify.ocv.ocv_points import (
    POINTS,
    beyond_ends,
    checked_points,
    condense,
    strictly_rising,
)
from cellwise.typing import FloatArray


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
        s, outside = inside_of(soc, self.knots[0], self.knots[-1])
        spline = BSpline(self.knots, self.coefficients, 3)
        return np.asarray(spline(s) + outside * spline.derivative()(s))

    def slope(self, soc: FloatArray | float) -> FloatArray:
        """dOCV/dsoc [V per unit of SOC], the shape of ``soc``."""
        s, _ = inside_of(soc, self.knots[0], self.knots[-1])
        return np.asarray(BSpline(self.knots, self.coefficients, 3).derivative()(s))


def inside_of(soc: FloatArray | float, first: float, last: float) -> tuple[FloatArray, FloatArray]:
    """SOC moved into [first, last], and how far outside it was."""
    s = np.asarray(soc, dtype=np.float64)
    inside = np.clip(s, first, last)
    return inside, s - inside


class _Smoothing(NamedTuple):
    """Of the spline: cells between knots, and the penalty on its second differences.

    Over the normal equations: the best penalty of 32 measured curves, sampled as rests or densely,
    with noise from 0 to 8 mV, was seldom far from it.
    """

    fewest_cells: int = 6
    most_cells: int = 60
    penalty: float = 1e-2
    ridge: float = 1e-12  # keeps the factor of a singular system


SMOOTHING = _Smoothing()


class _System(NamedTuple):
    """Normal equations of a spline in its increments; ``bend`` is the penalty's part of them."""

    knots: FloatArray
    fit: FloatArray
    bend: FloatArray
    right: FloatArray
    bend_right: FloatArray
    floor: FloatArray


def fit_monotone_spline(
    soc: FloatArray, voltage_V: FloatArray, weight: FloatArray | None = None
) -> MonotoneSpline:
    """Strictly rising smoothing spline over 0..1, knots where the curve is long.

    Knots lie at equal steps of the curve's length in the (SOC, voltage) picture: the steep ends
    get as many as they need, the plateau of LFP keeps its own. Second differences of the
    coefficients are penalised (Eilers and Marx 1996, doi:10.1214/ss/1038425655), non-negative
    least squares keeps the increments positive.
    """
    s, v, w = condense(*checked_points(soc, voltage_V, weight))
    inner = _solve(_system(s, v, w))
    s_end, v_end = beyond_ends(inner.evaluate, float(s[0]), float(s[-1]))
    if s_end.size == 0:
        return inner
    order = np.argsort(np.append(s, s_end))
    weight = np.append(w, np.full(s_end.size, np.mean(w)))
    return _solve(_system(np.append(s, s_end)[order], np.append(v, v_end)[order], weight[order]))


def _system(s: FloatArray, v: FloatArray, w: FloatArray) -> _System:
    """Set up the fit over the points' range: knots at equal steps of the curve's length.

    Coefficients are a floor that rises by the least slope, plus a running sum of increments; the
    increments, and the first coefficient, are the unknowns, all >= 0.
    """
    rising = strictly_rising(s, v, w)
    length = np.cumsum(np.hypot(np.diff(s), np.diff(rising) / (rising[-1] - rising[0])))
    cells = int(np.clip(s.size, SMOOTHING.fewest_cells, SMOOTHING.most_cells))
    inner = np.interp(np.arange(1, cells) / cells * length[-1], np.append(0.0, length), s)
    knots = np.concatenate((np.full(4, s[0]), inner, np.full(4, s[-1])))
    basis = BSpline.design_matrix(s, knots, 3)
    m = basis.shape[1]
    spacing = (knots[4 : m + 3] - knots[1:m]) / 3.0
    floor = np.append(0.0, POINTS.slope_V * np.cumsum(spacing))
    weighted = basis.T.multiply(w / np.mean(w)).tocsr()
    gram = (weighted @ basis).toarray()
    second = np.diff(np.eye(m), 2, axis=0)
    bend = second.T @ second
    return _System(
        knots=knots,
        fit=_in_increments(gram),
        bend=_in_increments(bend),
        right=_summed(weighted @ v - gram @ floor),
        bend_right=_summed(-bend @ floor),
        floor=floor,
    )


def _solve(system: _System) -> MonotoneSpline:
    """Least squares plus penalty, increments >= 0, through the Cholesky factor of the system."""
    normal = system.fit + SMOOTHING.penalty * system.bend
    size = normal.shape[0]
    factor = np.linalg.cholesky(normal + SMOOTHING.ridge * np.trace(normal) * np.eye(size))
    right = system.right + SMOOTHING.penalty * system.bend_right
    target = solve_triangular(factor, right, lower=True)
    increments, _ = nnls(factor.T, target, maxiter=30 * size)
    return MonotoneSpline(system.knots, np.cumsum(increments) + system.floor)


def _in_increments(matrix: FloatArray) -> FloatArray:
    """Quadratic form in coefficients, as one in their increments: sums from the far end."""
    return np.asarray(_summed(_summed(matrix).T).T)


def _summed(a: FloatArray) -> FloatArray:
    return np.asarray(np.cumsum(a[::-1], axis=0)[::-1])
