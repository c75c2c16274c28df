"""From the parameters of single pulses to tables over SOC: smooth spline, or the paper's cubic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.pulse_fit.pulse_parameters import PulseFit
from cellwise.identify.refinement.splines import (
    TABLE_KNOTS,
    curvature_penalty,
    greville,
    spline_count,
    spline_rows,
    spline_values,
)
from cellwise.typing import FloatArray

TableKind = Literal["spline", "cubic"]
NAMES = ("r0_ohm", "r1_ohm", "tau1_s", "r2_ohm", "tau2_s")
RESISTANCES = ("r0_ohm", "r1_ohm", "r2_ohm")
GRID_POINTS = 201


class _Smoothing(NamedTuple):
    """From single pulses to a table."""

    spread: float = 0.05  # pulses of one level differ by rate and direction: no less is an error
    stiffness: float = 0.02  # of the spline: a bend of one costs as much as this misfit
    ratio: float = 1.5  # between the time constants
    unseen: float = 0.01  # of the other resistances: one that no pulse shows
    lowest: float = 0.05  # of the least value: a cubic may dip below zero outside its data


SMOOTHING = _Smoothing()


@dataclass(frozen=True, eq=False)
class PulseTables:
    """Parameters over SOC.

    ``soc`` (n,) uniform grid; ``values`` name -> (n,); ``cubic`` name -> (a, b, c, d) of
    a + b s + c s^2 + d s^3 where the paper's polynomial was asked for (equation 9 of the LFP
    paper).
    """

    soc: FloatArray
    values: dict[str, FloatArray]
    cubic: dict[str, tuple[float, float, float, float]]


def pulse_tables(
    fits: Sequence[PulseFit], points: int = 201, kind: TableKind = "spline"
) -> PulseTables:
    """Tables over SOC from fitted pulses, each weighted by its own standard error.

    Spline: penalised cubic B-splines of the logarithm, so positive by construction. Cubic: least
    squares of the value itself, as in the LFP paper.

    Raises
    ------
    InputError        no fit with a known SOC
    """
    known = [f for f in fits if np.isfinite(f.soc)]
    if not known:
        raise InputError(
            "no fitted pulse with a known SOC",
            "at least one healthy pulse in a log whose SOC can be counted",
            "Give an HPPC log with pulses after rests.",
        )
    grid = np.linspace(0.0, 1.0, points)
    soc = np.array([f.soc for f in known])
    values: dict[str, FloatArray] = {}
    cubic: dict[str, tuple[float, float, float, float]] = {}
    for name in NAMES:
        value = np.array([getattr(f.value, name) for f in known])
        if name in RESISTANCES and not np.any(value > 0):
            # Every fit put the whole answer into the other branches: a model still needs a
            # resistance here, small against theirs.
            value = np.array([SMOOTHING.unseen * sum(f.value[k] for k in (0, 1, 3)) for f in known])
        error = np.array([getattr(f.error, name) for f in known])
        s, v, w = _usable(soc, value, error, name)
        if kind == "cubic":
            coefficients = cubic_fit(s, v, w)
            cubic[name] = coefficients
            table = np.polynomial.polynomial.polyval(grid, coefficients)
            values[name] = np.maximum(table, SMOOTHING.lowest * float(np.min(v)))
        else:
            values[name] = np.exp(_smooth(s, np.log(v), w, grid))
    values["tau2_s"] = np.maximum(values["tau2_s"], SMOOTHING.ratio * values["tau1_s"])
    return PulseTables(grid, values, cubic)


def cubic_fit(
    soc: FloatArray, value: FloatArray, weight: FloatArray | None = None
) -> tuple[float, float, float, float]:
    """Coefficients a, b, c, d of a + b s + c s^2 + d s^3 by weighted least squares.

    The polynomial is linear in its coefficients, so plain least squares gives the optimum that
    the LFP paper seeks with Levenberg-Marquardt. With fewer than four SOC levels the degree falls.

    Parameters
    ----------
    soc, value : (n,) float
    weight : (n,) float or None      inverse variances
    """
    levels = np.unique(np.round(soc, 3)).size
    degree = min(3, max(levels - 1, 0))
    root = None if weight is None else np.sqrt(weight / np.max(weight))
    matrix = np.vander(soc, degree + 1, increasing=True)
    rhs = value
    if root is not None:
        matrix, rhs = matrix * root[:, None], value * root
    found = np.linalg.lstsq(matrix, rhs, rcond=None)[0]
    full = np.zeros(4)
    full[: found.size] = found
    return (float(full[0]), float(full[1]), float(full[2]), float(full[3]))


def _usable(
    soc: FloatArray, value: FloatArray, error: FloatArray, name: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Values above zero and their weights; a value without a standard error counts as one."""
    relative = np.where(np.isnan(error), SMOOTHING.spread, error / np.maximum(value, 1e-300))
    good = (value > 0) & np.isfinite(value) & np.isfinite(relative) & (relative < 1.0)
    if not good.any():
        good = (value > 0) & np.isfinite(value)
        relative = np.full(value.size, 1.0)
    if not good.any():
        raise InputError(
            f"no pulse with a positive {name}",
            "at least one pulse that shows it",
            "Give pulses with a longer relaxation, or another method.",
        )
    return soc[good], value[good], 1.0 / (relative[good] ** 2 + SMOOTHING.spread**2)


def _smooth(soc: FloatArray, value: FloatArray, weight: FloatArray, grid: FloatArray) -> FloatArray:
    knots = TABLE_KNOTS
    rows = spline_rows(soc, knots)
    n = spline_count(knots)
    matrix = np.zeros((soc.size, n))
    matrix[np.arange(soc.size)[:, None], rows.first[:, None] + np.arange(4)] = rows.values
    share = weight / weight.sum()
    system = matrix.T @ (share[:, None] * matrix)
    system += SMOOTHING.stiffness / max(soc.size, 1) * curvature_penalty(knots)
    # What no pulse reaches stays level with the nearest one, rather than run off along a slope.
    nearest = np.interp(greville(knots), *_sorted_mean(soc, value))
    hold = 1e-4 / max(soc.size, 1)
    system += hold * np.eye(n)
    coefficients = np.linalg.solve(system, matrix.T @ (share * value) + hold * nearest)
    smooth = spline_values(spline_rows(grid, knots), coefficients)
    low, high = float(np.min(soc)), float(np.max(soc))
    inside = np.clip(grid, max(low - 0.05, 0.0), min(high + 0.05, 1.0))
    return np.asarray(np.interp(inside, grid, smooth))


def _sorted_mean(soc: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    order = np.argsort(soc)
    return soc[order], value[order]
