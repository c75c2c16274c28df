"""Cost, gradient and Gauss-Newton matrix of the refinement, and its Levenberg-Marquardt."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from os import cpu_count
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.linalg.blas import dsyrk

from cellwise.cell.initial_soc.rest import RELAXED_S
from cellwise.identify.ocv.curve import LIMITS as BATCH
from cellwise.identify.refinement.layout import (
    ACTIVATION_UNIT_K,
    ASINH_UNIT_PER_V,
    Layout,
    scalars_of,
)
from cellwise.identify.refinement.refine_data import PreparedLog, inverse_K
from cellwise.identify.refinement.refine_kernels import Blocks
from cellwise.identify.refinement.refine_kernels import voltage_and_jacobian as kernel
from cellwise.identify.refinement.splines import curvature_penalty, spline_rows
from cellwise.typing import FloatArray

LEAST_RATIO = 2.0  # between neighbouring time constants, at every knot
TAU_LIMITS_S = (0.05, 30_000.0)
R_LIMITS_OHM = (1e-7, 10.0)
LARGEST_DROP_V = 10.0  # of one resistance at 1C: where nothing was measured it may run up
LARGEST_STEP = 0.7  # of a logarithm in one iteration: a factor of two
LEAST_SIGMA_V = 2e-4
LEAST_PAST_V = 0.01  # what a past that nobody saw may have left in any case
# OCV between temperatures: what the entropy of intercalation leaves room for.
ENTROPY_V_PER_K = 4e-4
OWN_LIMITS = (-6.0, 6.0)  # of a table's own activation, in units of ACTIVATION_UNIT_K


class OwnCapacity(NamedTuple):
    """What is known beforehand of ln of the capacity that a log keeps over the model's.

    Samples of one batch differ by ``batch``, those of others or of another age by ``others``, one
    deviation each. Every log is first taken for one of others, or an aged one would bend the tables
    and stay hidden; found beyond ``same`` it remains one. ``limits``: an aged cell keeps a half;
    ``step`` is that of a difference quotient.
    """

    batch: float = 0.01
    others: float = 0.2
    same: float = BATCH.other_capacity
    limits: tuple[float, float] = (-0.7, 0.4)
    step: float = 1e-4


OWN_CAPACITY = OwnCapacity()


@dataclass(frozen=True)
class RefineSettings:
    """How far the data may pull the tables.

    Parameters
    ----------
    branches : int            2, or 3 with the slow branch
    hysteresis : bool         fit M(soc) and gamma
    charge_transfer : bool    fit the asinh law of the fast branch
    activation_K, activation_std_K : float   prior of the Arrhenius activation; a standard
                              deviation of 0 keeps it; with several temperatures it is not fitted
    own_activation_std_K : float      how far the activation of each resistance and time constant
                              may be from the common one; 0: not fitted
    skew : bool               fit the sampling delay of the logs that may have one
    samples : int             logs that keep a capacity of their own
    smooth : float            weight of the tables' curvature, in units of the residual variance
    straight : float          weight of their curvature over 1/T, where 0 is one activation energy
    ocv_smooth, ocv_size : float      weight of the OCV correction's curvature and size [V^-2]
    hold : float              weight of the start values, for what the data do not determine
    robust : float            residuals beyond this many standard deviations count linearly
    balance : float           0: every log has one weight; 1: one that is fitted worse counts less
    iterations : int
    """

    branches: int = 3
    hysteresis: bool = False
    charge_transfer: bool = False
    activation_K: float = 2000.0
    activation_std_K: float = 1000.0
    own_activation_std_K: float = 0.0
    skew: bool = True
    samples: int = 0
    smooth: float = 0.01
    straight: float = 0.01
    ocv_smooth: float = 1e-3
    ocv_size: float = 1e-6
    hold: float = 1e-3
    robust: float = 10.0
    balance: float = 0.0
    iterations: int = 40


@dataclass(frozen=True, eq=False)
class StartTables:
    """Where refinement starts: base OCV over SOC, and values at the table knots.

    Every table has shape (knots,), or (temperatures, knots).
    """

    ocv: Callable[[FloatArray], FloatArray]
    r0_ohm: FloatArray
    r_ohm: tuple[FloatArray, ...]
    tau_s: tuple[FloatArray, ...]
    m_V: FloatArray | None = None
    gamma: float = 50.0
    asinh_per_V: float = 4.0


@dataclass(frozen=True, eq=False)
class _Normal:
    """Robust cost, gradient, Gauss-Newton matrix, and the residuals of every log."""

    cost: float
    gradient: FloatArray
    matrix: FloatArray
    residuals: tuple[FloatArray, ...]


class Problem:
    """Cost, gradient and Gauss-Newton matrix of the refinement.

    ``sizes_V`` is how well each log can be fitted, a standard deviation of its residual; ``sigma``
    that of the logs that are fitted best, which scales what holds and smooths the tables.
    """

    def __init__(
        self,
        logs: Sequence[PreparedLog],
        start: StartTables,
        settings: RefineSettings,
        layout: Layout,
        knots: FloatArray,
        ocv_knots: FloatArray,
        charge_As: float,
        grid_C: FloatArray,
        reference_C: float,
    ) -> None:
        self.logs = tuple(logs)
        self.start = start
        self.settings = settings
        self.layout = layout
        self.table_curvature = curvature_penalty(knots)
        self.ocv_curvature = curvature_penalty(ocv_knots)
        self.knots, self.ocv_knots = knots, ocv_knots
        self.charge_As = charge_As
        self.grid_C, self.reference_C = grid_C, reference_C
        self.base_ocv = tuple(start.ocv(log.soc) for log in self.logs)
        self.places = tuple(
            layout.part(log.first_temperature, log.temperatures) for log in self.logs
        )
        self.layouts = tuple(layout._replace(temperatures=log.temperatures) for log in self.logs)
        weights = np.array([log.weight for log in self.logs])
        self.weight = weights / weights.sum()
        self.share = self.weight
        self.sizes_V = np.full(len(self.logs), 0.01)
        self.own_capacity_std = np.full(layout.samples, OWN_CAPACITY.others)
        self.start_logs = [k for k, log in enumerate(self.logs) if log.start_std > 0.0]
        self.start_std = np.array([self.logs[k].start_std for k in self.start_logs])
        self.level_V = np.full(len(self.start_logs), 0.01)
        past_V = np.abs([self.logs[k].past_V for k in self.start_logs])
        self.past_std_V = np.maximum(past_V, LEAST_PAST_V)
        # Nowhere beyond full or empty, as far as a counter and a capacity are sure of that.
        seen = [self.logs[k].soc for k in self.start_logs]
        self.start_limits = np.array([(-max(s.min(), 0.0), 1.0 - s.max()) for s in seen])
        self.start_limits = self.start_limits.reshape(-1, 2).T

    @property
    def sigma(self) -> float:
        """Residual of the logs that are fitted best: the lower quartile [V]."""
        return max(float(np.percentile(self.sizes_V, 25.0)), LEAST_SIGMA_V)

    def judge(self, theta: FloatArray, residuals: Sequence[FloatArray]) -> None:
        """Take the size and share of every log's residual, and whether it is of another cell."""
        other = np.abs(theta[self.layout.sample : self.layout.start]) > OWN_CAPACITY.same
        self.own_capacity_std = np.where(other, OWN_CAPACITY.others, OWN_CAPACITY.batch)
        self.sizes_V = np.array(
            [max(1.4826 * float(np.median(np.abs(r))), LEAST_SIGMA_V) for r in residuals]
        )
        self.level_V = np.array(
            [float(np.sqrt(np.mean(residuals[k] ** 2))) for k in self.start_logs]
        )
        worse = np.maximum(self.sizes_V / self.sigma, 1.0)
        self.share = self.weight / worse**self.settings.balance

    def start_vector(self) -> FloatArray:
        """Start values as a parameter vector."""
        lay, start = self.layout, self.start
        theta = np.zeros(lay.size)

        def put(at: int, values: FloatArray) -> None:
            theta[at : at + lay.block] = np.broadcast_to(
                values, (lay.temperatures, lay.knots)
            ).ravel()

        put(lay.r0, np.log(start.r0_ohm))
        for j in range(lay.branches):
            put(lay.r(j), np.log(start.r_ohm[j]))
            put(lay.tau(j), np.log(start.tau_s[j]))
        if lay.hysteresis:
            put(lay.m, np.zeros(lay.knots) if start.m_V is None else start.m_V)
            theta[lay.gamma] = np.log(start.gamma)
        if lay.temperatures == 1:
            theta[lay.activation] = self.settings.activation_K / ACTIVATION_UNIT_K
        if self.settings.charge_transfer:
            theta[lay.asinh] = start.asinh_per_V / ASINH_UNIT_PER_V
        theta[lay.past :] = [self.logs[k].past_V for k in self.start_logs]
        return self.inside(theta)

    def evaluate(self, index: int, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residual (measured minus model) and Jacobian of one log's compared rows and places."""
        log, own = self.logs[index], theta[self.places[index]]
        lay = self.layouts[index]
        places = [] if log.sample is None else [lay.sample + log.sample]
        if index in self.start_logs:
            places.append(lay.start + self.start_logs.index(index))
        if not places:
            voltage, jacobian = self._simulated(index, own, log, self.base_ocv[index])
            return log.measured_V - voltage, jacobian
        voltage, jacobian = self._moved(index, own)
        for at in places:
            beside = own.copy()
            beside[at] += OWN_CAPACITY.step
            jacobian[:, at] = (self._moved(index, beside)[0] - voltage) / OWN_CAPACITY.step
        if index in self.start_logs:
            at = lay.past + self.start_logs.index(index)
            fading = np.exp(-(log.time_s - log.time_s[0]) / RELAXED_S)
            jacobian[:, at] = -fading
            voltage -= own[at] * fading
        return log.measured_V - voltage, jacobian

    def _moved(self, index: int, own: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Voltage and Jacobian of a log whose cell begins elsewhere or holds another charge.

        With more charge than the model's, what flows moves the SOC by as much less.
        """
        log, lay = self.logs[index], self.layouts[index]
        away = np.zeros(log.soc.size)
        if log.sample is not None:
            away += (log.soc - log.soc[0]) * math.expm1(-own[lay.sample + log.sample])
        if index in self.start_logs:
            away += own[lay.start + self.start_logs.index(index)]
        soc = log.soc + away
        moved = replace(
            log,
            rows=spline_rows(log.table_soc + away, self.knots),
            ocv_rows=spline_rows(soc, self.ocv_knots),
        )
        return self._simulated(index, own, moved, self.start.ocv(soc))

    def _simulated(
        self, index: int, own: FloatArray, log: PreparedLog, base_ocv_V: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Voltage of the compared rows and its Jacobian."""
        lay = self.layouts[index]
        jacobian = np.empty((log.compared, lay.size))
        voltage = np.empty(log.dt_s.size)
        skewed = log.skewed and self.settings.skew
        kernel(
            log.for_kernel(base_ocv_V),
            scalars_of(lay, own, self.charge_As, skewed=skewed),
            blocks_of(lay),
            log.h0,
            skewed,
            own,
            jacobian,
            voltage,
        )
        return voltage[log.evaluate], jacobian

    def residuals(self, theta: FloatArray) -> tuple[FloatArray, ...]:
        """Residuals of every log."""
        return tuple(self.evaluate(i, theta)[0] for i in range(len(self.logs)))

    def _blocks(self, at: int, weight: FloatArray, matrix: FloatArray, size: int) -> None:
        """The same weight on the coefficients of every temperature of one table."""
        for t in range(self.layout.temperatures):
            part = slice(at + t * size, at + (t + 1) * size)
            matrix[part, part] += weight

    def _straight(self, at: int, weight: float, matrix: FloatArray, size: int) -> None:
        """Weight on the curvature over 1/T of every coefficient of one table."""
        bend = self._bend()
        for a, b in np.argwhere(bend != 0.0):
            rows, columns = at + a * size + np.arange(size), at + b * size + np.arange(size)
            matrix[rows, columns] += weight * bend[a, b]

    def _bend(self) -> FloatArray:
        """Squared second divided differences over 1/T, per step of 15 K at room temperature."""
        x = inverse_K(self.grid_C, self.reference_C)
        n = x.size
        d = np.zeros((max(n - 2, 0), n))
        unit = abs(float(inverse_K(25.0, 10.0)))
        for i in range(n - 2):
            left, right = x[i + 1] - x[i], x[i + 2] - x[i + 1]
            d[i, i : i + 3] = np.array([1 / left, -1 / left - 1 / right, 1 / right]) * unit
        return np.asarray(d.T @ d)

    def penalty(self, sigma: float) -> FloatArray:
        """Quadratic penalty of smoothness over SOC and temperature."""
        lay, s = self.layout, self.settings
        matrix = np.zeros((lay.size, lay.size))
        n = lay.knots_ocv
        ocv = s.ocv_smooth * self.ocv_curvature + s.ocv_size * np.eye(n)
        matrix[:n, :n] = ocv
        for at in lay.tables():
            self._blocks(at, s.smooth * sigma**2 * self.table_curvature, matrix, lay.knots)
            self._straight(at, s.straight * sigma**2, matrix, lay.knots)
        if lay.hysteresis:
            self._blocks(lay.m, s.ocv_smooth * self.table_curvature, matrix, lay.knots)
        if lay.temperatures > 1:
            self._blocks(lay.warm, s.ocv_smooth * self.ocv_curvature, matrix, n)
            away = np.abs(self.grid_C - self.reference_C)
            home = int(np.argmin(away))
            for t, kelvin in enumerate(np.maximum(away, 1.0)):
                held = np.eye(n) * (sigma / (ENTROPY_V_PER_K * kelvin)) ** 2 / n
                part = slice(lay.warm + t * n, lay.warm + (t + 1) * n)
                matrix[part, part] += np.eye(n) if t == home else held
        return matrix

    def prior(self, sigma: float) -> FloatArray:
        """Diagonal weight that holds parameters at their start values."""
        lay, s = self.layout, self.settings
        weight = np.zeros(lay.size)
        weight[lay.r0 : lay.m] = s.hold * sigma**2
        if lay.hysteresis:
            weight[lay.gamma] = 0.1 * sigma**2
        fixed = 1e6 * sigma**2
        std = s.activation_std_K / ACTIVATION_UNIT_K
        known = std == 0 or lay.temperatures > 1
        weight[lay.activation] = fixed if known else (0.3 * sigma) ** 2 / std**2
        own = s.own_activation_std_K / ACTIVATION_UNIT_K
        weight[lay.own : lay.sample] = fixed if own == 0 else (0.3 * sigma) ** 2 / own**2
        weight[lay.sample : lay.start] = (0.3 * sigma / self.own_capacity_std) ** 2
        weight[lay.start : lay.past] = (self.level_V / self.start_std) ** 2
        weight[lay.past :] = (self.level_V / self.past_std_V) ** 2
        weight[lay.skew] = 1e-2 * sigma**2 if s.skew else fixed
        weight[lay.asinh] = 1e-2 * sigma**2 if s.charge_transfer else fixed
        return weight

    def _one(
        self, index: int, theta: FloatArray
    ) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Cost, gradient, matrix (upper triangle) and residual of one log."""
        r, jacobian = self.evaluate(index, theta)
        scale = self.settings.robust * self.sizes_V[index]
        root = np.sqrt(1.0 + (r / scale) ** 2)
        share = self.share[index]
        w = share / (r.size * root)
        gradient = jacobian.T @ (w * r)
        jacobian *= np.sqrt(w)[:, None]
        matrix = dsyrk(1.0, jacobian.T)
        return share * float(np.mean(2.0 * scale**2 * (root - 1.0))), gradient, matrix, r

    def normal_equations(self, theta: FloatArray) -> _Normal:
        """Everything that an iteration needs; the logs run side by side."""
        lay = self.layout
        upper = np.zeros((lay.size, lay.size))
        gradient = np.zeros(lay.size)
        cost = 0.0
        residuals = []
        with ThreadPoolExecutor(max(1, min(4, cpu_count() or 1))) as pool:
            found = pool.map(lambda i: self._one(i, theta), range(len(self.logs)))
            for places, (part, g, m, r) in zip(self.places, found, strict=True):
                cost += part
                gradient[places] += g
                upper[np.ix_(places, places)] += m
                residuals.append(r)
        # Places rise, so upper triangles stay upper ones.
        matrix = np.triu(upper) + np.triu(upper, 1).T
        return _Normal(cost, gradient, matrix, tuple(residuals))

    def minimise(
        self, theta: FloatArray, iterations: int
    ) -> tuple[FloatArray, int, tuple[FloatArray, ...]]:
        """Levenberg-Marquardt with bounds by projection."""
        sigma = self.sigma
        penalty, prior = self.penalty(sigma), self.prior(sigma)
        anchor = self.start_vector()

        def total(cost: float, at: FloatArray) -> float:
            return cost + float(at @ penalty @ at + prior @ (at - anchor) ** 2)

        now = self.normal_equations(theta)
        best = total(now.cost, theta)
        damping = 1e-3
        for step in range(iterations):
            system = now.matrix + penalty + np.diag(prior)
            slope = now.gradient - penalty @ theta - prior * (theta - anchor)
            move = _solved(system + damping * np.diag(np.diag(system)), slope)
            trial = self.inside(theta + np.clip(move, -LARGEST_STEP, LARGEST_STEP))
            new = self.normal_equations(trial)
            value = total(new.cost, trial)
            if value < best:
                gain = (best - value) / best
                theta, best, now = trial, value, new
                damping = max(damping / 5.0, 1e-9)
                if gain < 2e-4:
                    return theta, step + 1, now.residuals
            else:
                damping *= 8.0
                if damping > 1e6:
                    return theta, step + 1, now.residuals
        return theta, iterations, now.residuals

    def standard_errors(self, theta: FloatArray) -> FloatArray:
        """Standard error of every parameter.

        Every log counts with its own residual and that residual's own correlation, because a short
        log has the weight of a long one: A^-1 (sum of share_i s_i^2 / n_i A_i) A^-1, not A^-1.
        """
        sigma = self.sigma
        held = self.penalty(sigma) + np.diag(self.prior(sigma))
        system, middle = held.copy(), np.zeros_like(held)
        mean_variance = 0.0
        for i, share in enumerate(self.share):
            r, jacobian = self.evaluate(i, theta)
            w = 1.0 / np.sqrt(1.0 + (r / (self.settings.robust * self.sizes_V[i])) ** 2)
            information = share / r.size * (jacobian * w[:, None]).T @ jacobian
            variance = share * float(np.mean(w * r * r)) / independent_samples(r)
            at = np.ix_(self.places[i], self.places[i])
            system[at] += information
            middle[at] += variance * information
            mean_variance += share * variance
        inverse = np.linalg.pinv(system, hermitian=True)
        covariance = inverse @ (middle + mean_variance * held) @ inverse
        found = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        # A start is a level of its log, and what a model gets wrong of a level is wrong of all
        # logs of that kind: one error, as large as what the fit leaves.
        starts = slice(self.layout.start, self.layout.past)
        level = self.level_V * np.sqrt(np.maximum(np.diag(inverse)[starts], 0.0))
        found[starts] = np.hypot(found[starts], level)
        return np.asarray(found)

    def inside(self, theta: FloatArray) -> FloatArray:
        """Project on the bounds: positive sizes, time constants in order at every knot."""
        lay = self.layout
        theta = theta.copy()
        low, high = np.log(R_LIMITS_OHM)
        high = min(high, np.log(LARGEST_DROP_V * 3600.0 / self.charge_As))
        for at in (lay.r0, *(lay.r(j) for j in range(lay.branches))):
            block = theta[at : at + lay.block]
            np.clip(block, low, high, out=block)
        low, high = np.log(TAU_LIMITS_S)
        floor = np.full(lay.block, low)
        for j in range(lay.branches):
            block = theta[lay.tau(j) : lay.tau(j) + lay.block]
            # B-splines are positive and sum to one: ordered coefficients give ordered tables.
            np.clip(block, floor, high, out=block)
            floor = block + np.log(LEAST_RATIO)
        if lay.hysteresis:
            block = theta[lay.m : lay.m + lay.block]
            np.clip(block, 0.0, 0.5, out=block)
            theta[lay.gamma] = np.clip(theta[lay.gamma], np.log(0.5), np.log(5000.0))
        theta[lay.activation] = np.clip(theta[lay.activation], -2.0, 15.0)
        limits = OWN_LIMITS if self.settings.own_activation_std_K > 0.0 else (0.0, 0.0)
        np.clip(theta[lay.own : lay.sample], *limits, out=theta[lay.own : lay.sample])
        np.clip(
            theta[lay.sample : lay.start], *OWN_CAPACITY.limits, out=theta[lay.sample : lay.start]
        )
        np.clip(theta[lay.start : lay.past], *self.start_limits, out=theta[lay.start : lay.past])
        theta[lay.skew] = max(theta[lay.skew], 0.0)
        if self.settings.charge_transfer:
            theta[lay.asinh] = np.clip(theta[lay.asinh], 0.01, 20.0)
        return theta


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of a symmetric system, which is positive definite but for rounding."""
    try:
        factor = cho_factor(matrix, check_finite=False)
    except LinAlgError:
        return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
    return np.asarray(cho_solve(factor, right, check_finite=False))


def blocks_of(lay: Layout) -> Blocks:
    """A layout as numbers for the kernel."""
    return Blocks(
        lay.knots_ocv,
        lay.knots,
        lay.branches,
        lay.hysteresis,
        lay.temperatures,
        lay.m,
        lay.gamma,
        lay.warm,
        lay.activation,
        lay.skew,
        lay.asinh,
        lay.own,
    )


def independent_samples(residual: FloatArray) -> float:
    """Number of independent values that a correlated series holds.

    n / (1 + 2 sum of autocorrelations), summed up to the first that is not positive.
    """
    n = residual.size
    correlation = autocorrelation(residual - np.mean(residual), n // 2)
    if n < 8 or correlation.size == 0:
        return float(n)
    end = int(np.argmax(correlation <= 0.0)) or correlation.size
    return float(max(n / (1.0 + 2.0 * float(np.sum(correlation[1:end]))), 1.0))


def autocorrelation(r: FloatArray, lags: int) -> FloatArray:
    """Autocorrelation of an even series, shape (lags,); empty for one of zeros."""
    power = float(r @ r)
    if power == 0.0:
        return np.empty(0)
    size = 1 << (2 * r.size - 1).bit_length()
    spectrum = np.fft.rfft(r, size)
    return np.asarray(np.fft.irfft(spectrum * np.conj(spectrum), size)[:lags] / power)
