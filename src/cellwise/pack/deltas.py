"""Every cell's differences from the mean cell (bar-delta filtering), carried from log to log."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cellwise.pack.differences import SELF_DISCHARGE, SIZE, usual_spread
from cellwise.pack.evidence import PASSES, USUAL_WEIGHT, PackEvidence, robust_std
from cellwise.typing import FloatArray

LEAST_SHARE = 0.2  # of the usual spread: a pack of equal cells is not expected to be more equal


@dataclass(frozen=True, eq=False)
class CellDeltas:
    """Differences of every cell from the mean cell.

    ``mean`` (cells, SIZE), ``covariance`` (cells, SIZE, SIZE), ``days`` from the first log to the
    last, ``spread`` (SIZE,) standard deviation between cells, ``updates`` how many periods.
    """

    mean: FloatArray
    covariance: FloatArray
    spread: FloatArray
    days: float = 0.0
    updates: int = 0

    @classmethod
    def unknown(cls, cells: int, spread: FloatArray | None = None) -> CellDeltas:
        """Cells of which only their usual spread is known."""
        usual = usual_spread().cells if spread is None else spread
        wide = np.broadcast_to(np.diag(usual**2), (cells, SIZE, SIZE))
        return cls(np.zeros((cells, SIZE)), np.array(wide), usual)

    def later(self, days: float) -> CellDeltas:
        """The same ``days`` after the first log: cells drift apart."""
        passed = max(days - self.days, 0.0)
        drift = np.diag(usual_spread().month ** 2) * passed / 30.0
        mean, covariance = self.mean.copy(), self.covariance + drift
        # What a cell lost during one period balancing may return in the next.
        mean[:, SELF_DISCHARGE] = 0.0
        covariance[:, SELF_DISCHARGE, :] = covariance[:, :, SELF_DISCHARGE] = 0.0
        covariance[:, SELF_DISCHARGE, SELF_DISCHARGE] = self.spread[SELF_DISCHARGE] ** 2
        return replace(self, mean=mean, covariance=covariance, days=max(days, self.days))

    def updated(self, evidence: PackEvidence) -> CellDeltas:
        """The same after a log."""
        mean, covariance = posterior(self.mean, self.covariance, evidence)
        return replace(self, mean=mean, covariance=covariance, updates=self.updates + 1)


def posterior(
    mean: FloatArray, covariance: FloatArray, evidence: PackEvidence
) -> tuple[FloatArray, FloatArray]:
    """Means and covariances after an evidence, in the form that bears no information at all."""
    a, b = evidence.matrix, evidence.vector
    eye = np.eye(SIZE)
    half = 0.5 * np.linalg.solve(eye + covariance @ a, covariance)
    after: FloatArray = np.asarray(half + np.swapaxes(half, 1, 2), dtype=np.float64)
    surprise = b - np.einsum("cij,cj->ci", a, mean)
    return np.asarray(mean + np.einsum("cij,cj->ci", after, surprise)), after


def spread_between(evidence: PackEvidence) -> FloatArray:
    """Standard deviation between the cells of each difference, shape (SIZE,).

    Expectation-maximisation with robust moments, so that one odd cell does not widen what is
    normal; few cells leave the usual spread as it is.
    """
    usual = usual_spread().cells
    spread = usual.copy()
    there = evidence.rows > 0
    cells = float(np.count_nonzero(there))
    for _ in range(PASSES):
        start = CellDeltas.unknown(evidence.rows.size, spread)
        mean, covariance = posterior(start.mean, start.covariance, evidence)
        mean = mean[there]
        seen = robust_std(mean - np.median(mean, axis=0))
        unseen = np.median(np.diagonal(covariance[there], axis1=1, axis2=2), axis=0)
        variance = seen**2 + np.minimum(unseen, spread**2)
        blended = (cells * variance + USUAL_WEIGHT * usual**2) / (cells + USUAL_WEIGHT)
        spread = np.maximum(np.sqrt(blended), LEAST_SHARE * usual)
    return spread


def drift_between(past: CellDeltas, evidence: PackEvidence) -> FloatArray:
    """Variance of the cells' changes since then, beyond what was expected, (SIZE,).

    By expectation-maximisation over the cells as :func:`spread_between`: in a pack that was
    balanced meanwhile all cells' SOC have moved, and no one of them is odd for it.
    """
    usual = usual_spread().month ** 2
    there = evidence.rows > 0
    cells = float(np.count_nonzero(there))
    drift = usual.copy()
    for _ in range(PASSES):
        before = past.covariance + np.diag(drift)
        mean, after = posterior(past.mean, before, evidence)
        share = np.linalg.solve(before, np.broadcast_to(np.diag(drift), before.shape))
        share = np.swapaxes(share, 1, 2)
        change = np.einsum("cij,cj->ci", share, mean - past.mean)[there]
        left = np.diag(drift) - share @ np.diag(drift) + share @ after @ np.swapaxes(share, 1, 2)
        unseen = np.median(np.diagonal(left[there], axis1=1, axis2=2), axis=0)
        moved = robust_std(change - np.median(change, axis=0))
        drift = (cells * (moved**2 + unseen) + USUAL_WEIGHT * usual) / (cells + USUAL_WEIGHT)
    return drift
