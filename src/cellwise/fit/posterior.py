"""From the covariance of a fit's unknowns to the few directions that go with the model."""

from __future__ import annotations

import numpy as np

from cellwise.cell.posterior import CAPACITY, POINTS, Posterior
from cellwise.fit.solve import FitResult
from cellwise.fit.solver import Prior
from cellwise.fit.splines import OCV_KNOTS, TABLE_KNOTS, spline_matrix
from cellwise.fit.unknowns import Layout
from cellwise.typing import FloatArray

OCV_MODES, RESISTANCE_MODES = 8, 5


def posterior_of(result: FitResult, prior: Prior, name: str) -> Posterior:
    """The posterior in the modes in which the prior is widest.

    OCV and resistances are parted into modes of the prior's own covariance, so that a coordinate is
    1 where the logs said nothing; what the logs left is the covariance of these coordinates.
    """
    layout = result.layout
    grid = np.linspace(0.0, 1.0, POINTS)
    ocv = np.zeros((POINTS, layout.size))
    ocv[:, : layout.knots_ocv] = spline_matrix(grid, OCV_KNOTS)
    ln_r = whole_resistance(layout, result.theta, grid)[1]
    before = prior.covariance()
    held = layout.capacity
    names, maps, rows = [], [], []
    if prior.free[held]:
        size = float(np.sqrt(before[held, held]))
        unit = np.zeros(layout.size)
        unit[held] = 1.0 / size
        names.append(CAPACITY)
        maps.append((size, np.zeros(POINTS), np.zeros(POINTS)))
        rows.append(unit)
    for kind, feature, most in (("ocv", ocv, OCV_MODES), ("resistance", ln_r, RESISTANCE_MODES)):
        value, vector = np.linalg.eigh(feature @ before @ feature.T)
        for k in range(most):
            size, shape = float(np.sqrt(max(value[-1 - k], 1e-18))), vector[:, -1 - k]
            names.append(f"{kind}_mode_{k + 1}")
            moved = size * shape
            maps.append((0.0, moved, 0.0 * moved) if kind == "ocv" else (0.0, 0.0 * moved, moved))
            rows.append(shape @ feature / size)
    to_modes = np.array(rows)
    covariance = to_modes @ result.covariance @ to_modes.T
    factor = np.linalg.cholesky(covariance + 1e-10 * np.eye(len(rows)))
    return Posterior(
        tuple(names),
        np.asarray(factor, dtype=np.float64),
        np.array([m[0] for m in maps]),
        np.array([m[1] for m in maps]),
        np.array([m[2] for m in maps]),
        name,
    )


def whole_resistance(
    layout: Layout, theta: FloatArray, soc: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Logarithm of the whole resistance, mean over temperatures; its derivative, (soc, size)."""
    splines = spline_matrix(soc, TABLE_KNOTS)
    logarithm, slopes = np.zeros(soc.size), np.zeros((soc.size, layout.size))
    places = [layout.r0, *(layout.r(j) for j in range(layout.branches))]
    for k in range(layout.temperatures):
        at = [p + k * layout.knots for p in places]
        values = [np.exp(splines @ theta[a : a + layout.knots]) for a in at]
        whole = np.sum(values, axis=0)
        logarithm += np.log(whole) / layout.temperatures
        for a, value in zip(at, values, strict=True):
            share = (value / whole)[:, None] * splines / layout.temperatures
            slopes[:, a : a + layout.knots] += share
    return logarithm, slopes
