"""The UKF written with filterpy: baseline for speed, oracle for correctness.

All eleven sigma points of the whole state through the model, no innovation gate, no recovery.
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from cellwise.cell.model import CellModel
from cellwise.estimate.baselines.filterpy_base import Beside, FilterpyFilter, Inside, Interval
from cellwise.estimate.filters.ukf import STATES, SigmaPoints
from cellwise.estimate.noise import Noise
from cellwise.typing import FloatArray


class FilterpyUkf(FilterpyFilter):
    """filterpy's UnscentedKalmanFilter over [soc, v1, v2, v3, h]."""

    name = "filterpy-ukf"

    def __init__(
        self, model: CellModel, noise: Noise | None = None, points: SigmaPoints | None = None
    ) -> None:
        super().__init__(model, noise)
        self.points = SigmaPoints() if points is None else points

    def init(self, soc0: float, soc0_std: float = 0.15) -> UnscentedKalmanFilter:
        """A filterpy filter with the start state and covariance of :class:`Ukf`."""
        points = MerweScaledSigmaPoints(
            STATES, self.points.alpha, self.points.beta, self.points.kappa, sqrt_method=root
        )
        ukf = UnscentedKalmanFilter(
            dim_x=STATES, dim_z=1, dt=1.0, hx=self._measured, fx=self._moved, points=points
        )
        self.begin(ukf, soc0, soc0_std)
        return ukf

    def _moved(self, x: FloatArray, dt: float, now: Interval, before: Beside) -> FloatArray:
        return np.array(self.transition(x, now, before)[:STATES])

    def _measured(self, x: FloatArray, now: Interval, inside: Inside) -> FloatArray:
        return np.array([self.voltage(x, now.seen_A, inside)])

    def predict(self, kf: UnscentedKalmanFilter, now: Interval, before: Beside) -> Beside:
        """Over one interval; what the cell carries beside after it."""
        after = self.transition(kf.x, now, before)
        inside = Inside(now.temperature_C + before.heat_K, after.slow_A)
        _, kf.Q = self.process(after.soc, now, inside)
        kf.predict(dt=now.dt_s, now=now, before=before)
        return Beside(after.heat_K, after.slow_A)

    def update(
        self,
        kf: UnscentedKalmanFilter,
        voltage_V: float,
        now: Interval,
        inside: Inside,
        one: float,
        shared: float,
    ) -> tuple[float, float]:
        """With a voltage whose variance is ``one`` times ``shared``: predicted, its variance."""
        seen = np.array([self._measured(s, now, inside) for s in kf.sigmas_f])[:, 0]
        predicted = float(kf.Wm @ seen)
        marginal = float(kf.Wc @ (seen - predicted) ** 2) + one
        if np.isfinite(shared):
            weight = np.array([[one * shared]])
            kf.update(np.array([voltage_V]), R=weight, now=now, inside=inside)
        return predicted, marginal


def root(matrix: FloatArray) -> FloatArray:
    """Upper Cholesky factor of a positive semidefinite matrix: a state may be known exactly."""
    n = matrix.shape[0]
    lower = np.zeros_like(matrix)
    for j in range(n):
        pivot = matrix[j, j] - lower[j, :j] @ lower[j, :j]
        if pivot <= 0.0:
            continue
        lower[j, j] = np.sqrt(pivot)
        lower[j + 1 :, j] = (matrix[j + 1 :, j] - lower[j + 1 :, :j] @ lower[j, :j]) / lower[j, j]
    return np.asarray(lower.T)
