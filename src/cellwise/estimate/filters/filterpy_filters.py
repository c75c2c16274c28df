"""filterpy's EKF and UKF as baselines: the model as matrices, the same noise, the row loop.

No innovation gate, no recovery, no watch over the sensors: what a user of filterpy writes first.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from cellwise.cell.description import BRANCHES, CELL, SOC, H
from cellwise.cell.equations import (
    CellState,
    advance,
    delayed_current,
    loaded,
    transition,
    voltage_of,
)
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.validity_kernels import extrapolation_V, is_outside, widened
from cellwise.cell.point_kernels import CellPoint
from cellwise.cell.simulate import known_temperature_C
from cellwise.cell.unrolled import CALLED
from cellwise.estimate.equations.evidence import share_of
from cellwise.estimate.equations.start import held_variance
from cellwise.estimate.evidence_kernels import (
    StepConstants,
    constants_of,
    repeated_evidence,
    variance_about,
)
from cellwise.estimate.filters.kalman import STATES, FilterOfModel, SigmaPoints
from cellwise.estimate.filters.predict_kernels import RESTED_V2, before_start, gap_variance
from cellwise.estimate.noise import Noise
from cellwise.estimate.status import OUTSIDE
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.units import check_is_log
from cellwise.typing import FloatArray


class MatrixInterval(NamedTuple):
    """One interval: length, currents, what may have flowed unseen, temperature of the surface.

    ``heat_K`` and ``slow_A`` are what the cell carries beside the filter's states at its start.
    """

    dt_s: float
    delayed_current_A: float
    counted_current_A: float
    gap_A2: float
    temperature_C: float
    heat_K: float
    slow_A: float


def resistances(point: CellPoint) -> FloatArray:
    """Of the branches, shape (branches,)."""
    return np.array([getattr(point, CALLED["r"](s)) for s in BRANCHES])


class FilterpyFilter(FilterOfModel):
    """A filterpy filter over [soc, v1, v2, v3, h]; predict and update are the subclass's."""

    def __init__(self, model: CellModel, noise: Noise | None = None) -> None:
        super().__init__(model, noise)
        self.cell = self._tables.cell
        self._noise = self.noise.scalars(model)

    def init(self, soc0: float, soc0_std: float = 0.15) -> Any:
        """A filterpy filter with the start of :class:`Ekf`, its branches still empty."""
        start, kf = self.start(soc0, soc0_std), self._filter()
        at = [CELL.index(SOC), CELL.index(H)]
        kf.x, kf.P = np.zeros(STATES), np.zeros((STATES, STATES))
        kf.x[at] = soc0, 1.0 if soc0 > 0.5 else -1.0
        kf.P[at, at] = start.variance, start.hysteresis_variance
        return kf

    def _filter(self) -> Any:
        raise NotImplementedError

    def predict(self, kf: Any, now: MatrixInterval, after: CellState, diagonal: FloatArray) -> None:
        """Over one interval: the mean's state after it, the transition's diagonal, ``kf.Q``."""
        raise NotImplementedError

    def predicted_voltage(self, kf: Any, now: MatrixInterval) -> tuple[float, float]:
        """The voltage that is expected, and what the state's variance adds to its own."""
        raise NotImplementedError

    def update(self, kf: Any, voltage_V: float, now: MatrixInterval, weight: FloatArray) -> None:
        """With a voltage of the variance ``weight``, shape (1, 1)."""
        raise NotImplementedError

    def run(self, log: CellLog, soc0: float, soc0_std: float = 0.15) -> Trace:
        """Replay a whole log, sample by sample."""
        check_is_log(log)
        kf = self.init(soc0, soc0_std)
        gaps = log.gap_rows
        current, voltage = log.interval_current_A, log.voltage_V
        temperature = known_temperature_C(self.model, log)
        noise = self._noise
        n = len(log)
        soc, std, predicted, variance = (np.empty(n) for _ in range(4))
        status = np.zeros(n, dtype=np.int32)
        previous = float(np.nan_to_num(current[0]))
        evidence = -1.0
        heat_K, slow_A = 0.0, 0.0
        for k, dt in enumerate(log.interval_s.tolist()):
            held = float(current[k]) if np.isfinite(current[k]) else previous
            delayed_A = float(delayed_current(self.cell, held, previous, dt))
            unknown = delayed_A**2 + previous**2 if gaps[k] else 0.0
            previous = held
            counted_A = 0.0 if gaps[k] else delayed_A
            now = MatrixInterval(
                dt, delayed_A, counted_A, unknown, float(temperature[k]), heat_K, slow_A
            )
            if k == 0:
                point = self.point(float(kf.x[0]), now)
                mean_A, spread_A, limit_V = before_start(self.cell, delayed_A)
                for j, r in enumerate(resistances(point), start=1):
                    kf.x[j] = r * mean_A
                    kf.P[j, j] = held_variance(RESTED_V2, float(r), spread_A, limit_V)
            if gaps[k]:
                kf.P[0, 0] += gap_variance(noise.gap_soc, self.cell.charge_As, unknown, dt)
            after = self.moved(kf.x, now)
            now = now._replace(slow_A=after.slow_A)  # of the tables at its end
            diagonal, kf.Q = self.process(after.soc, now)
            self.predict(kf, now._replace(slow_A=slow_A), after, diagonal)
            heat_K, slow_A = after.heat_K, after.slow_A
            single_V2, status[k] = self.voltage_variance(kf.x, now)
            shared, below = repeated_evidence(self.constants(dt), noise, evidence, dt, delayed_A)
            predicted[k], state_V2 = self.predicted_voltage(kf, now)
            variance[k] = state_V2 + single_V2
            if np.isfinite(voltage[k]):
                evidence = max(evidence, 0.0)
                if below > 0.0:
                    self.update(
                        kf, float(voltage[k]), now, np.array([[single_V2 * shared / below]])
                    )
            if evidence >= 0.0:
                evidence += dt
            kf.x[0] = min(max(kf.x[0], 0.0), 1.0)
            kf.x[-1] = min(max(kf.x[-1], -1.0), 1.0)
            soc[k], std[k] = kf.x[0], np.sqrt(kf.P[0, 0])
        innovation = voltage - predicted
        ratio = innovation**2 / (self.noise.gate**2 * variance)
        return Trace(log.time_s, soc, std, predicted, innovation, variance, ratio, status)

    def constants(self, dt_s: float) -> StepConstants:
        """Of a step of this length."""
        return constants_of(self.cell.charge_As, self.cell.hysteresis_rate, self._noise, dt_s, 1.0)

    def point(self, soc: float, now: MatrixInterval) -> CellPoint:
        """The tables at one SOC, under load."""
        effective_temperature_C = now.temperature_C + now.heat_K
        return loaded(self._tables, soc, effective_temperature_C, now.delayed_current_A, now.slow_A)

    def moved(self, x: FloatArray, now: MatrixInterval) -> CellState:
        """The model's own step of a whole state."""
        state = CellState._make((*(float(v) for v in x), now.heat_K, now.slow_A))
        after, _ = advance(self._tables, state, now.counted_current_A, now.dt_s, now.temperature_C)
        return after

    def process(self, soc: float, now: MatrixInterval) -> tuple[FloatArray, FloatArray]:
        """Diagonal of the transition, shape (states,), and process noise."""
        noise = self._noise
        point = self.point(soc, now)
        t = transition(self.cell, point, now.counted_current_A, now.dt_s)
        r = resistances(point)
        a = np.array([getattr(t, s.decay) for s in BRANCHES])
        g = np.array([getattr(t, s.drive) if s.drive else 0.0 for s in CELL])
        walk = noise.soc_per_sqrt_s**2 * now.dt_s
        walk += noise.capacity_soc * abs(now.counted_current_A) * now.dt_s / self.cell.charge_As
        share2 = share_of(self.constants(now.dt_s), now.counted_current_A)
        branch = share2 * (now.counted_current_A * r) ** 2 * (1 - a * a)
        q = noise.current_A**2 * np.outer(g, g) + np.diag([walk, *branch, 0.0])
        branches = np.array([0.0, *g[1:]])
        q += now.gap_A2 * np.outer(branches, branches)
        return np.array([1.0, *a, t.ah]), q

    def voltage(self, x: FloatArray, now: MatrixInterval) -> FloatArray:
        """Terminal voltage of a state, shape (1,)."""
        state = CellState._make((*(float(v) for v in x), 0.0, 0.0))
        return np.array([voltage_of(self.point(state.soc, now), state, now.delayed_current_A)])

    def voltage_variance(self, x: FloatArray, now: MatrixInterval) -> tuple[float, int]:
        """Of one voltage about a perfect state, wider beyond the model's data; the status."""
        noise, soc = self._noise, float(x[0])
        point, held = self.point(soc, now), float(np.abs(x[1:-1]).sum())
        outside = is_outside(noise.valid, soc, now.temperature_C, now.delayed_current_A)
        if outside:
            drop = abs(float(point.r0_ohm) * now.delayed_current_A) + held
            far_V = extrapolation_V(noise.valid, now.temperature_C, now.delayed_current_A, drop)
            point = widened(point, far_V)
        single_V2 = variance_about(
            self.constants(now.dt_s), noise, point, now.delayed_current_A, 0.0, held
        )
        return float(single_V2), OUTSIDE if outside else 0


class FilterpyEkf(FilterpyFilter):
    """filterpy's ExtendedKalmanFilter over [soc, v1, v2, v3, h]."""

    name = "filterpy-ekf"

    def _filter(self) -> ExtendedKalmanFilter:
        return ExtendedKalmanFilter(dim_x=STATES, dim_z=1)

    def predict(
        self, kf: ExtendedKalmanFilter, now: MatrixInterval, after: CellState, diagonal: FloatArray
    ) -> None:
        """By the model's step and its derivatives."""
        kf.F = np.diag(diagonal)
        kf.P = kf.F @ kf.P @ kf.F.T + kf.Q
        kf.x = np.array(after[:STATES])

    def slopes(self, kf: ExtendedKalmanFilter, now: MatrixInterval) -> FloatArray:
        """Derivatives of the voltage, shape (1, states)."""
        point = self.point(float(kf.x[0]), now)
        return np.array([[point.ocv_slope_V, *(-1.0 for _ in BRANCHES), point.m_V]])

    def predicted_voltage(
        self, kf: ExtendedKalmanFilter, now: MatrixInterval
    ) -> tuple[float, float]:
        """At the mean, and by the derivatives there."""
        slopes = self.slopes(kf, now)
        return float(self.voltage(kf.x, now)[0]), float((slopes @ kf.P @ slopes.T)[0, 0])

    def update(
        self, kf: ExtendedKalmanFilter, voltage_V: float, now: MatrixInterval, weight: FloatArray
    ) -> None:
        """As filterpy does."""
        slopes = self.slopes(kf, now)
        kf.update(np.array([voltage_V]), lambda x: slopes, lambda x: self.voltage(x, now), R=weight)


class FilterpyUkf(FilterpyFilter):
    """filterpy's UnscentedKalmanFilter over [soc, v1, v2, v3, h]."""

    name = "filterpy-ukf"

    def __init__(
        self, model: CellModel, noise: Noise | None = None, points: SigmaPoints | None = None
    ) -> None:
        super().__init__(model, noise)
        self.points = SigmaPoints() if points is None else points

    def _filter(self) -> UnscentedKalmanFilter:
        points = MerweScaledSigmaPoints(
            STATES, self.points.alpha, self.points.beta, self.points.kappa, sqrt_method=root
        )
        return UnscentedKalmanFilter(
            dim_x=STATES,
            dim_z=1,
            dt=1.0,
            hx=self.voltage,
            fx=lambda x, dt, now: np.array(self.moved(x, now)[:STATES]),
            points=points,
        )

    def predict(
        self, kf: UnscentedKalmanFilter, now: MatrixInterval, after: CellState, diagonal: FloatArray
    ) -> None:
        """As filterpy does."""
        kf.predict(dt=now.dt_s, now=now)

    def predicted_voltage(
        self, kf: UnscentedKalmanFilter, now: MatrixInterval
    ) -> tuple[float, float]:
        """Over the sigma points."""
        voltages = np.array([self.voltage(s, now) for s in kf.sigmas_f])[:, 0]
        mean = float(kf.Wm @ voltages)
        return mean, float(kf.Wc @ (voltages - mean) ** 2)

    def update(
        self, kf: UnscentedKalmanFilter, voltage_V: float, now: MatrixInterval, weight: FloatArray
    ) -> None:
        """As filterpy does."""
        kf.update(np.array([voltage_V]), R=weight, now=now)


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
