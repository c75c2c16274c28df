"""Cost, gradient and Gauss-Newton matrix of the refinement, and its Levenberg-Marquardt."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from os import cpu_count
from typing import NamedTuple

import numpy as np

from cellwise.cell.initial_soc.rest import RELAXED_S
from cellwise.identify.refinement.layout import (
    ACTIVATION_UNIT_K,
    LEAST_RATIO,
    OWN_CAPACITY,
    RefineSettings,
    StartTables,
    layout_of,
    limits,
    scalars_of,
    start_vector,
)
from cellwise.identify.refinement.refine_data import ROWS, RefineLog, inverse_K, prepare_log
from cellwise.identify.refinement.refine_kernels import voltage_and_jacobian
from cellwise.identify.refinement.splines import (
    OCV_KNOTS,
    TABLE_KNOTS,
    curvature_penalty,
    second_differences,
)
from cellwise.typing import FloatArray

LARGEST_STEP = 0.7  # of a logarithm in one iteration: a factor of two
LEAST_SIGMA_V = 2e-4
LEAST_PAST_V = 0.01  # what a past that nobody saw may have left in any case


class _Normal(NamedTuple):
    """Robust cost, gradient, Gauss-Newton matrix, and the residuals of every log."""

    cost: float
    gradient: FloatArray
    matrix: FloatArray
    residuals: tuple[FloatArray, ...]


class Problem:
    """Cost, gradient and Gauss-Newton matrix of the refinement.

    ``sizes_V`` is how well each log can be fitted, a standard deviation of its residual; ``sigma``
    that of the logs that are fitted best, which scales what holds and smooths the tables.

    Parameters
    ----------
    capacity_Ah : float               for the hysteresis' rate
    grid_C : (temperatures,) float    with tables of their own, ascending
    most_rows : int                   compared rows of one log at most
    """

    def __init__(
        self,
        logs: Sequence[RefineLog],
        start: StartTables,
        settings: RefineSettings,
        capacity_Ah: float,
        grid_C: FloatArray,
        reference_C: float,
        most_rows: int = ROWS.most,
    ) -> None:
        self.logs = tuple(
            prepare_log(item, reference_C, grid_C, capacity_Ah, most_rows) for item in logs
        )
        self.start, self.settings = start, settings
        self.charge_As = 3600.0 * capacity_Ah
        self.grid_C, self.reference_C = grid_C, reference_C
        self.begun = [k for k, item in enumerate(logs) if item.start_std > 0.0]
        self.layout = lay = layout_of(settings, int(grid_C.size), len(self.begun))
        self.layouts = tuple(lay.of_temperatures(log.temperatures) for log in self.logs)
        self.places = tuple(lay.part(log.first_temperature, log.temperatures) for log in self.logs)
        moved = [self.logs[k].soc for k in self.begun]
        self.low, self.high = limits(lay, settings, self.charge_As, moved)
        past_V = [logs[k].past_V for k in self.begun]
        self.anchor = self.inside(start_vector(lay, start, settings, past_V))
        weights = np.array([item.weight for item in logs])
        self.weight = self.share = weights / weights.sum()
        self.sizes_V = np.full(len(logs), 0.01)
        self.own_capacity_std = np.full(lay.samples, OWN_CAPACITY.others)
        self.level_V = np.full(lay.starts, 0.01)

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
        self.level_V = np.array([float(np.sqrt(np.mean(residuals[k] ** 2))) for k in self.begun])
        worse = np.maximum(self.sizes_V / self.sigma, 1.0)
        self.share = self.weight / worse**self.settings.balance

    def evaluate(self, index: int, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residual (measured minus model) and Jacobian of one log's compared rows and places."""
        log, lay, own = self.logs[index], self.layouts[index], theta[self.places[index]]
        voltage, jacobian = self._simulated(index, own)
        begun = self.begun.index(index) if index in self.begun else None
        moving = [] if log.item.sample is None else [lay.sample + log.item.sample]
        moving += [] if begun is None else [lay.start + begun]
        for at in moving:
            beside = own.copy()
            beside[at] += OWN_CAPACITY.step
            jacobian[:, at] = (self._simulated(index, beside)[0] - voltage) / OWN_CAPACITY.step
        if begun is not None:
            fading = np.exp(-(log.time_s - log.time_s[0]) / RELAXED_S)
            jacobian[:, lay.past + begun] = -fading
            voltage -= own[lay.past + begun] * fading
        return log.measured_V - voltage, jacobian

    def _simulated(self, index: int, own: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Voltage of the compared rows and its Jacobian.

        Where a log's cell holds more charge than the model's, what flows moves its SOC by as much
        less.
        """
        log, lay = self.logs[index], self.layouts[index]
        rows, soc = log.rows, log.soc
        if log.item.sample is not None or index in self.begun:
            if log.item.sample is not None:
                soc = soc + (soc - soc[0]) * math.expm1(-own[lay.sample + log.item.sample])
            if index in self.begun:
                soc = soc + own[lay.start + self.begun.index(index)]
            rows = log.moved(soc - log.soc)
        jacobian = np.empty((log.compared, lay.size))
        voltage = np.empty(soc.size)
        skewed = log.item.skewed and self.settings.skew
        cell = scalars_of(lay, own, self.charge_As, skewed=skewed)
        base_V = self.start.ocv(soc)
        voltage_and_jacobian(rows, base_V, cell, lay, log.item.h0, skewed, own, jacobian, voltage)
        return voltage[rows.evaluate], jacobian

    def residuals(self, theta: FloatArray) -> tuple[FloatArray, ...]:
        """Residuals of every log."""
        return tuple(self.evaluate(i, theta)[0] for i in range(len(self.logs)))

    def penalty(self, sigma: float) -> FloatArray:
        """Quadratic penalty of smoothness over SOC and temperature."""
        lay, s = self.layout, self.settings
        matrix = np.zeros((lay.size, lay.size))
        n = lay.knots_ocv
        along = np.kron(np.eye(lay.temperatures), curvature_penalty(TABLE_KNOTS))
        # Over 1/T per step of 15 K at room temperature.
        bend = second_differences(inverse_K(self.grid_C, self.reference_C))
        bend *= abs(float(inverse_K(25.0, 10.0)))
        across = np.kron(bend.T @ bend, np.eye(lay.knots))
        for at in lay.tables():
            part = slice(at, at + lay.block)
            matrix[part, part] = sigma**2 * (s.smooth * along + s.straight * across)
        matrix[:n, :n] = s.ocv_smooth * curvature_penalty(OCV_KNOTS) + s.ocv_size * np.eye(n)
        if lay.hysteresis:
            matrix[lay.m : lay.gamma, lay.m : lay.gamma] = s.ocv_smooth * along
        return matrix

    def prior(self, sigma: float) -> FloatArray:
        """Diagonal weight that holds parameters at their start values."""
        lay, s = self.layout, self.settings
        items = [self.logs[k].item for k in self.begun]
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
        weight[lay.start : lay.past] = (self.level_V / [item.start_std for item in items]) ** 2
        past_V = np.maximum(np.abs([item.past_V for item in items]), LEAST_PAST_V)
        weight[lay.past :] = (self.level_V / past_V) ** 2
        weight[lay.skew] = 1e-2 * sigma**2 if s.skew else fixed
        weight[lay.asinh] = 1e-2 * sigma**2 if s.charge_transfer else fixed
        return weight

    def _robust(self, index: int, residual_V: FloatArray) -> FloatArray:
        """By how much a large residual counts less than its square, the root of it."""
        scale = self.settings.robust * self.sizes_V[index]
        return np.asarray(np.sqrt(1.0 + (residual_V / scale) ** 2))

    def _one(
        self, index: int, theta: FloatArray
    ) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Cost, gradient, matrix and residual of one log."""
        r, jacobian = self.evaluate(index, theta)
        scale = self.settings.robust * self.sizes_V[index]
        root = self._robust(index, r)
        share = self.share[index]
        w = share / (r.size * root)
        gradient = jacobian.T @ (w * r)
        jacobian *= np.sqrt(w)[:, None]
        cost = share * float(np.mean(2.0 * scale**2 * (root - 1.0)))
        return cost, gradient, jacobian.T @ jacobian, r

    def normal_equations(self, theta: FloatArray) -> _Normal:
        """Everything that an iteration needs; the logs run side by side."""
        matrix = np.zeros((theta.size, theta.size))
        gradient = np.zeros(theta.size)
        cost = 0.0
        residuals = []
        with ThreadPoolExecutor(max(1, min(4, cpu_count() or 1))) as pool:
            found = pool.map(lambda i: self._one(i, theta), range(len(self.logs)))
            for places, (part, g, m, r) in zip(self.places, found, strict=True):
                cost += part
                gradient[places] += g
                matrix[np.ix_(places, places)] += m
                residuals.append(r)
        return _Normal(cost, gradient, matrix, tuple(residuals))

    def minimise(
        self, theta: FloatArray, iterations: int
    ) -> tuple[FloatArray, int, tuple[FloatArray, ...]]:
        """Levenberg-Marquardt with bounds by projection."""
        sigma = self.sigma
        penalty, prior = self.penalty(sigma), self.prior(sigma)
        anchor = self.anchor

        def total(cost: float, at: FloatArray) -> float:
            return cost + float(at @ penalty @ at + prior @ (at - anchor) ** 2)

        now = self.normal_equations(theta)
        best = total(now.cost, theta)
        damping = 1e-3
        for step in range(iterations):
            system = now.matrix + penalty + np.diag(prior)
            slope = now.gradient - penalty @ theta - prior * (theta - anchor)
            move = np.linalg.solve(system + damping * np.diag(np.diag(system)), slope)
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
            _, _, information, r = self._one(i, theta)
            variance = share * float(np.mean(r * r / self._robust(i, r))) / independent_samples(r)
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
        theta = np.clip(theta, self.low, self.high)
        for j in range(1, lay.branches):
            # B-splines are positive and sum to one: ordered coefficients give ordered tables.
            faster, slower = (theta[at : at + lay.block] for at in (lay.tau(j - 1), lay.tau(j)))
            np.maximum(slower, faster + np.log(LEAST_RATIO), out=slower)
        return theta


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
