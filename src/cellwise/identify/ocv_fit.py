"""Fit OCV functions to points of voltage over SOC, and choose among them by left-out points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, PchipInterpolator
from scipy.optimize import isotonic_regression, minimize, nnls

from cellwise.errors import InputError
from cellwise.identify.ocv_functions import (
    OCV_KINDS,
    LogLinearExp,
    MonotoneSpline,
    OcvFunction,
    OcvKind,
    OcvTable,
)
from cellwise.typing import FloatArray

# A plateau that is flatter than this tells a filter nothing; the floor only keeps the sign.
MIN_SLOPE_V = 1e-3
# A low-rate log has thousands of rows that say the same: so many points are kept.
MAX_POINTS = 400
MAX_SPLINE_CELLS = 60
TABLE_CELLS = 100
# Over 37 measured curves, sampled as rests or densely, with noise from 0 to 8 mV, the best penalty
# lay in this range and the usual one was seldom far from it: left-out points must be many and speak
# clearly to move it.
SMOOTHING = 10.0 ** np.arange(-4.0, 0.5)
USUAL_SMOOTHING = 2
CLEAR_GAIN = 0.85
ENOUGH_POINTS = 20
FOLDS = 5
CLOSE_OF_STEP = 0.3
# More points than this are a low-rate curve, not rests.
MAX_RESTS = 120
MIN_POINTS = 4
# Below the lowest point the slope may go on growing, up to twofold over this stretch of SOC.
END_STRETCH = 0.05


@dataclass(frozen=True, eq=False)
class OcvFit:
    """A fitted OCV function and how well it says the points again.

    ``held_out_rmse_V`` is the error at points left out of the fit, by turns, ends kept: it is
    what the forms are compared by. nan where there were too few points for it.
    """

    function: OcvFunction
    soc: FloatArray
    weight: FloatArray
    residual_V: FloatArray
    rmse_V: float
    max_error_V: float
    held_out_rmse_V: float

    @property
    def kind(self) -> OcvKind:
        """Which form was fitted."""
        return self.function.kind


def fit_ocv_function(
    soc: FloatArray,
    voltage_V: FloatArray,
    kind: OcvKind | Literal["auto"] = "auto",
    *,
    weight: FloatArray | None = None,
) -> OcvFit:
    """Fit one form of OCV function to points, or the form that foretells left-out points best.

    Parameters
    ----------
    soc, voltage_V : (n,) float      points in any order; missing values are left out
    kind : str                       ``auto`` takes the form with the smallest held-out error
    weight : (n,) float              how much each point counts, default equally

    Returns
    -------
    OcvFit        residuals are measured minus fitted, at the points given

    Raises
    ------
    InputError    fewer than four points, SOC far outside 0..1, all at one SOC, voltage that does
                  not rise with SOC
    """
    s, v, w = _checked_points(soc, voltage_V, weight)
    kinds = OCV_KINDS if kind == "auto" else (kind,)
    held_out = {k: held_out_rmse(s, v, k, w) for k in kinds}
    # Too few points to leave any out: the table only joins them.
    best = min(
        kinds, key=lambda k: (held_out[k] if np.isfinite(held_out[k]) else 0.0, k != "table")
    )
    function = _fit(s, v, w, best)
    residual = v - function.evaluate(s)
    return OcvFit(
        function=function,
        soc=s,
        weight=w,
        residual_V=residual,
        rmse_V=float(np.sqrt(np.mean(residual**2))),
        max_error_V=float(np.max(np.abs(residual))),
        held_out_rmse_V=held_out[best],
    )


def held_out_rmse(
    soc: FloatArray, voltage_V: FloatArray, kind: OcvKind, weight: FloatArray | None = None
) -> float:
    """RMS error at points left out of the fit, every fifth in turn, both ends kept [V].

    nan where fewer than ``MIN_POINTS + 2`` points are given. The spline's penalty is chosen by
    this very figure: one number against many points, so the figure stays honest enough.
    """
    s, v, w = _condense(*_checked_points(soc, voltage_V, weight))
    if kind == "spline" or s.size < MIN_POINTS + 2:
        return _choose_smoothing(s, v, w)[1]
    turn = leave_out_turns(s)
    squares = 0.0
    for fold in range(int(turn.max()) + 1):
        left = turn == fold
        function = _fit(s[~left], v[~left], w[~left], kind)
        squares += float(np.sum(w[left] * (v[left] - function.evaluate(s[left])) ** 2))
    return float(np.sqrt(squares / np.sum(w[turn >= 0])))


def fit_log_linear_exp(
    soc: FloatArray, voltage_V: FloatArray, weight: FloatArray | None = None
) -> LogLinearExp:
    """Equation 8 by variable projection: a, b, d and the exponential's height are linear.

    Only c and e are searched, from a grid and then downhill, so the result does not hang on a
    start value. b >= 0 always; d >= 0 too where the curve would otherwise not rise.
    """
    s, v, w = _condense(*_checked_points(soc, voltage_V, weight))
    least_c = max(1e-3, 1e-3 - float(s[0]))

    def solve(x: FloatArray, d_positive: bool) -> tuple[float, FloatArray]:
        c = least_c + np.exp(np.clip(x[0], -9.0, 1.0))
        e = np.exp(np.clip(x[1], 0.0, 5.5))
        return _log_linear_exp_linear_part(s, v, w, c, e, d_positive)

    def search(d_positive: bool) -> LogLinearExp:
        starts = [np.array([lc, le]) for lc in np.arange(-8, 1) for le in np.arange(0.5, 5.5, 0.5)]
        start = min(starts, key=lambda x: solve(x, d_positive)[0])
        best = minimize(
            lambda x: np.log(1e-18 + solve(x, d_positive)[0]),
            start,
            method="Nelder-Mead",
            options={"xatol": 1e-7, "fatol": 1e-10, "maxiter": 600},
        ).x
        a, b, d, height = solve(best, d_positive)[1]
        e = float(np.exp(np.clip(best[1], 0.0, 5.5)))
        c = float(least_c + np.exp(np.clip(best[0], -9.0, 1.0)))
        f = 1.0 - np.log(max(float(height), 1e-12)) / e
        return LogLinearExp(float(a), float(b), c, float(d), e, float(f))

    found = search(d_positive=False)
    if np.min(found.slope(np.linspace(0.0, 1.0, 201))) < MIN_SLOPE_V:
        found = search(d_positive=True)
    return found


def fit_monotone_spline(
    soc: FloatArray, voltage_V: FloatArray, weight: FloatArray | None = None
) -> MonotoneSpline:
    """Strictly rising smoothing spline over 0..1, knots where the curve is long.

    Knots lie at equal steps of the curve's length in the (SOC, voltage) picture: the steep ends
    get as many as they need, the plateau of LFP keeps its own. Second differences of the
    coefficients are penalised (Eilers and Marx 1996, doi:10.1214/ss/1038425655), non-negative
    least squares keeps the increments positive, and left-out points choose the penalty.
    """
    s, v, w = _condense(*_checked_points(soc, voltage_V, weight))
    smoothing, _ = _choose_smoothing(s, v, w)
    return _spline_to_ends(s, v, w, smoothing)


def fit_ocv_table(
    soc: FloatArray,
    voltage_V: FloatArray,
    weight: FloatArray | None = None,
    *,
    cells: int = TABLE_CELLS,
) -> OcvTable:
    """Table at ``cells + 1`` uniform steps of SOC from 0 to 1: the points, made to rise, joined.

    Isotonic regression removes what noise made fall, a monotone cubic (Fritsch and Butland 1984,
    doi:10.1137/0905021) joins the points.
    """
    s, v, w = _condense(*_checked_points(soc, voltage_V, weight))
    through = PchipInterpolator(s, _strictly_rising(s, v, w))
    s_end, v_end = _beyond_ends(through, float(s[0]), float(s[-1]))
    grid = np.linspace(0.0, 1.0, cells + 1)
    inside = through(np.clip(grid, s[0], s[-1]))
    if s_end.size:
        known_s, known_v = np.append(s_end, s[[0, -1]]), np.append(v_end, through(s[[0, -1]]))
        order = np.argsort(known_s)
        outside = (grid < s[0]) | (grid > s[-1])
        inside[outside] = np.interp(grid[outside], known_s[order], known_v[order])
    return OcvTable(_strictly_rising(grid, inside))


def _fit(s: FloatArray, v: FloatArray, w: FloatArray, kind: OcvKind) -> OcvFunction:
    if kind == "log-linear-exp":
        return fit_log_linear_exp(s, v, w)
    if kind == "spline":
        return fit_monotone_spline(s, v, w)
    return fit_ocv_table(s, v, w)


def _log_linear_exp_linear_part(
    s: FloatArray, v: FloatArray, w: FloatArray, c: float, e: float, d_positive: bool
) -> tuple[float, FloatArray]:
    """Best a, b, d and height of exp(e (s - 1)) for given c and e, with b and the height >= 0."""
    columns = np.column_stack((np.ones(s.size), np.log(s + c), s, np.exp(e * (s - 1.0))))
    root = np.sqrt(w)
    a, y = columns * root[:, None], v * root
    best, best_cost = np.zeros(4), np.inf
    # Three signs at most: trying every set of active bounds is exact and needs no iteration.
    for free in ([0, 1, 2, 3], [0, 1, 2], [0, 2, 3], [0, 1, 3], [0, 2], [0, 1], [0, 3]):
        x = np.zeros(4)
        x[free] = np.linalg.lstsq(a[:, free], y, rcond=None)[0]
        if x[1] < 0 or x[3] < 0 or (d_positive and x[2] < MIN_SLOPE_V and 2 in free):
            continue
        cost = float(np.sum((a @ x - y) ** 2))
        if cost < best_cost:
            best, best_cost = x, cost
        if len(free) == 4:
            break
    return best_cost, best


def _choose_smoothing(s: FloatArray, v: FloatArray, w: FloatArray) -> tuple[float, float]:
    """Penalty with the smallest error at left-out points, and that error (nan: too few)."""
    if s.size < MIN_POINTS + 2:
        return float(SMOOTHING[USUAL_SMOOTHING]), float("nan")
    turn = leave_out_turns(s)
    squares = np.zeros(SMOOTHING.size)
    for fold in range(int(turn.max()) + 1):
        left = turn == fold
        for i, smoothing in enumerate(SMOOTHING):
            f = _solve_spline(s[~left], v[~left], w[~left], smoothing)
            squares[i] += np.sum(w[left] * (v[left] - f.evaluate(s[left])) ** 2)
    errors = np.sqrt(squares / np.sum(w[turn >= 0]))
    best = int(np.argmin(errors))
    if s.size < ENOUGH_POINTS or errors[best] > CLEAR_GAIN * errors[USUAL_SMOOTHING]:
        best = USUAL_SMOOTHING
    return float(SMOOTHING[best]), float(errors[best])


def _spline_to_ends(
    s: FloatArray, v: FloatArray, w: FloatArray, smoothing: float
) -> MonotoneSpline:
    inner = _solve_spline(s, v, w, smoothing)
    s_end, v_end = _beyond_ends(inner.evaluate, float(s[0]), float(s[-1]))
    if s_end.size == 0:
        return inner
    order = np.argsort(np.append(s, s_end))
    weight = np.append(w, np.full(s_end.size, np.mean(w)))
    return _solve_spline(
        np.append(s, s_end)[order], np.append(v, v_end)[order], weight[order], smoothing
    )


def _solve_spline(s: FloatArray, v: FloatArray, w: FloatArray, smoothing: float) -> MonotoneSpline:
    """Penalised least squares for a spline over the points' range, coefficients increasing."""
    rising = _strictly_rising(s, v, w)
    length = np.cumsum(np.hypot(np.diff(s), np.diff(rising) / (rising[-1] - rising[0])))
    cells = int(np.clip(s.size, 6, MAX_SPLINE_CELLS))
    inner = np.interp(np.arange(1, cells) / cells * length[-1], np.append(0.0, length), s)
    knots = np.concatenate((np.full(4, s[0]), inner, np.full(4, s[-1])))
    basis = BSpline.design_matrix(np.minimum(s, s[-1]), knots, 3).toarray()
    m = basis.shape[1]
    spacing = (knots[4 : m + 3] - knots[1:m]) / 3.0
    bend = np.diff(np.eye(m), 2, axis=0) * np.sqrt(smoothing)
    root = np.sqrt(w / np.mean(w))
    a = np.vstack((basis * root[:, None], bend))
    y = np.append(v * root, np.zeros(m - 2))
    # coefficients = first + running sum of (floor + increments): all unknowns are >= 0.
    floor = np.append(0.0, MIN_SLOPE_V * np.cumsum(spacing))
    to_coefficients = np.tril(np.ones((m, m)))
    q, r = np.linalg.qr(a @ to_coefficients)
    increments, _ = nnls(r, q.T @ (y - a @ floor), maxiter=30 * m)
    return MonotoneSpline(knots, to_coefficients @ increments + floor)


def _beyond_ends(
    evaluate: Callable[[FloatArray], FloatArray], first: float, last: float
) -> tuple[FloatArray, FloatArray]:
    """Points that carry a curve known over [first, last] on to SOC 0 and 1.

    Upward straight on. Downward the slope goes on growing as it does at the end, up to twofold
    per ``END_STRETCH``: on measured low-rate curves of NCA, NMC, LMO and LFP, cut off at 5 %,
    that halves the straight line's error.
    """
    h = min(END_STRETCH, (last - first) / 3.0)
    s_end, v_end = np.zeros(0), np.zeros(0)
    if first > 0.0:
        v0, v1, v2 = evaluate(first + h * np.arange(3.0))
        growth = np.log(np.clip((v1 - v0) / max(v2 - v1, 1e-9), 1.0, 2.0)) / h
        steep = (v1 - v0) / h * np.exp(growth * h / 2.0)
        d = first * (1.0 - np.arange(np.ceil(first / 0.01)) / np.ceil(first / 0.01))
        s_end = first - d
        v_end = v0 - steep * (np.expm1(growth * d) / growth if growth > 1e-6 else d)
    if last < 1.0:
        v0, v1 = evaluate(np.array([last - h, last]))
        d = (
            (1.0 - last)
            * (1.0 + np.arange(np.ceil((1.0 - last) / 0.01)))
            / np.ceil((1.0 - last) / 0.01)
        )
        s_end = np.append(s_end, last + d)
        v_end = np.append(v_end, v1 + d * max((v1 - v0) / h, MIN_SLOPE_V))
    return s_end, v_end


def _strictly_rising(s: FloatArray, v: FloatArray, w: FloatArray | None = None) -> FloatArray:
    """The rising sequence nearest to ``v``, rising by at least the least slope."""
    level = MIN_SLOPE_V * s
    return np.asarray(isotonic_regression(v - level, weights=w).x + 1.001 * level)


def _checked_points(
    soc: FloatArray, voltage_V: FloatArray, weight: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    s = np.asarray(soc, dtype=np.float64)
    v = np.asarray(voltage_V, dtype=np.float64)
    w = np.ones(s.shape) if weight is None else np.asarray(weight, dtype=np.float64)
    if s.ndim != 1 or s.shape != v.shape or s.shape != w.shape:
        raise InputError(
            f"soc, voltage_V, weight of shapes {s.shape}, {v.shape}, {w.shape}",
            "three arrays of one length",
            "Give one voltage (and one weight) per SOC.",
        )
    good = np.isfinite(s) & np.isfinite(v) & (w > 0)
    s, v, w = s[good], v[good], w[good]
    if s.size < MIN_POINTS:
        raise InputError(
            f"{s.size} usable point(s) of OCV over SOC",
            f"at least {MIN_POINTS}",
            "Use a log with rests at more levels of SOC, or a low-rate discharge.",
        )
    order = np.argsort(s, kind="stable")
    s, v, w = s[order], v[order], w[order]
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


def _condense(
    s: FloatArray, v: FloatArray, w: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Means of points that say the same: equal SOC, or more than ``MAX_POINTS`` along the curve."""
    group: NDArray[np.intp] = np.append(0, np.cumsum(np.diff(s) > 1e-4))
    if group[-1] >= MAX_POINTS:
        rising = isotonic_regression(v, weights=w).x
        length = np.append(0.0, np.cumsum(np.hypot(np.diff(s), np.diff(rising) / np.ptp(rising))))
        bins = (length / length[-1] * (MAX_POINTS - 1)).astype(np.intp)
        group = np.append(0, np.cumsum((np.diff(bins) > 0) & (np.diff(s) > 1e-6)))
    total: FloatArray = np.bincount(group, w).astype(np.float64)
    return np.bincount(group, w * s) / total, np.bincount(group, w * v) / total, total


def leave_out_turns(s: FloatArray) -> NDArray[np.intp]:
    """Turn at which each point is left out, shape (n,); -1 for the two ends, which never are.

    Rests that lie close together, as those between the pulses of one level do, take one turn
    together: a neighbour a millivolt away would foretell anything.
    """
    group = np.arange(s.size)
    if s.size <= MAX_RESTS:
        step = np.diff(s)
        levels = np.append(0, np.cumsum(step > CLOSE_OF_STEP * np.max(step)))
        group = levels if levels[-1] >= MIN_POINTS + 1 else group
    turn = group % min(FOLDS, int(group[-1]) - 1)
    turn[(group == 0) | (group == group[-1])] = -1
    return turn
