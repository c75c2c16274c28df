"""The LFP paper's open-circuit voltage: logarithm, line and exponential of SOC, and its fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brute, lsq_linear, minimize

from cellwise.identify.ocv.curve import POINTS, checked_points
from cellwise.typing import FloatArray

LN_C = slice(-8.0, 0.5, 0.5)  # of what ln(s + c) stays clear of zero by: 0.0003 to 1 of SOC
LN_E = slice(0.5, 5.5, 0.5)  # of the exponential's length: from nearly all of the range to 1 %


@dataclass(frozen=True)
class LogLinearExp:
    r"""OCV as logarithm, line and exponential, equation 8 of the LFP paper.

    .. math:: OCV(s) = a + b \ln(s + c) + d s + e^{e (s - f)}

    The logarithm bends the empty end down, the exponential the full end up, the line is the
    plateau.

    Parameters
    ----------
    a, b, d : float       [V], b >= 0; d as negative as a curve that rises allows
    c, f : float          SOC, c > 0
    e : float             1 per unit of SOC, e > 0
    rmse_V : float        of the points that it was fitted to [V]
    """

    a: float
    b: float
    c: float
    d: float
    e: float
    f: float
    rmse_V: float = 0.0

    def evaluate(self, soc: FloatArray) -> FloatArray:
        """Open-circuit voltage [V] at SOC from 0 to 1, the shape of ``soc``."""
        exponential = np.exp(self.e * (soc - self.f))
        return np.asarray(self.a + self.b * np.log(soc + self.c) + self.d * soc + exponential)


def fit_log_linear_exp(soc: FloatArray, voltage_V: FloatArray) -> LogLinearExp:
    """Equation 8 by variable projection: a, b, d and the exponential's height are linear.

    Only c and e are searched, over a grid and then downhill, where the paper let a swarm search
    all six: the result does not depend on a seed.

    Raises
    ------
    InputError        as `checked_points`
    """
    s, v, _ = checked_points(soc, voltage_V, None)
    least_c = 1e-3 - min(float(s[0]), 0.0)
    grid = np.linspace(0.0, 1.0, 101)

    def constants(x: FloatArray) -> tuple[float, float]:
        return least_c + float(np.exp(min(x[0], 1.0))), float(np.exp(min(x[1], 6.0)))

    def linear(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        c, e = constants(x)
        columns = np.column_stack((np.ones(s.size), np.log(s + c), s, np.exp(e * (s - 1.0))))
        fitted = lsq_linear(columns, v, ([-np.inf, 0.0, -np.inf, 0.0], np.inf)).x
        slope = np.column_stack(
            (0.0 * grid, 1.0 / (grid + c), 1.0 + 0.0 * grid, e * np.exp(e * (grid - 1.0)))
        )
        if np.min(slope @ fitted) <= 0.0:
            fitted = minimize(
                lambda p: float(np.sum((columns @ p - v) ** 2)),
                np.array([fitted[0], fitted[1], 0.0, fitted[3]]),
                jac=lambda p: 2.0 * columns.T @ (columns @ p - v),
                method="SLSQP",
                bounds=[(None, None), (0.0, None), (None, None), (0.0, None)],
                constraints={"type": "ineq", "fun": lambda p: slope @ p - POINTS.slope_V},
            ).x
        return fitted, columns @ fitted - v

    best = brute(lambda x: float(np.sum(linear(x)[1] ** 2)), (LN_C, LN_E))
    (a, b, d, height), residual_V = linear(best)
    c, e = constants(best)
    f = 1.0 - np.log(max(float(height), 1e-12)) / e
    rmse_V = float(np.sqrt(np.mean(residual_V**2)))
    return LogLinearExp(float(a), float(b), c, float(d), e, float(f), rmse_V)
