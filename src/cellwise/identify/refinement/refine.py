"""Refinement: least squares of the simulated voltage over whole logs, with smooth tables.

Pulses of ten seconds cannot see slow dynamics, and a table read off single pulses need not add up
over a drive. So all tables are fitted at once to the voltage of whole logs (HPPC with its rests,
capacity tests, drives), as splines over SOC: ln R and ln tau (positive by construction), a
correction of the OCV, and scalars. Levenberg-Marquardt with analytic sensitivities.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.identify.refinement.refine_data import PreparedLog, RefineLog, prepare_log
from cellwise.identify.refinement.refine_kernels import (
    ACTIVATION_UNIT_K,
    SKEW_UNIT_S,
    Layout,
    scalars_of,
)
from cellwise.identify.refinement.refine_kernels import voltage_and_jacobian as kernel
from cellwise.identify.refinement.splines import (
    OCV_KNOTS,
    TABLE_KNOTS,
    curvature_penalty,
    greville,
    spline_count,
)
from cellwise.typing import FloatArray

LEAST_RATIO = 2.0  # between neighbouring time constants, at every knot
TAU_LIMITS_S = (0.05, 30_000.0)
R_LIMITS_OHM = (1e-7, 10.0)
LARGEST_STEP = 0.7  # of a logarithm in one iteration: a factor of two


@dataclass(frozen=True)
class RefineSettings:
    """How far the data may pull the tables.

    Parameters
    ----------
    branches : int            2, or 3 with the slow branch
    hysteresis : bool         fit M(soc) and gamma
    activation_K, activation_std_K : float   prior of the Arrhenius activation; a standard
                              deviation of 0 keeps it
    skew : bool               fit the sampling delay of the logs that may have one
    smooth : float            weight of the tables' curvature, in units of the residual variance
    ocv_smooth, ocv_size : float      weight of the OCV correction's curvature and size [V^-2]
    hold : float              weight of the start values, for what the data do not determine
    robust : float            residuals beyond this many standard deviations count linearly
    iterations : int
    """

    branches: int = 3
    hysteresis: bool = False
    activation_K: float = 2000.0
    activation_std_K: float = 1000.0
    skew: bool = True
    smooth: float = 0.01
    ocv_smooth: float = 1e-3
    ocv_size: float = 1e-6
    hold: float = 1e-3
    robust: float = 10.0
    iterations: int = 40


@dataclass(frozen=True, eq=False)
class StartTables:
    """Where refinement starts: base OCV over SOC, and constants or values at the table knots."""

    ocv: Callable[[FloatArray], FloatArray]
    r0_ohm: FloatArray
    r_ohm: tuple[FloatArray, ...]
    tau_s: tuple[FloatArray, ...]
    m_V: FloatArray | None = None
    gamma: float = 50.0


@dataclass(frozen=True, eq=False)
class RefineResult:
    """The fitted parameter vector and what it left.

    ``theta`` and ``theta_std`` follow ``layout``; ``rmse_V`` has one entry per log over its
    compared rows; ``residual_V`` and ``residual_time_s`` hold those rows.
    """

    layout: Layout
    knots: FloatArray
    ocv_knots: FloatArray
    theta: FloatArray
    theta_std: FloatArray
    rmse_V: tuple[float, ...]
    residual_V: tuple[FloatArray, ...]
    logs: tuple[PreparedLog, ...]
    reference_C: float
    sigma_V: float
    iterations: int
    seconds: float

    @property
    def activation_K(self) -> float:
        """Fitted Arrhenius activation [K]."""
        return float(self.theta[self.layout.activation] * ACTIVATION_UNIT_K)

    @property
    def skew_s(self) -> float:
        """Fitted skew between current and voltage [s]."""
        return float(self.theta[self.layout.skew] * SKEW_UNIT_S)


def refine(
    logs: Sequence[RefineLog],
    start: StartTables,
    *,
    settings: RefineSettings | None = None,
    capacity_Ah: float,
    reference_C: float = 25.0,
    knots: FloatArray = TABLE_KNOTS,
    ocv_knots: FloatArray = OCV_KNOTS,
    progress: Callable[[int, float], None] | None = None,
) -> RefineResult:
    """Fit the tables to the voltage of whole logs.

    Parameters
    ----------
    logs : sequence of RefineLog      every log has the weight of its mean squared error
    start : StartTables
    capacity_Ah : float               for the hysteresis' rate
    progress : callable or None       called with the iteration and the RMSE [V] after each step

    Returns
    -------
    RefineResult
    """
    began = time.perf_counter()
    settings = RefineSettings() if settings is None else settings
    layout = Layout(
        spline_count(ocv_knots), spline_count(knots), settings.branches, settings.hysteresis
    )
    prepared = tuple(prepare_log(item, knots, ocv_knots, reference_C) for item in logs)
    problem = _Problem(prepared, start, settings, layout, knots, ocv_knots, 3600.0 * capacity_Ah)
    theta = problem.start_vector()
    sigma = 0.01
    steps = 0
    # The first pass finds the size of the residual, which scales smoothing and robustness.
    for share in (0.4, 1.0):
        theta, done = problem.minimise(
            theta, sigma, max(3, int(share * settings.iterations)), progress
        )
        steps += done
        sigma = max(problem.robust_sigma(theta), 2e-4)
    residuals = problem.residuals(theta)
    return RefineResult(
        layout=layout,
        knots=knots,
        ocv_knots=ocv_knots,
        theta=theta,
        theta_std=problem.standard_errors(theta, sigma),
        rmse_V=tuple(float(np.sqrt(np.mean(r * r))) for r in residuals),
        residual_V=residuals,
        logs=prepared,
        reference_C=reference_C,
        sigma_V=sigma,
        iterations=steps,
        seconds=time.perf_counter() - began,
    )


class _Problem:
    """Cost, gradient and Gauss-Newton matrix of the refinement."""

    def __init__(
        self,
        logs: tuple[PreparedLog, ...],
        start: StartTables,
        settings: RefineSettings,
        layout: Layout,
        knots: FloatArray,
        ocv_knots: FloatArray,
        charge_As: float,
    ) -> None:
        self.logs = logs
        self.start = start
        self.settings = settings
        self.layout = layout
        self.soc = greville(knots)
        self.table_curvature = curvature_penalty(knots)
        self.ocv_curvature = curvature_penalty(ocv_knots)
        self.charge_As = charge_As
        self.base_ocv = tuple(start.ocv(log.soc) for log in logs)
        most = max(log.compared for log in logs)
        self._jacobian = np.empty((most, layout.size))
        self._voltage = np.empty(max(log.dt_s.size for log in logs))
        weights = np.array([log.weight for log in logs])
        self.share = weights / weights.sum()

    def start_vector(self) -> FloatArray:
        """Start values as a parameter vector."""
        lay, start = self.layout, self.start
        theta = np.zeros(lay.size)
        theta[lay.r0 : lay.r0 + lay.knots] = np.log(start.r0_ohm)
        for j in range(lay.branches):
            theta[lay.r(j) : lay.r(j) + lay.knots] = np.log(start.r_ohm[j])
            theta[lay.tau(j) : lay.tau(j) + lay.knots] = np.log(start.tau_s[j])
        if lay.hysteresis:
            theta[lay.m : lay.m + lay.knots] = 0.0 if start.m_V is None else start.m_V
            theta[lay.gamma] = np.log(start.gamma)
        theta[lay.activation] = self.settings.activation_K / ACTIVATION_UNIT_K
        return self._inside(theta)

    def evaluate(self, index: int, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residual (measured minus model) and Jacobian of one log's compared rows."""
        log, lay = self.logs[index], self.layout
        jacobian = self._jacobian[: log.compared]
        voltage = self._voltage[: log.dt_s.size]
        skewed = log.skewed and self.settings.skew
        kernel(
            log.dt_s,
            log.current_A,
            log.inverse_K,
            scalars_of(lay, theta, self.charge_As, skewed=skewed),
            log.h0,
            skewed,
            log.rows.first,
            log.rows.values,
            log.ocv_rows.first,
            log.ocv_rows.values,
            self.base_ocv[index],
            theta,
            lay.knots_ocv,
            lay.knots,
            lay.branches,
            lay.hysteresis,
            log.evaluate,
            jacobian,
            voltage,
        )
        return log.measured_V - voltage[log.evaluate], jacobian

    def residuals(self, theta: FloatArray) -> tuple[FloatArray, ...]:
        """Residuals of every log."""
        return tuple(self.evaluate(i, theta)[0] for i in range(len(self.logs)))

    def robust_sigma(self, theta: FloatArray) -> float:
        """Residual size that outliers do not move: 1.48 times the median, mean over the logs."""
        each = [1.4826 * float(np.median(np.abs(r))) for r in self.residuals(theta)]
        return float(np.sqrt(np.average(np.square(each), weights=self.share)))

    def penalty(self, sigma: float) -> FloatArray:
        """Quadratic penalty of smoothness; the parameters of a block share one matrix."""
        lay, s = self.layout, self.settings
        matrix = np.zeros((lay.size, lay.size))
        n = lay.knots_ocv
        matrix[:n, :n] = s.ocv_smooth * self.ocv_curvature + s.ocv_size * np.eye(n)
        for at in self._blocks():
            part = slice(at, at + lay.knots)
            matrix[part, part] += s.smooth * sigma**2 * self.table_curvature
        if lay.hysteresis:
            part = slice(lay.m, lay.m + lay.knots)
            matrix[part, part] += s.ocv_smooth * self.table_curvature
        return matrix

    def prior(self, sigma: float) -> FloatArray:
        """Diagonal weight that holds parameters at their start values."""
        lay, s = self.layout, self.settings
        weight = np.zeros(lay.size)
        weight[lay.r0 : lay.r0 + lay.knots * (1 + 2 * lay.branches)] = s.hold * sigma**2
        if lay.hysteresis:
            weight[lay.gamma] = 0.1 * sigma**2
        fixed = 1e6 * sigma**2
        std = s.activation_std_K / ACTIVATION_UNIT_K
        weight[lay.activation] = fixed if std == 0 else (0.3 * sigma) ** 2 / std**2
        weight[lay.skew] = 1e-2 * sigma**2 if s.skew else fixed
        return weight

    def normal_equations(
        self, theta: FloatArray, sigma: float
    ) -> tuple[float, FloatArray, FloatArray, float]:
        """Robust cost, gradient, Gauss-Newton matrix, and plain mean square [V^2]."""
        lay = self.layout
        matrix = np.zeros((lay.size, lay.size))
        gradient = np.zeros(lay.size)
        cost = 0.0
        square = 0.0
        scale = self.settings.robust * sigma
        for i, share in enumerate(self.share):
            r, jacobian = self.evaluate(i, theta)
            root = np.sqrt(1.0 + (r / scale) ** 2)
            w = share / (r.size * root)
            weighted = jacobian * w[:, None]
            matrix += weighted.T @ jacobian
            gradient += weighted.T @ r
            cost += share * float(np.mean(2.0 * scale**2 * (root - 1.0)))
            square += share * float(np.mean(r * r))
        return cost, gradient, matrix, square

    def minimise(
        self,
        theta: FloatArray,
        sigma: float,
        iterations: int,
        progress: Callable[[int, float], None] | None,
    ) -> tuple[FloatArray, int]:
        """Levenberg-Marquardt with bounds by projection."""
        penalty, prior = self.penalty(sigma), self.prior(sigma)
        anchor = self.start_vector()

        def total(cost: float, at: FloatArray) -> float:
            return cost + float(at @ penalty @ at + prior @ (at - anchor) ** 2)

        cost, gradient, matrix, square = self.normal_equations(theta, sigma)
        best = total(cost, theta)
        damping = 1e-3
        for step in range(iterations):
            system = matrix + penalty + np.diag(prior)
            slope = gradient - penalty @ theta - prior * (theta - anchor)
            move = np.linalg.solve(system + damping * np.diag(np.diag(system)), slope)
            trial = self._inside(theta + np.clip(move, -LARGEST_STEP, LARGEST_STEP))
            cost, g, m, s = self.normal_equations(trial, sigma)
            value = total(cost, trial)
            if value < best:
                gain = (best - value) / best
                theta, best, gradient, matrix, square = trial, value, g, m, s
                damping = max(damping / 5.0, 1e-9)
                if progress is not None:
                    progress(step, float(np.sqrt(square)))
                if gain < 2e-4:
                    return theta, step + 1
            else:
                damping *= 8.0
                if damping > 1e6:
                    return theta, step + 1
        return theta, iterations

    def standard_errors(self, theta: FloatArray, sigma: float) -> FloatArray:
        """Standard error of every parameter.

        Every log counts with its own residual and that residual's own correlation, because a short
        log has the weight of a long one: A^-1 (sum of share_i s_i^2 / n_i A_i) A^-1, not A^-1.
        """
        held = self.penalty(sigma) + np.diag(self.prior(sigma))
        system, middle = held.copy(), np.zeros_like(held)
        mean_variance = 0.0
        for i, share in enumerate(self.share):
            r, jacobian = self.evaluate(i, theta)
            w = 1.0 / np.sqrt(1.0 + (r / (self.settings.robust * sigma)) ** 2)
            information = share / r.size * (jacobian * w[:, None]).T @ jacobian
            variance = share * float(np.mean(w * r * r)) / independent_samples(r)
            system += information
            middle += variance * information
            mean_variance += share * variance
        inverse = np.linalg.pinv(system)
        covariance = inverse @ (middle + mean_variance * held) @ inverse
        return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))

    def _blocks(self) -> list[int]:
        lay = self.layout
        branches = range(lay.branches)
        return [lay.r0, *(lay.r(j) for j in branches), *(lay.tau(j) for j in branches)]

    def _inside(self, theta: FloatArray) -> FloatArray:
        """Project on the bounds: positive sizes, time constants in order at every knot."""
        lay = self.layout
        theta = theta.copy()
        low, high = np.log(R_LIMITS_OHM)
        for at in (lay.r0, *(lay.r(j) for j in range(lay.branches))):
            block = theta[at : at + lay.knots]
            np.clip(block, low, high, out=block)
        low, high = np.log(TAU_LIMITS_S)
        floor = np.full(lay.knots, low)
        for j in range(lay.branches):
            block = theta[lay.tau(j) : lay.tau(j) + lay.knots]
            # B-splines are positive and sum to one: ordered coefficients give ordered tables.
            np.clip(block, floor, high, out=block)
            floor = block + np.log(LEAST_RATIO)
        if lay.hysteresis:
            block = theta[lay.m : lay.m + lay.knots]
            np.clip(block, 0.0, 0.5, out=block)
            theta[lay.gamma] = np.clip(theta[lay.gamma], np.log(0.5), np.log(5000.0))
        theta[lay.activation] = np.clip(theta[lay.activation], -2.0, 15.0)
        theta[lay.skew] = max(theta[lay.skew], 0.0)
        return theta


def independent_samples(residual: FloatArray) -> float:
    """Number of independent values that a correlated series is worth.

    n / (1 + 2 sum of autocorrelations), summed up to the first that is not positive.
    """
    r = residual - np.mean(residual)
    n = r.size
    power = float(r @ r)
    if n < 8 or power == 0.0:
        return float(n)
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(r, size)
    correlation = np.fft.irfft(spectrum * np.conj(spectrum), size)[: n // 2] / power
    end = int(np.argmax(correlation <= 0.0)) or correlation.size
    return float(max(n / (1.0 + 2.0 * float(np.sum(correlation[1:end]))), 1.0))
