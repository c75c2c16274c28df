"""Fit OCV functions to points of voltage over SOC, and choose among them by left-out points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize

from cellwise.identify.ocv.ocv_functions import (
    OCV_KINDS,
    LogLinearExp,
    OcvFunction,
    OcvKind,
    OcvTable,
)
from cellwise.identify.ocv.ocv_points import (
    MIN_POINTS,
    MIN_SLOPE_V,
    beyond_ends,
    checked_points,
    condense,
    leave_out_turns,
    strictly_rising,
)
from cellwise.identify.ocv.ocv_spline import choose_smoothing, fit_monotone_spline
from cellwise.typing import FloatArray

TABLE_CELLS = 100


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
    """Fit one form of OCV function to points, or the form that predicts left-out points best.

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
    s, v, w = checked_points(soc, voltage_V, weight)
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
    this very figure: one number against many points, so the figure is hardly biased.
    """
    s, v, w = condense(*checked_points(soc, voltage_V, weight))
    if kind == "spline" or s.size < MIN_POINTS + 2:
        return choose_smoothing(s, v, w)[1]
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
    s, v, w = condense(*checked_points(soc, voltage_V, weight))
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
    s, v, w = condense(*checked_points(soc, voltage_V, weight))
    through = PchipInterpolator(s, strictly_rising(s, v, w))
    s_end, v_end = beyond_ends(through, float(s[0]), float(s[-1]))
    grid = np.linspace(0.0, 1.0, cells + 1)
    inside = through(np.clip(grid, s[0], s[-1]))
    if s_end.size:
        known_s, known_v = np.append(s_end, s[[0, -1]]), np.append(v_end, through(s[[0, -1]]))
        order = np.argsort(known_s)
        outside = (grid < s[0]) | (grid > s[-1])
        inside[outside] = np.interp(grid[outside], known_s[order], known_v[order])
    return OcvTable(strictly_rising(grid, inside))


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
