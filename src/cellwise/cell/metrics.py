"""How far a simulated voltage is from a measured one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellwise.typing import FloatArray

NEAR_EMPTY = 0.1  # SOC below which the OCV is steep and the resistance high: judged apart
BANDS = tuple((k / 10, (k + 1) / 10) for k in range(10))


@dataclass(frozen=True)
class ErrorMetrics:
    """Measured minus model, over the rows that have a measurement.

    ``samples`` are these rows; ``rmse_V``, ``mae_V`` and ``max_error_V`` are root mean square, mean
    and largest magnitude of the error [V], ``mean_error_V`` and ``std_error_V`` its mean and
    standard deviation. ``ci95_V`` is mean +- 1.96 standard deviations, the interval that holds 95 %
    of a normal error (first seed paper, residual table), not the interval of the mean.
    """

    samples: int
    rmse_V: float
    mae_V: float
    max_error_V: float
    mean_error_V: float
    std_error_V: float
    ci95_V: tuple[float, float]


@dataclass(frozen=True)
class BandMetrics:
    """The same over the rows whose simulated SOC lies in [low, high)."""

    soc_low: float
    soc_high: float
    metrics: ErrorMetrics

    @property
    def rmse_V(self) -> float:
        """RMS of its rows [V]."""
        return self.metrics.rmse_V


def error_metrics(error_V: FloatArray) -> ErrorMetrics:
    """RMSE, MAE, maximum, mean, standard deviation and 95 % interval of an error [V].

    Parameters
    ----------
    error_V : (n,) float      NaN where there is no measurement; such rows do not count

    Returns
    -------
    ErrorMetrics              every figure NaN when no row counts
    """
    e = error_V[np.isfinite(error_V)]
    if e.size == 0:
        nan = float("nan")
        return ErrorMetrics(0, nan, nan, nan, nan, nan, (nan, nan))
    mean = float(np.mean(e))
    std = float(np.std(e))
    return ErrorMetrics(
        samples=int(e.size),
        rmse_V=float(np.sqrt(np.mean(e * e))),
        mae_V=float(np.mean(np.abs(e))),
        max_error_V=float(np.max(np.abs(e))),
        mean_error_V=mean,
        std_error_V=std,
        ci95_V=(mean - 1.96 * std, mean + 1.96 * std),
    )


def band_metrics(error_V: FloatArray, soc: FloatArray) -> tuple[BandMetrics, ...]:
    """Error metrics by tenth of SOC; the end bands take what lies beyond 0 and 1."""
    found = []
    for low, high in BANDS:
        inside = (soc >= (low if low > 0 else -np.inf)) & (soc < (high if high < 1 else np.inf))
        if np.any(inside):
            found.append(BandMetrics(low, high, error_metrics(error_V[inside])))
    return tuple(found)


def metrics_to_dict(metrics: ErrorMetrics) -> dict[str, Any]:
    """Metrics as JSON values; a figure that does not exist is null."""
    figures = {**vars(metrics), "ci95_V": list(metrics.ci95_V)}
    return (
        figures
        if metrics.samples
        else {**dict.fromkeys(figures), "ci95_V": [None, None], "samples": 0}
    )


RESAMPLES = 1000


@dataclass(frozen=True)
class HeldOutGain:
    """What one simulation gains over another on rows that neither was fitted on.

    ``gain`` is 1 - RMSE after / RMSE before, ``low`` and ``high`` its 95 % interval over whole
    blocks of rows, which stay together because neighbouring errors are alike.
    """

    before_V: float
    after_V: float
    gain: float
    low: float
    high: float


def held_out_gain(
    before_V: FloatArray, after_V: FloatArray, block: NDArray[np.integer], seed: int = 0
) -> HeldOutGain:
    """Gain from the residuals of two simulations of the same rows, blocks drawn with replacement.

    Parameters
    ----------
    before_V, after_V : (rows,) float      residuals [V]
    block : (rows,) int                    the block of each row
    """
    totals = drawn_sums(block, np.column_stack((before_V, after_V)) ** 2, seed)
    drawn = 1.0 - np.sqrt(totals[:, 1] / np.maximum(totals[:, 0], 1e-30))
    before, after = (float(np.sqrt(np.mean(r * r))) for r in (before_V, after_V))
    low, high = np.quantile(drawn, (0.025, 0.975))
    gain = 1.0 - after / before if before > 0.0 else 0.0
    return HeldOutGain(before, after, gain, float(low), float(high))


def drawn_sums(
    block: NDArray[np.integer], values: FloatArray, seed: int | np.random.Generator = 0
) -> FloatArray:
    """Sums of the values (rows, m) over blocks drawn with replacement, shape (RESAMPLES, m)."""
    sums = block_sums(block, values)
    rng = np.random.default_rng(seed)
    drawn = rng.integers(0, len(sums), (RESAMPLES, len(sums)))
    return np.asarray(sums[drawn].sum(axis=1))


def block_sums(block: NDArray[np.integer], values: FloatArray) -> FloatArray:
    """Sums of the values (rows, m) over each block, shape (blocks, m)."""
    _, place = np.unique(block, return_inverse=True)
    sums = np.zeros((int(place.max()) + 1, values.shape[1]))
    np.add.at(sums, place, values)
    return sums
