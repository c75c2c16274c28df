"""How large and how long-lived the part of a residual is that no cause explains."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from cellwise.diagnose.fit.whitening_kernels import NoiseLevel, minus_log_likelihood
from cellwise.typing import BoolArray, FloatArray

CLIP = 30.0
MOST_ROWS = 5000
LEAST_V = 2e-5
FAST_S = (1.0, 60.0)
SLOW_S = (60.0, 7200.0)

# One log may leave so much more or less than another.
LOG_SCALE = (0.25, 4.0)
SCALE_CLIP = 6.0


class Noise(NamedTuple):
    """What no cause explains: a level, and how many times it each log leaves (empty: alike)."""

    level: NoiseLevel
    scale: tuple[float, ...] = ()


def estimate_noise(residual_V: FloatArray, dt_s: FloatArray, known: BoolArray) -> NoiseLevel:
    """Maximum likelihood of a white and two exponentially correlated parts.

    Parameters
    ----------
    residual_V : (rows,) float      over the expected size of the error there
    dt_s : (rows,) float            time since the row before [s], NaN where a log begins
    known : (rows,) bool            rows to use
    """
    step = max(1, residual_V.size // MOST_ROWS)
    r, gap, use = _every(residual_V, dt_s, known, step)
    if not use.any():
        return NoiseLevel(1e-3, 1e-4, 10.0, 1e-3, 600.0)
    e = r[use]
    spread = max(float(np.sqrt(np.mean(np.minimum(e * e, 9 * np.median(e * e) + 1e-12)))), LEAST_V)
    jump = np.abs(np.diff(e))
    white = max(float(np.median(jump)) / 0.954 if jump.size else spread, LEAST_V)
    shortest = float(np.nanmedian(gap)) if np.isfinite(gap).any() else 1.0
    fast = (max(FAST_S[0], 2 * shortest), max(FAST_S[1], 6 * shortest))
    slow = (max(SLOW_S[0], fast[1]), max(SLOW_S[1], 60 * shortest))
    low = np.log([LEAST_V, LEAST_V, fast[0], LEAST_V, slow[0]])
    high = np.log([1.0, 1.0, fast[1], 1.0, slow[1]])
    start = np.log([min(white, spread), spread / 2, 3 * fast[0], spread, 600.0])
    start = np.clip(start, low + 1e-6, high - 1e-6)

    def cost(x: FloatArray) -> float:
        inside = np.clip(x, low, high)
        outside = float(np.sum((x - inside) ** 2))
        level = NoiseLevel(*np.exp(inside))
        return minus_log_likelihood(r, gap, use, level, CLIP) + 100.0 * outside

    simplex = np.vstack([start, start + 0.7 * np.eye(5) * np.where(start < high - 0.8, 1, -1)])
    found = minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={"maxfev": 220, "xatol": 0.05, "fatol": 0.2, "initial_simplex": simplex},
    )
    return NoiseLevel(*(float(v) for v in np.exp(np.clip(found.x, low, high))))


def _every(
    residual: FloatArray, dt: FloatArray, known: BoolArray, step: int
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Every ``step``-th row, the time since the last one kept, new logs kept as new."""
    if step == 1:
        return residual, dt, known
    log_number = np.cumsum(~np.isfinite(dt))
    clock = np.cumsum(np.where(np.isfinite(dt), dt, 0.0))
    picked = np.arange(0, residual.size, step)
    gap = np.empty(picked.size)
    gap[0] = np.nan
    gap[1:] = np.diff(clock[picked])
    gap[1:][np.diff(log_number[picked]) > 0] = np.nan
    return residual[picked].copy(), gap, known[picked].copy()


def at_least(level: NoiseLevel, floor: NoiseLevel) -> NoiseLevel:
    """The larger of two levels, part by part; the memory of whichever is larger."""
    fast, slow = level.fast_V >= floor.fast_V, level.slow_V >= floor.slow_V
    return NoiseLevel(
        max(level.white_V, floor.white_V),
        level.fast_V if fast else floor.fast_V,
        level.fast_s if fast else floor.fast_s,
        level.slow_V if slow else floor.slow_V,
        level.slow_s if slow else floor.slow_s,
    )


def log_scales(white: FloatArray, rows: BoolArray, lengths: list[int]) -> tuple[float, ...]:
    """How many times the noise each log leaves: root mean square of its whitened residual.

    Parameters
    ----------
    white : (rows,) float     whitened residual of one log after the other
    rows : (rows,) bool       rows to use
    lengths : rows of each log
    """
    square = np.minimum(white * white, SCALE_CLIP**2)
    ends = np.cumsum(lengths)[:-1]
    parts = zip(np.split(square, ends), np.split(rows, ends), strict=True)
    return tuple(
        float(np.clip(np.sqrt(np.mean(s[use])) if use.any() else 1.0, *LOG_SCALE))
        for s, use in parts
    )
