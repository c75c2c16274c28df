"""The same filter written with filterpy: baseline for speed, oracle for correctness.

Matrix form, tangent slope, no innovation gate, no recovery: what a user of filterpy writes first.
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from cellwise.cell.kernels import CellPoint, CellState, advance, look_up, seen_current, under_load
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import known_temperature_C
from cellwise.estimate.ekf import Ekf
from cellwise.estimate.noise import Noise
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray


class FilterpyEkf:
    """filterpy's ExtendedKalmanFilter over [soc, v1, v2, v3, h]."""

    name = "filterpy-ekf"

    def __init__(self, model: CellModel, noise: Noise | None = None) -> None:
        self.model = model
        self.noise = Noise.of_model(model) if noise is None else noise
        self._table, self._grid, self._cell = model.parameters()

    def init(self, soc0: float, soc0_std: float = 0.15) -> ExtendedKalmanFilter:
        """A filterpy filter with the start state and covariance of :class:`Ekf`."""
        start = Ekf(self.model, self.noise).start(soc0, soc0_std)
        ekf = ExtendedKalmanFilter(dim_x=5, dim_z=1)
        ekf.x = np.array([soc0, 0.0, 0.0, 0.0, 1.0 if soc0 > 0.5 else -1.0])
        branch = [start.branch_variance, start.branch_variance, start.slow_branch_variance]
        ekf.P = np.diag([start.variance, *branch, start.hysteresis_variance])
        return ekf

    def run(self, log: CellLog, soc0: float, soc0_std: float = 0.15) -> Trace:
        """Replay a whole log, sample by sample."""
        ekf = self.init(soc0, soc0_std)
        gaps = log.gap_rows
        current = log.interval_current_A
        temperature = known_temperature_C(self.model, log)
        dt = log.interval_s
        n = len(log)
        soc, std, predicted, innovation, variance = (np.empty(n) for _ in range(5))
        previous = float(np.nan_to_num(current[0]))
        fresh = True
        heat = 0.0
        for k in range(n):
            now = float(current[k]) if np.isfinite(current[k]) else previous
            seen = float(seen_current(self._cell, now, previous, dt[k]))
            unknown = seen**2 + previous**2 if gaps[k] else 0.0
            previous = now
            if gaps[k]:
                ekf.P[0, 0] += self.noise.gap_soc**2
            flow = 0.0 if gaps[k] else seen
            warm = temperature[k] + heat
            point, heat = self._predict(ekf, flow, dt[k], temperature[k], heat, unknown)
            predicted[k] = self._voltage(ekf.x, seen, warm)
            innovation[k] = log.voltage_V[k] - predicted[k]
            shared = 1.0  # the first voltage is evidence by itself
            if not fresh and self.noise.slow_s > 0:
                # A repeated stamp repeats the slow error: no new evidence.
                shared = max(2 * self.noise.slow_s / dt[k], 1.0) if dt[k] > 0 else np.inf
            variance[k] = self._update(ekf, log.voltage_V[k], seen, shared, warm, point)
            fresh = fresh and not np.isfinite(log.voltage_V[k])
            soc[k], std[k] = ekf.x[0], np.sqrt(ekf.P[0, 0])
        ratio = innovation**2 / (self.noise.gate**2 * variance)
        status = np.zeros(n, dtype=np.int32)
        return Trace(log.time_s, soc, std, predicted, innovation, variance, ratio, status)

    def _predict(
        self,
        ekf: ExtendedKalmanFilter,
        current: float,
        dt: float,
        temperature: float,
        heat: float,
        unknown: float,
    ) -> tuple[CellPoint, float]:
        noise, cell = self.noise, self._cell
        before = CellState._make((*(float(v) for v in ekf.x), heat))
        after, point = advance(
            self._table, self._grid, cell, before, current, float(dt), float(temperature)
        )
        r = np.array([point.r1_ohm, point.r2_ohm, point.r3_ohm])
        a = np.exp(-dt / np.array([point.tau1_s, point.tau2_s, point.tau3_s]))
        a[r == 0] = 1.0
        hold = np.exp(-cell.hysteresis_rate * abs(current) * dt / cell.charge_As)
        ekf.F = np.diag([1.0, *a, hold])
        g = np.array([-dt / cell.charge_As, *(r * (1 - a)), 0.0])
        walk = noise.scalars().soc_per_sqrt_s ** 2 * dt
        branch = (noise.branch_share * current * r) ** 2 * (1 - a * a)
        ekf.Q = noise.current_A**2 * np.outer(g, g) + np.diag([walk, *branch, 0.0])
        branches = np.array([0.0, *g[1:]])
        ekf.Q += unknown * np.outer(branches, branches)
        ekf.P = ekf.F @ ekf.P @ ekf.F.T + ekf.Q
        ekf.x = np.array(after[:-1])
        return CellPoint(*point), float(after[-1])

    def _voltage(self, x: FloatArray, current: float, temperature: float) -> float:
        here = look_up(self._table, self._grid, self._cell, float(x[0]), float(temperature))
        point = under_load(self._cell, here, current)
        return float(point.ocv_V - point.r0_ohm * current - x[1] - x[2] - x[3] + point.m_V * x[4])

    def _update(
        self,
        ekf: ExtendedKalmanFilter,
        voltage: float,
        current: float,
        shared: float,
        temperature: float,
        point: CellPoint,
    ) -> float:
        noise = self.noise
        one = (
            noise.voltage_V**2
            + (noise.error_scale * point.error_V) ** 2
            + (noise.ocv_soc * point.ocv_slope_V) ** 2
        )
        one += noise.branch_share**2 * (point.r0_ohm * current) ** 2
        one += (noise.current_A * point.r0_ohm) ** 2
        slopes = np.array([[point.ocv_slope_V, -1.0, -1.0, -1.0, point.m_V]])

        def jacobian(x: FloatArray) -> FloatArray:
            return slopes

        def measured(x: FloatArray) -> FloatArray:
            return np.array([self._voltage(x, current, temperature)])

        marginal = float((slopes @ ekf.P @ slopes.T)[0, 0]) + one
        if np.isfinite(voltage) and np.isfinite(shared):
            weight = np.array([[one * shared]])
            ekf.update(np.array([voltage]), HJacobian=jacobian, Hx=measured, R=weight)
        ekf.x[0] = min(max(ekf.x[0], 0.0), 1.0)
        ekf.x[4] = min(max(ekf.x[4], -1.0), 1.0)
        return marginal
