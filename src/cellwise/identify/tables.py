"""From the parameters of single pulses to tables over SOC: smooth spline, or the paper's cubic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.fit.splines import (
    SOC_GRID,
    TABLE_KNOTS,
    curvature_penalty,
    greville,
    spline_matrix,
)
from cellwise.identify.pulse_fit.circuit import APART, PulseFit
from cellwise.typing import FloatArray

TableKind = Literal["spline", "cubic"]
NAMES = ("r0_ohm", "r1_ohm", "tau1_s", "r2_ohm", "tau2_s")


class _TableSmoothing(NamedTuple):
    """From single pulses to a table."""

    spread: float = 0.05  # pulses of one level differ by rate and direction: no less is an error
    stiffness: float = 0.02  # of the spline: a bend of one costs as much as this misfit
    hold: float = 1e-4  # and a distance of one from the nearest pulse as much as this
    beyond: float = 0.05  # of the SOC range: so far beyond the pulses a table goes on
    unseen: float = 0.01  # of the other resistances: one that no pulse shows
    lowest: float = 0.05  # of the least value: a cubic may dip below zero outside its data


SMOOTHING = _TableSmoothing()


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


def pulse_tables(fits: Sequence[PulseFit], kind: TableKind = "spline") -> PulseTables:
    """Tables over SOC from fitted pulses, each weighted by its own standard error.

    Spline: penalised cubic B-splines of the logarithm, so positive by construction. Cubic: least
    squares of the value itself, as in the LFP paper.

    Raises
    ------
    InputError        no pulse that shows a time constant
    """
    grid = SOC_GRID
    soc = np.array([f.soc for f in fits])
    values: dict[str, FloatArray] = {}
    cubic: dict[str, tuple[float, float, float, float]] = {}
    for name in NAMES:
        value = np.array([getattr(f.value, name) for f in fits])
        if name.endswith("ohm") and not np.any(value > 0.0):
            # Every fit put the whole answer into the other branches: a model still needs a
            # resistance here, small against theirs.
            value = np.array([SMOOTHING.unseen * sum(f.value[k] for k in (0, 1, 3)) for f in fits])
        error = np.array([getattr(f.error, name) for f in fits])
        relative = np.where(np.isnan(error), SMOOTHING.spread, error / np.maximum(value, 1e-300))
        there = value > 0.0
        good = there & (relative < 1.0)
        if not good.any():
            good, relative = there, np.ones(value.size)
        if not good.any():
            raise InputError(
                f"no pulse with a positive {name}",
                "at least one pulse that shows it",
                "Give pulses with a longer relaxation, or another method.",
            )
        s, v, weight = soc[good], value[good], 1.0 / (relative[good] ** 2 + SMOOTHING.spread**2)
        if kind == "cubic":
            cubic[name] = cubic_fit(s, v, weight)
            table = np.polynomial.polynomial.polyval(grid, cubic[name])
            values[name] = np.maximum(table, SMOOTHING.lowest * float(np.min(v)))
        else:
            values[name] = np.exp(_smooth(s, np.log(v), weight, grid))
    values["tau2_s"] = np.maximum(values["tau2_s"], APART * values["tau1_s"])
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
    degree = min(3, np.unique(np.round(soc, 3)).size - 1)
    root = np.ones(soc.size) if weight is None else np.sqrt(weight)
    found = np.polynomial.polynomial.polyfit(soc, value, degree, w=root)
    a, b, c, d = np.append(found, np.zeros(3 - degree)).tolist()
    return a, b, c, d


def _smooth(soc: FloatArray, value: FloatArray, weight: FloatArray, grid: FloatArray) -> FloatArray:
    """Penalised spline; what no pulse reaches stays level with the nearest one."""
    matrix, centres = spline_matrix(soc, TABLE_KNOTS), greville(TABLE_KNOTS)
    share = matrix.T * (weight / weight.sum())
    system = share @ matrix + SMOOTHING.stiffness / soc.size * curvature_penalty(TABLE_KNOTS)
    hold, order = SMOOTHING.hold / soc.size, np.argsort(soc)
    nearest = np.interp(centres, soc[order], value[order])
    coefficients = np.linalg.solve(
        system + hold * np.eye(centres.size), share @ value + hold * nearest
    )
    low, high = np.min(soc) - SMOOTHING.beyond, np.max(soc) + SMOOTHING.beyond
    at = np.clip(grid, max(low, 0.0), min(high, 1.0))
    return np.asarray(spline_matrix(at, TABLE_KNOTS) @ coefficients)
