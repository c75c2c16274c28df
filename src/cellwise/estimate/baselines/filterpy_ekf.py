"""The EKF written with filterpy: baseline for speed, oracle for correctness.

Matrix form, tangent slope, no innovation gate, no recovery: what a user of filterpy writes first.
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from cellwise.cell.description import CELL
from cellwise.estimate.baselines.filterpy_base import Beside, FilterpyFilter, Inside, Interval
from cellwise.typing import FloatArray

STATES = len(CELL)


class FilterpyEkf(FilterpyFilter):
    """filterpy's ExtendedKalmanFilter over [soc, v1, v2, v3, h]."""

    name = "filterpy-ekf"

    def init(self, soc0: float, soc0_std: float = 0.15) -> ExtendedKalmanFilter:
        """A filterpy filter with the start state and covariance of :class:`Ekf`."""
        ekf = ExtendedKalmanFilter(dim_x=5, dim_z=1)
        self.begin(ekf, soc0, soc0_std)
        return ekf

    def predict(self, kf: ExtendedKalmanFilter, now: Interval, before: Beside) -> Beside:
        """Over one interval; what the cell carries beside after it."""
        after = self.transition(kf.x, now, before)
        inside = Inside(now.temperature_C + before.heat_K, after.slow_A)
        diagonal, kf.Q = self.process(after.soc, now, inside)
        kf.F = np.diag(diagonal)
        kf.P = kf.F @ kf.P @ kf.F.T + kf.Q
        kf.x = np.array(after[:STATES])
        return Beside(after.heat_K, after.slow_A)

    def update(
        self,
        kf: ExtendedKalmanFilter,
        voltage_V: float,
        now: Interval,
        inside: Inside,
        one: float,
        shared: float,
    ) -> tuple[float, float]:
        """With a voltage whose variance is ``one`` times ``shared``: predicted, its variance."""
        point = self.point(float(kf.x[0]), now.seen_A, inside)
        slopes = np.array([[point.ocv_slope_V, -1.0, -1.0, -1.0, point.m_V]])

        def jacobian(x: FloatArray) -> FloatArray:
            return slopes

        def measured(x: FloatArray) -> FloatArray:
            return np.array([self.voltage(x, now.seen_A, inside)])

        predicted = self.voltage(kf.x, now.seen_A, inside)
        marginal = float((slopes @ kf.P @ slopes.T)[0, 0]) + one
        if np.isfinite(shared):
            weight = np.array([[one * shared]])
            kf.update(np.array([voltage_V]), HJacobian=jacobian, Hx=measured, R=weight)
        return predicted, marginal
