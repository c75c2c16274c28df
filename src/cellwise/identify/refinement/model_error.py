"""How wrong a fitted model is, from its residuals: size, memory, share that follows the current."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.cell.model import ModelError
from cellwise.typing import FloatArray

# A fit sees its own residuals smaller than a new log will.
OPTIMISM = 1.2
LONGEST_LAG_S = 3600.0
STEP_S = 5.0
PROFILE_POINTS = 51
WINDOW_SOC = 0.02


@dataclass(frozen=True, eq=False)
class ResidualLog:
    """Residual of one log, arrays of shape (n,): measured minus model [V]."""

    time_s: FloatArray
    soc: FloatArray
    current_A: FloatArray
    residual_V: FloatArray


def estimate_model_error(logs: Sequence[ResidualLog], r0_ohm: float) -> ModelError:
    """Voltage error of a model from residuals over whole logs.

    Parameters
    ----------
    logs : sequence of ResidualLog
    r0_ohm : float        typical resistance, for the share that follows the current

    Returns
    -------
    ModelError        ``slow_V`` over SOC, at small current
    """
    usable = [log for log in logs if log.residual_V.size >= 20]
    if not usable:
        return ModelError()
    weights = np.array([float(log.time_s[-1] - log.time_s[0]) + 1.0 for log in usable])
    white = [_step_noise(log.residual_V) for log in usable]
    memory = [correlation_time(log.time_s, _clip(log.residual_V)) for log in usable]
    share = [_current_share(log, r0_ohm) for log in usable]
    common = float(np.sqrt(np.average(np.square(share), weights=weights)))
    return ModelError(
        white_V=max(float(np.average(white, weights=weights)), 1e-4),
        slow_V=_profile(usable, common * r0_ohm),
        correlation_s=float(np.clip(np.average(memory, weights=weights), 10.0, LONGEST_LAG_S)),
        resistance_share=float(np.clip(common, 0.0, 0.5)),
    )


def _profile(logs: Sequence[ResidualLog], share_ohm: float) -> tuple[float, ...]:
    """Root mean square residual over SOC, what follows the current taken out, Gaussian window.

    Where no log has been, the error of the nearest SOC that one has, twice as large at the far
    end of the gap.
    """
    grid = np.linspace(0.0, 1.0, PROFILE_POINTS)
    square = np.zeros(grid.size)
    count = np.zeros(grid.size)
    for log in logs:
        rest = np.maximum(log.residual_V**2 - (share_ohm * log.current_A) ** 2, 0.0)
        window = np.exp(-0.5 * ((grid[:, None] - log.soc[None, :]) / WINDOW_SOC) ** 2)
        share = 1.0 / log.residual_V.size
        square += share * (window @ rest)
        count += share * window.sum(axis=1)
    seen = count > 1e-3 * count.max()
    level = np.sqrt(square[seen] / count[seen])
    away = np.abs(grid[:, None] - grid[seen][None, :]).min(axis=1)
    profile = OPTIMISM * np.interp(grid, grid[seen], level) * (1.0 + away)
    return tuple(float(v) for v in np.maximum(profile, 5e-4))


def _step_noise(residual_V: FloatArray) -> float:
    return 1.4826 * float(np.median(np.abs(np.diff(residual_V)))) / float(np.sqrt(2.0))


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


def _current_share(log: ResidualLog, r0_ohm: float) -> float:
    """Growth of the residual with the current, as a share of R0 I."""
    square = _clip(log.residual_V) ** 2
    drop = (r0_ohm * log.current_A) ** 2
    found = np.linalg.lstsq(np.column_stack((np.ones(drop.size), drop)), square, rcond=None)[0]
    return float(np.sqrt(max(found[1], 0.0))) if found[0] > 0.0 else 0.0


def _clip(residual_V: FloatArray) -> FloatArray:
    """Residual with its few wildest values held: they are the gate's business, not the noise's."""
    limit = 6.0 * 1.4826 * float(np.median(np.abs(residual_V))) + 1e-9
    return np.clip(residual_V, -limit, limit)
