"""filterpy's EKF and UKF as baselines: the model as matrices, the same noise, the row loop.

No innovation gate, no recovery, no watch over the sensors: what a user of filterpy writes first.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from cellwise.cell.equations import CellState, advance, loaded, seen_current, transition, voltage_of
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.validity_kernels import extrapolation_V, is_outside, widened
from cellwise.cell.point_kernels import CellPoint
from cellwise.cell.simulate import known_temperature_C
from cellwise.estimate.evidence_kernels import repeated_evidence, share_at, voltage_variance
from cellwise.estimate.filters.kalman import STATES, FilterOfModel, SigmaPoints
from cellwise.estimate.noise import Noise
from cellwise.estimate.recovery_kernels import start_branch
from cellwise.estimate.sensing_kernels import REST_RATE, unseen_soc
from cellwise.estimate.status import OUTSIDE
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog, check_is_log
from cellwise.typing import FloatArray


class Interval(NamedTuple):
    """One interval: length, currents, what may have flowed unseen, temperature."""

    dt_s: float
    seen_A: float
    flow_A: float
    gap_A2: float
    temperature_C: float


class Beside(NamedTuple):
    """What the cell carries beside the filter's states, without covariance."""

    heat_K: float = 0.0
    slow_A: float = 0.0


class Inside(NamedTuple):
    """The cell's temperature, and the current that its particles' surface has followed."""

    warm_C: float
    slow_A: float


class HasMoments(Protocol):
    """A filterpy filter: mean and covariance."""

    x: Any
    P: Any


class FilterpyFilter(FilterOfModel):
    """A filterpy filter over [soc, v1, v2, v3, h]; predict and update are the subclass's."""

    def __init__(self, model: CellModel, noise: Noise | None = None) -> None:
        super().__init__(model, noise)
        self.cell = self._tables.cell
        self._noise = self.noise.scalars(model)

    def init(self, soc0: float, soc0_std: float = 0.15) -> Any:
        """A filterpy filter with the start state and covariance of :class:`Ekf`."""
        raise NotImplementedError

    def predict(self, kf: Any, now: Interval, before: Beside) -> Beside:
        """Over one interval; what the cell carries beside after it."""
        raise NotImplementedError

    def update(
        self, kf: Any, voltage_V: float, now: Interval, inside: Inside, one: float, shared: float
    ) -> tuple[float, float]:
        """With a voltage whose variance is ``one`` times ``shared``: predicted, its variance."""
        raise NotImplementedError

    def run(self, log: CellLog, soc0: float, soc0_std: float = 0.15) -> Trace:
        """Replay a whole log, sample by sample."""
        check_is_log(log)
        kf = self.init(soc0, soc0_std)
        gaps = log.gap_rows
        current = log.interval_current_A
        temperature = known_temperature_C(self.model, log)
        noise = self._noise
        n = len(log)
        soc, std, predicted, variance = (np.empty(n) for _ in range(4))
        status = np.zeros(n, dtype=np.int32)
        previous = float(np.nan_to_num(current[0]))
        evidence = -1.0
        beside = Beside()
        for k, dt in enumerate(log.interval_s):
            now = float(current[k]) if np.isfinite(current[k]) else previous
            seen = float(seen_current(self.cell, now, previous, dt))
            unknown = seen**2 + previous**2 if gaps[k] else 0.0
            previous = now
            row = Interval(
                float(dt), seen, 0.0 if gaps[k] else seen, unknown, float(temperature[k])
            )
            warm = row.temperature_C + beside.heat_K
            if k == 0:
                self._branches(kf, row, Inside(warm, 0.0))
            if gaps[k]:
                kf.P[0, 0] += unseen_soc(noise, self.cell.charge_As, unknown, float(dt)) ** 2
            beside = self.predict(kf, row, beside)
            inside = Inside(warm, beside.slow_A)
            beyond = is_outside(noise.valid, float(kf.x[0]), row.temperature_C, seen)
            status[k] = OUTSIDE if beyond else 0
            one = self.voltage_variance(kf.x, seen, inside, row.temperature_C if beyond else None)
            resting = abs(seen) < REST_RATE * self.model.capacity_Ah
            shared, below = repeated_evidence(noise, evidence, float(dt), resting)
            repeats = shared / below if below > 0.0 else np.inf
            if not np.isfinite(log.voltage_V[k]):
                repeats = np.inf
            else:
                evidence = max(evidence, 0.0)
            predicted[k], variance[k] = self.update(
                kf, float(log.voltage_V[k]), row, inside, one, repeats
            )
            if evidence >= 0.0:
                evidence += float(dt)
            kf.x[0] = min(max(kf.x[0], 0.0), 1.0)
            kf.x[4] = min(max(kf.x[4], -1.0), 1.0)
            soc[k], std[k] = kf.x[0], np.sqrt(kf.P[0, 0])
        innovation = log.voltage_V - predicted
        ratio = innovation**2 / (self.noise.gate**2 * variance)
        return Trace(log.time_s, soc, std, predicted, innovation, variance, ratio, status)

    def begin(self, kf: HasMoments, soc0: float, soc0_std: float) -> None:
        """The start of :class:`Ekf`, its branches still empty."""
        start = self.start(soc0, soc0_std)
        kf.x = np.array([soc0, 0.0, 0.0, 0.0, 1.0 if soc0 > 0.5 else -1.0])
        kf.P = np.diag([start.variance, 0.0, 0.0, 0.0, start.hysteresis_variance])

    def _branches(self, kf: HasMoments, row: Interval, inside: Inside) -> None:
        point = self.point(float(kf.x[0]), row.seen_A, inside)
        for j, r in enumerate((point.r1_ohm, point.r2_ohm, point.r3_ohm), start=1):
            kf.x[j], kf.P[j, j] = start_branch(self.cell, float(r), row.seen_A)

    def point(self, soc: float, current_A: float, inside: Inside) -> CellPoint:
        """The tables at one SOC, under load."""
        return loaded(self._tables, soc, inside.warm_C, current_A, inside.slow_A)

    def transition(self, x: FloatArray, now: Interval, before: Beside) -> CellState:
        """The model's own step of a whole state."""
        state = CellState._make((*(float(v) for v in x), *before))
        after, _ = advance(self._tables, state, now.flow_A, now.dt_s, now.temperature_C)
        return after

    def process(self, soc: float, now: Interval, inside: Inside) -> tuple[FloatArray, FloatArray]:
        """Diagonal of the transition, shape (5,), and process noise, shape (5, 5)."""
        noise, cell = self.noise, self.cell
        point = self.point(soc, now.seen_A, inside)
        t = transition(cell, point, now.flow_A, now.dt_s)
        r = np.array([point.r1_ohm, point.r2_ohm, point.r3_ohm])
        a = np.array([t.a1, t.a2, t.a3])
        g = np.array([t.gs, t.g1, t.g2, t.g3, 0.0])
        walk = noise.scalars().soc_per_sqrt_s ** 2 * now.dt_s
        branch = (share_at(self._noise, now.flow_A) * now.flow_A * r) ** 2 * (1 - a * a)
        q = noise.current_A**2 * np.outer(g, g) + np.diag([walk, *branch, 0.0])
        branches = np.array([0.0, *g[1:]])
        q += now.gap_A2 * np.outer(branches, branches)
        return np.array([1.0, *a, t.ah]), q

    def voltage(self, x: FloatArray, current_A: float, inside: Inside) -> float:
        """Terminal voltage of a state."""
        state = CellState._make((*(float(v) for v in x), *Beside()))
        return float(voltage_of(self.point(state.soc, current_A, inside), state, current_A))

    def voltage_variance(
        self, x: FloatArray, current_A: float, inside: Inside, outside_C: float | None = None
    ) -> float:
        """Variance of one voltage about a perfect state; beyond the model's data it is wider."""
        point = self.point(float(x[0]), current_A, inside)
        held = float(np.abs(x[1:4]).sum())
        noise = self._noise
        if outside_C is not None:
            drop = abs(float(point.r0_ohm) * current_A) + held
            point = widened(point, extrapolation_V(noise.valid, outside_C, current_A, drop))
        return float(voltage_variance(noise, point, point.r0_ohm, current_A, 0.0, held))


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
