"""A share of capacity over a life: a smooth curve with its band, and where it bends."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from cellwise.typing import BoolArray, FloatArray

SLOPES = (0.003, 0.01, 0.03, 0.1, 0.3)  # fade over the life seen, standard deviation
BENDS = (0.0, 0.01, 0.03, 0.1, 0.3)  # how much it bends: of an integrated Wiener process
# Windows of one kind are wrong alike: what they cannot see ages in its own way.
WINDOWS_ALIKE = 0.9
START_STD = 0.002
KNEE_BIC = 10.0
FEWEST_FOR_KNEE = 8


@dataclass(frozen=True, eq=False)
class Trend:
    """Share of the first capacity, shape (n,), its deviation, and the knee (None: no bend)."""

    share: FloatArray
    std: FloatArray
    knee: int | None


def trend_of(way: FloatArray, share: FloatArray, std: FloatArray, counted: BoolArray) -> Trend:
    """The trend of measured shares.

    Parameters
    ----------
    way : (n,) float          age, never decreasing: days, throughput or number
    share, std : (n,) float   measured shares of the first capacity and their deviations
    counted : (n,) bool       from a complete discharge: no error in common with the others

    Notes
    -----
    A Gaussian process that begins at one: straight line plus integrated Wiener process, the sizes
    of both by the largest marginal likelihood, noise as stated, the part of it that windows share
    kept apart.
    """
    u = way - way[0]
    u = u / max(float(u[-1]), 1e-12)
    together = std * ~counted
    noise = np.diag(std**2) + 1e-8 * np.eye(u.size)
    common = WINDOWS_ALIKE * np.outer(together, together)
    np.fill_diagonal(common, 0.0)
    best, chosen = -np.inf, (SLOPES[0], BENDS[0])
    for slope, bend in product(SLOPES, BENDS):
        found = _likelihood(_kernel(u, slope, bend) + noise + common, share - 1.0)
        if found > best:
            best, chosen = found, (slope, bend)
    kernel = _kernel(u, *chosen)
    gain = np.linalg.solve(kernel + noise + common, kernel).T
    mean = 1.0 + gain @ (share - 1.0)
    covariance = kernel - gain @ kernel
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return Trend(mean, deviation, _knee(u, share, std))


def _kernel(u: FloatArray, slope: float, bend: float) -> FloatArray:
    low, high = np.minimum(u[:, None], u[None, :]), np.maximum(u[:, None], u[None, :])
    wiener = low**2 * (3.0 * high - low) / 6.0
    line = slope**2 * np.outer(u, u)
    return np.asarray(START_STD**2 + line + 3.0 * bend**2 * wiener)


def _likelihood(covariance: FloatArray, left: FloatArray) -> float:
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, left)
    return float(-0.5 * white @ white - np.log(np.diag(root)).sum())


def _knee(u: FloatArray, share: FloatArray, std: FloatArray) -> int | None:
    """Number of the log from which the fade is faster; None where one line is as good."""
    if u.size < FEWEST_FOR_KNEE:
        return None
    line = _line_cost(u, share, std, None)[0]
    best, knee = np.inf, None
    for k in range(3, u.size - 3):
        cost, slopes = _line_cost(u, share, std, float(u[k]))
        if cost < best and slopes[1] < 0.0 and slopes[0] > slopes[0] + slopes[1]:
            best, knee = cost, k
    size = max(best / max(u.size - 4, 1), 1.0)  # scatter beyond the stated deviations
    gain = (line - best) / size - 2.0 * np.log(u.size)
    return knee if gain > KNEE_BIC else None


def _line_cost(
    u: FloatArray, share: FloatArray, std: FloatArray, bend: float | None
) -> tuple[float, FloatArray]:
    """Weighted squares of one line, or of a line that bends, and its slopes."""
    columns = [np.ones_like(u), u]
    if bend is not None:
        columns.append(np.maximum(u - bend, 0.0))
    matrix = np.stack(columns, axis=1) / std[:, None]
    x = np.asarray(np.linalg.lstsq(matrix, share / std, rcond=None)[0], dtype=np.float64)
    return float(np.sum((share / std - matrix @ x) ** 2)), x[1:]
