"""The LFP paper's open-circuit voltage: logarithm, line and exponential of SOC, and its fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from cellwise.identify.ocv.ocv_function import OcvKind, inside_of
from cellwise.identify.ocv.ocv_points import POINTS, checked_points, condense
from cellwise.typing import FloatArray


@dataclass(frozen=True)
class LogLinearExp:
    r"""OCV as logarithm, line and exponential, equation 8 of the LFP paper.

    .. math:: OCV(s) = a + b \ln(s + c) + d s + e^{e (s - f)}

    The logarithm bends the empty end down, the exponential the full end up, the line is the
    plateau. Straight outside 0..1.

    Parameters
    ----------
    a, b, d : float       [V], b >= 0
    c, f : float          SOC, c > 0
    e : float             1 per unit of SOC, e > 0
    """

    a: float
    b: float
    c: float
    d: float
    e: float
    f: float

    @property
    def kind(self) -> OcvKind:
        """Name of the form."""
        return "log-linear-exp"

    def evaluate(self, soc: FloatArray | float) -> FloatArray:
        """Open-circuit voltage [V], the shape of ``soc``."""
        s, outside = inside_of(soc, 0.0, 1.0)
        inside = self.a + self.b * np.log(s + self.c) + self.d * s + self._exponential(s)
        return np.asarray(inside + outside * self._slope_inside(s))

    def slope(self, soc: FloatArray | float) -> FloatArray:
        """dOCV/dsoc [V per unit of SOC], the shape of ``soc``."""
        return self._slope_inside(inside_of(soc, 0.0, 1.0)[0])

    def _exponential(self, s: FloatArray) -> FloatArray:
        return np.exp(self.e * (s - self.f))

    def _slope_inside(self, s: FloatArray) -> FloatArray:
        return np.asarray(self.b / (s + self.c) + self.d + self.e * self._exponential(s))


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
    if np.min(found.slope(np.linspace(0.0, 1.0, 201))) < POINTS.slope_V:
        found = search(d_positive=True)
    return found


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
        if x[1] < 0 or x[3] < 0 or (d_positive and x[2] < POINTS.slope_V and 2 in free):
            continue
        cost = float(np.sum((a @ x - y) ** 2))
        if cost < best_cost:
            best, best_cost = x, cost
        if len(free) == 4:
            break
    return best_cost, best
