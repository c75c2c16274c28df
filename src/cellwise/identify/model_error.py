"""How wrong a fitted model is, from its residuals: size, memory, share that follows the current."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellwise.cell.model import ModelError
from cellwise.typing import FloatArray

# A fit sees its own residuals smaller than a new log will.
OPTIMISM = 1.2
LONGEST_LAG_S = 3600.0
STEP_S = 5.0


def estimate_model_error(
    residuals: Sequence[tuple[FloatArray, FloatArray, FloatArray]],
    r0_ohm: float,
    noise_V: float | None = None,
) -> ModelError:
    """Voltage error of a model from residuals over whole logs.

    Parameters
    ----------
    residuals : sequence of (time_s, current_A, residual_V)     one triple of (n,) arrays per log
    r0_ohm : float        typical resistance, for the share that follows the current
    noise_V : float or None   sensor noise where it is known

    Returns
    -------
    ModelError        ``slow_V`` is the error at small current
    """
    slow, share, memory, white, weights = [], [], [], [], []
    for time_s, current_A, residual_V in residuals:
        if residual_V.size < 20:
            continue
        r = _clip(residual_V)
        quiet, part = _split_by_current(current_A, r, r0_ohm)
        slow.append(quiet)
        share.append(part)
        memory.append(correlation_time(time_s, r))
        white.append(1.4826 * float(np.median(np.abs(np.diff(r)))) / np.sqrt(2.0))
        weights.append(float(time_s[-1] - time_s[0]))
    if not slow:
        return ModelError()
    w = np.asarray(weights) + 1.0
    return ModelError(
        white_V=max(float(np.average(white, weights=w)) if noise_V is None else noise_V, 1e-4),
        slow_V=max(OPTIMISM * float(np.sqrt(np.average(np.square(slow), weights=w))), 5e-4),
        correlation_s=float(np.clip(np.average(memory, weights=w), 10.0, LONGEST_LAG_S)),
        resistance_share=float(np.clip(np.sqrt(np.average(np.square(share), weights=w)), 0.0, 0.5)),
    )


def correlation_time(time_s: FloatArray, residual_V: FloatArray) -> float:
    """Time over which a residual remembers itself [s].

    Half the area under the two-sided autocorrelation up to its first zero, after the residual was
    put on an even grid.
    """
    span = float(time_s[-1] - time_s[0])
    step = max(STEP_S, span / 20_000.0)
    if span < 10 * step:
        return STEP_S
    grid = np.arange(time_s[0], time_s[-1], step)
    # Without its mean a residual would seem to forget what it keeps all along: the mean stays in.
    r = np.interp(grid, time_s, residual_V)
    n = r.size
    power = float(r @ r)
    if power == 0.0:
        return STEP_S
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(r, size)
    correlation = np.fft.irfft(spectrum * np.conj(spectrum), size)[:n] / power
    correlation = correlation[: max(2, min(n // 2, int(LONGEST_LAG_S / step)))]
    below = np.flatnonzero(correlation <= 0.0)
    end = int(below[0]) if below.size else correlation.size
    return float(step * (0.5 + np.sum(correlation[1:end])))


def _split_by_current(
    current_A: FloatArray, residual_V: FloatArray, r0_ohm: float
) -> tuple[float, float]:
    """Residual at small current [V], and its growth with the current as a share of R0 I."""
    square = residual_V**2
    drop = (r0_ohm * current_A) ** 2
    matrix = np.column_stack((np.ones(drop.size), drop))
    found = np.linalg.lstsq(matrix, square, rcond=None)[0]
    if found[0] <= 0.0 or found[1] <= 0.0:
        return float(np.sqrt(np.mean(square))), 0.0
    return float(np.sqrt(found[0])), float(np.sqrt(found[1]))


def _clip(residual_V: FloatArray) -> FloatArray:
    """Residual with its few wildest values held: they are the gate's business, not the noise's."""
    limit = 6.0 * 1.4826 * float(np.median(np.abs(residual_V))) + 1e-9
    return np.clip(residual_V, -limit, limit)
