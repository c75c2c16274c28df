"""Fit OCV functions to points of voltage over SOC, and choose among them by left-out points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import PchipInterpolator

from cellwise.identify.ocv.ocv_functions import (
    OCV_KINDS,
    OcvFunction,
    OcvKind,
    OcvTable,
)
from cellwise.identify.ocv.ocv_points import (
    MIN_POINTS,
    beyond_ends,
    checked_points,
    condense,
    leave_out_turns,
    strictly_rising,
)
from cellwise.identify.ocv.ocv_spline import fit_monotone_spline
from cellwise.identify.papers.log_linear_exp import fit_log_linear_exp
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

    nan where fewer than ``MIN_POINTS + 2`` points are given.
    """
    s, v, w = condense(*checked_points(soc, voltage_V, weight))
    if s.size < MIN_POINTS + 2:
        return float("nan")
    turn = leave_out_turns(s)
    squares = 0.0
    for fold in range(int(turn.max()) + 1):
        left = turn == fold
        function = _fit(s[~left], v[~left], w[~left], kind)
        squares += float(np.sum(w[left] * (v[left] - function.evaluate(s[left])) ** 2))
    return float(np.sqrt(squares / np.sum(w[turn >= 0])))


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
