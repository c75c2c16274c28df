"""The open-circuit voltage over SOC: a strictly rising spline.

It rises strictly with SOC, because a filter divides by nothing but relies on the sign of the slope,
and goes on as a straight line beyond its points, because a filter's first guesses may lie there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.optimize import isotonic_regression, minimize_scalar, nnls

from cellwise.cell.plausibility.notice import RANGE_V
from cellwise.errors import InputError
from cellwise.fit.splines import SOC_GRID
from cellwise.notices import Code, Notice
from cellwise.typing import FloatArray


class _Points(NamedTuple):
    """What a curve is fitted to."""

    slope_V: float = 1e-3  # per unit of SOC: flatter carries no information, it keeps the sign
    fewest: int = 4
    most: int = 400  # a low-rate log has thousands of rows that say the same: so many are kept
    same_soc: float = 1e-4


class _CurveSmoothing(NamedTuple):
    """Of the spline: cells between knots, and the penalty on its second differences.

    Over the normal equations: the best penalty of 32 measured curves, sampled as rests or densely,
    with noise from 0 to 8 mV, was seldom far from it.
    """

    fewest_cells: int = 6
    most_cells: int = 60
    penalty: float = 1e-2


class _CurveLimits(NamedTuple):
    """What separates two cells from one."""

    between_soc: tuple[float, float] = (0.08, 0.97)  # at the steep ends rests say nothing of charge
    least_rests: int = 5
    scales: tuple[float, float] = (0.7, 1.4)  # of the charge of one over that of the other
    other_capacity: float = 0.03  # counters and rests cut short differ by less
    clear: float = 0.7  # error on the better scale over that on one scale
    other_shape_V: float = 0.015  # beyond: another chemistry, or a cell of another age


POINTS, SMOOTHING, LIMITS = _Points(), _CurveSmoothing(), _CurveLimits()
OUTSIDE = 0.02  # of the SOC range, beyond its ends: rows, rests and pulses that still count
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


@dataclass(frozen=True, eq=False)
class OcvCurve:
    """Open-circuit voltage over SOC, where it came from and how well it is known.

    Parameters
    ----------
    soc, voltage_V : (n,) float              uniform grid from 0 to 1, voltage strictly rising
    capacity_Ah : float                      the capacity that SOC refers to [Ah]
    function : MonotoneSpline                through the points
    points_soc, points_V, points_weight : (m,) float     what was fitted
    discharge_V, charge_V : (n,) or None     low-rate branches on the grid, nan where not measured
    source : str                             log or logs, and method
    notes : tuple of Notice                  what a person should know
    """

    soc: FloatArray
    voltage_V: FloatArray
    capacity_Ah: float
    function: MonotoneSpline
    points_soc: FloatArray
    points_V: FloatArray
    points_weight: FloatArray
    discharge_V: FloatArray | None = None
    charge_V: FloatArray | None = None
    source: str = ""
    notes: tuple[Notice, ...] = ()


def curve_from_points(
    soc: FloatArray,
    voltage_V: FloatArray,
    *,
    capacity_Ah: float,
    weight: FloatArray | None = None,
    discharge_V: FloatArray | None = None,
    charge_V: FloatArray | None = None,
    source: str = "",
    notes: tuple[Notice, ...] = (),
) -> OcvCurve:
    """Fit points of OCV over SOC and hold the result on the uniform grid.

    A spline: over low-rate curves of four chemistries, sampled as rests at every 5 % or 10 % or
    densely, its median error between the points was smaller than that of the LFP paper's form.

    Raises
    ------
    InputError    fewer than four points, SOC far outside 0..1, all at one SOC, voltage that does
                  not rise with SOC
    """
    s, v, w = checked_points(soc, voltage_V, weight)
    function = fit_monotone_spline(s, v, w)
    return OcvCurve(
        SOC_GRID,
        function.evaluate(SOC_GRID),
        capacity_Ah,
        function,
        s,
        v,
        w,
        discharge_V,
        charge_V,
        source,
        notes,
    )


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


def sample_notice(rests: OcvCurve, low_rate: OcvCurve, capacity_Ah: float) -> Notice | None:
    """Notice for a person whose OCV test and pulse test are not of one cell.

    The rests are laid on the low-rate curve with a scale of their charge, and a constant beside it:
    the curve carries half the hysteresis and its polarisation. None too with too few rests.

    Parameters
    ----------
    rests, low_rate : OcvCurve        SOC of both over one capacity
    """
    inside = (rests.points_soc >= LIMITS.between_soc[0]) & (
        rests.points_soc <= LIMITS.between_soc[1]
    )
    soc, v = rests.points_soc[inside], rests.points_V[inside]
    if soc.size < LIMITS.least_rests:
        return None

    def away_V(scale: float) -> FloatArray:
        at = np.clip(1.0 - scale * (1.0 - soc), 0.0, 1.0)
        return v - low_rate.function.evaluate(at)

    best = minimize_scalar(lambda k: np.std(away_V(k)), bounds=LIMITS.scales, method="bounded")
    scale, left_V = float(best.x), float(best.fun)
    other = abs(scale - 1.0) > LIMITS.other_capacity and left_V < LIMITS.clear * np.std(away_V(1.0))
    if not other and left_V <= LIMITS.other_shape_V:
        return None
    level = np.maximum.accumulate(low_rate.voltage_V) + float(np.mean(away_V(scale)))
    at = np.interp(v[[0, -1]], level, low_rate.soc)
    moved_Ah = max(float(np.ptp(at)) * low_rate.capacity_Ah, 1e-3 * capacity_Ah)
    rests_Ah = float(np.ptp(soc)) * rests.capacity_Ah
    text = (
        f" and '{rests.source}' do not look like one cell: from "
        f"{v[-1]:.3f} to {v[0]:.3f} V the first moves {moved_Ah:.3f} Ah, the second "
        f"{rests_Ah:.3f} Ah ({100.0 * (rests_Ah / moved_Ah - 1.0):+.1f} %), and "
        f"{1e3 * left_V:.0f} mV RMS are left between them. Two samples, two ages, or a current "
        f"sensor that is off; SOC refers to {capacity_Ah:.3f} Ah"
    )
    size_V = RANGE_V * abs(math.log(rests_Ah / moved_Ah)) + left_V
    return Notice(Code.TWO_CELLS, text, log=low_rate.source, size_V=size_V)
