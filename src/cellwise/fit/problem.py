r"""What logs say of the unknowns of a fit: cost, gradient, Gauss-Newton matrix, evidence.

.. math:: -\ln p(\theta) = \sum_{\text{logs}} \frac{n}{m} \sum_k c^2
    \left( \sqrt{1 + (r_k / c\, \sigma_k)^2} - 1 \right)
    + \tfrac12 (\theta - \bar\theta)^T P (\theta - \bar\theta)

over the m compared rows of each log: residual r (``evaluate``), its deviation sigma (``sizes_V``),
n independent errors (``numbers``), c = ``EVIDENCE.robust``; the prior's mean and precision P.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from os import cpu_count
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from cellwise.fit.rows import ROWS, BaseOcv, FitLog, PreparedLog, prepare_log
from cellwise.fit.sensitivity_kernels import FittedRows, add_block, voltage_and_jacobian
from cellwise.fit.solver import Normal, Prior, SolverSettings, minimise
from cellwise.fit.splines import SplineRows, spline_values
from cellwise.fit.unknowns import LEAST_RATIO, Layout, bends_of, bounds_of, scalars_of
from cellwise.typing import FloatArray, IndexArray

ROWS_AT_ONCE = 100  # compared rows of a log, whose products are taken at once
Products = list[tuple[IndexArray, FloatArray]]  # places of some unknowns, and their J' J
LARGEST_STEP = 0.7  # of a logarithm in one iteration: a factor of two


class ErrorEvidence(NamedTuple):
    """What a residual may be, and how much a log says.

    Parameters
    ----------
    least_V, least_share : float      two logs of one cell are not alike within less:
                            temperature inside, relaxation, sensors [V]
    most_share : float      of the polarisation: more is a wrong table, and no noise
    first_V, first_share : float      before any fit, and of the polarisation
    soc : float             error of the counted charge, and of the OCV along the SOC
    empty_soc, near_soc : float    more of it under load near empty, where the last charge follows
                            rate and temperature, over so much SOC
    robust : float          a residual of more deviations counts linearly
    fewest : float          independent errors of a log, however short
    cell_soc, memory_s : float      tables are wrong alike over so much SOC, and for so long [s]
    """

    least_V: float = 0.004
    least_share: float = 0.02
    most_share: float = 0.04
    first_V: float = 0.02
    first_share: float = 0.1
    soc: float = 0.002
    empty_soc: float = 0.05
    near_soc: float = 0.08
    robust: float = 4.0
    fewest: float = 4.0
    cell_soc: float = 0.02
    memory_s: float = 300.0


EVIDENCE = ErrorEvidence()


class RowErrors(NamedTuple):
    """What may move a log's compared rows, (m,) each [V].

    ``polarisation_V`` : their polarisation; ``steep`` : what an error of the SOC does; ``end`` :
    what more of it near empty does; ``bends`` : (m, BENDS) by so much of each bend of a low-rate
    test.
    """

    polarisation_V: FloatArray
    steep: FloatArray
    end: FloatArray
    bends: FloatArray


class Problem:
    """The posterior of the unknowns, given logs and a prior.

    A residual has one variance for all logs: of a level, a share of the polarisation, and an error
    of the SOC where the OCV is steep (``level_V``, ``share``), found on the way. A log counts as so
    many independent errors (``numbers``): a model is wrong for longer than a sample, and thousands
    of rows are no thousand proofs. Of every compared row ``sizes_V`` is the deviation, ``ends_V``
    the same but for the error of the SOC that is alike along a log; ``bends_V`` is what each bend
    of a low-rate test moves there.

    Parameters
    ----------
    base : BaseOcv                    what the unknowns correct
    capacity_Ah : float               that the SOC of the logs is counted over
    grid_C : (temperatures,) float    with tables of their own, ascending
    most_rows : int                   compared rows of one log at most
    """

    def __init__(
        self,
        logs: Sequence[FitLog],
        base: BaseOcv,
        prior: Prior,
        layout: Layout,
        capacity_Ah: float,
        grid_C: FloatArray,
        reference_C: float,
        most_rows: int = ROWS.most,
    ) -> None:
        self.logs = tuple(
            prepare_log(item, base, capacity_Ah, reference_C, grid_C, most_rows) for item in logs
        )
        self.base, self.layout = base, layout
        self.charge_As = 3600.0 * capacity_Ah
        self.layouts = tuple(layout.of_temperatures(log.temperatures, 1) for log in self.logs)
        self.places: tuple[IndexArray, ...] = tuple(
            layout.part(log.first_temperature, log.temperatures, k)
            for k, log in enumerate(self.logs)
        )
        low, high = bounds_of(layout, self.charge_As)
        for k, log in enumerate(self.logs):
            # Nowhere beyond full or empty, as far as a counter and a capacity are sure of that.
            at = layout.start + k
            low[at] = min(0.0, max(-log.soc.min(), -log.soc[0]))
            high[at] = max(0.0, 1.0 - log.soc.max())
        self.prior = replace(prior, low=low, high=high)
        self.numbers = np.array([independent_errors(log) for log in self.logs])
        self.level_V, self.share = EVIDENCE.first_V, EVIDENCE.first_share
        self.sizes_V: tuple[FloatArray, ...] = ()
        self.ends_V: tuple[FloatArray, ...] = ()
        self.bends_V: tuple[FloatArray, ...] = ()
        self.update_row_sizes(self.inside(prior.mean))

    def update_row_sizes(self, theta: FloatArray) -> None:
        """Standard deviation of every compared row [V].

        And what the bends of low-rate tests move, by the slopes of the OCV as it is now.
        """
        row_errors = [self.row_errors(k, theta) for k in range(len(self.logs))]
        self.ends_V = tuple(
            np.sqrt(self.level_V**2 + (self.share * x.polarisation_V) ** 2 + x.end**2)
            for x in row_errors
        )
        self.sizes_V = tuple(
            np.hypot(size, x.steep) for size, x in zip(self.ends_V, row_errors, strict=True)
        )
        self.bends_V = tuple(x.bends for x in row_errors)

    def update_error_sizes(self, theta: FloatArray, residuals: Sequence[FloatArray]) -> None:
        """Level and share that make the residuals most probable; by them what every row may be."""
        row_errors = [self.row_errors(k, theta) for k in range(len(self.logs))]
        polarisations_V = [x.polarisation_V for x in row_errors]
        steep = [np.hypot(x.steep, x.end) for x in row_errors]
        columns = [np.concatenate(x) for x in (residuals, polarisations_V, steep)]
        weight = np.concatenate(
            [np.full(r.size, n / r.size) for r, n in zip(residuals, self.numbers, strict=True)]
        )
        self.level_V, self.share = error_sizes(columns[0], columns[1], columns[2], weight)
        self.update_row_sizes(theta)

    def row_errors(self, index: int, theta: FloatArray) -> RowErrors:
        """What may move a log's compared rows."""
        log, layout = self.logs[index], self.layouts[index]
        unknowns = theta[self.places[index]]
        rows = log.moved(
            self.base,
            float(unknowns[layout.start]),
            float(unknowns[layout.capacity] + unknowns[layout.sample]),
        )
        ocv = rows.base_V + spline_values(rows.ocv, unknowns[: layout.knots_ocv])
        slope = self._slope(rows, unknowns[: layout.knots_ocv])
        soc = np.clip(log.soc[0] + unknowns[layout.start] - rows.used_soc[rows.evaluate], 0.0, 1.0)
        low_rate = log.item.low_rate  # it defines both ends
        end = (0.0 if low_rate else EVIDENCE.empty_soc) * np.exp(-soc / EVIDENCE.near_soc)
        bends = bends_of(soc) * slope[:, None]
        return RowErrors(ocv - log.measured_V, EVIDENCE.soc * slope, end * slope, bends)

    def evaluate(
        self, index: int, theta: FloatArray, *, slopes: bool = True
    ) -> tuple[FloatArray, FloatArray]:
        """Residual (measured minus model) and Jacobian of one log's compared rows and places."""
        log, layout, unknowns = self.logs[index], self.layouts[index], theta[self.places[index]]
        ln_capacity = float(unknowns[layout.capacity] + unknowns[layout.sample])
        rows = log.moved(self.base, float(unknowns[layout.start]), ln_capacity)
        jacobian = np.empty((log.compared if slopes else 0, layout.size))
        voltage = np.empty(log.compared)
        skewed = log.item.skewed
        cell = scalars_of(layout, unknowns, self.charge_As, skewed=skewed)
        voltage_and_jacobian(rows, cell, layout, log.item.h0, skewed, unknowns, jacobian, voltage)
        residual = log.measured_V - voltage
        if log.item.low_rate:
            residual -= self.bends_V[index] @ unknowns[layout.bend :]
            if slopes:
                jacobian[:, layout.bend :] = self.bends_V[index]
        return residual, jacobian

    @staticmethod
    def _slope(rows: FittedRows, ocv: FloatArray) -> FloatArray:
        """Slope of the OCV at the compared rows [V]."""
        slopes = SplineRows(rows.ocv.first, rows.ocv.slopes, rows.ocv.slopes)
        return np.asarray(rows.base_slope_V + spline_values(slopes, ocv))

    def residuals(self, theta: FloatArray) -> tuple[FloatArray, ...]:
        """Residuals of every log."""
        each = range(len(self.logs))
        return tuple(self.evaluate(i, theta, slopes=False)[0] for i in each)

    def _normal_of_log(
        self, index: int, theta: FloatArray
    ) -> tuple[float, FloatArray, Products, FloatArray]:
        """Cost, gradient, matrix and residual of one log."""
        r, jacobian = self.evaluate(index, theta)
        size, number = self.sizes_V[index], self.numbers[index]
        root = np.sqrt(1.0 + (r / (EVIDENCE.robust * size)) ** 2)
        w = number / (r.size * size**2 * root)
        gradient = jacobian.T @ (w * r)
        jacobian *= np.sqrt(w)[:, None]
        cost = number * EVIDENCE.robust**2 * float(np.mean(root - 1.0))
        return cost, gradient, products_of(jacobian, self.places[index]), r

    def _normal_of_each_log(
        self, theta: FloatArray
    ) -> list[tuple[float, FloatArray, Products, FloatArray]]:
        """The same of every log; a thread costs more than a single one."""
        every = range(len(self.logs))
        if len(self.logs) == 1:
            return [self._normal_of_log(0, theta)]
        with ThreadPoolExecutor(max(1, min(4, cpu_count() or 1))) as pool:
            return list(pool.map(lambda i: self._normal_of_log(i, theta), every))

    def normal_of_logs(self, theta: FloatArray) -> tuple[Normal, tuple[FloatArray, ...]]:
        """What the logs say, and the residuals of each; the logs run side by side."""
        matrix = np.zeros((theta.size, theta.size))
        gradient = np.zeros(theta.size)
        cost = 0.0
        residuals = []
        for places, (part, g, products, r) in zip(
            self.places, self._normal_of_each_log(theta), strict=True
        ):
            cost += part
            gradient[places] += g
            for moving, block in products:
                add_block(matrix, moving, block)
            residuals.append(r)
        return Normal(cost, gradient, matrix), tuple(residuals)

    def normal_equations(self, theta: FloatArray) -> Normal:
        """Cost, gradient and matrix of logs and prior."""
        return self.prior.with_data(theta, *self.normal_of_logs(theta)[0])

    def minimise(
        self, theta: FloatArray, iterations: int
    ) -> tuple[FloatArray, int, Normal, tuple[FloatArray, ...]]:
        """The most probable unknowns near a point, steps, logs and prior there, and residuals."""

        def cost_of(theta: FloatArray) -> tuple[float, tuple[Normal, tuple[FloatArray, ...]]]:
            seen = self.normal_of_logs(theta)
            return seen[0].cost, seen

        search = SolverSettings(iterations, largest_step=LARGEST_STEP)
        found = minimise(self.prior, cost_of, lambda _, x: x[0][1:], theta, search, self.inside)
        of_logs, residuals = found.seen
        return found.theta, found.steps, self.prior.with_data(found.theta, *of_logs), residuals

    def ln_sizes(self) -> float:
        """What widening the rows costs: the logarithm of what each may be, as a log counts.

        An error of the SOC that is alike along a log is one, and not one for each of its rows: it
        is left out. Near empty it is the rows' own.
        """
        each = zip(self.numbers, self.ends_V, strict=True)
        return sum(float(n * np.mean(np.log(size))) for n, size in each)

    def log_evidence(self, normal: Normal) -> float:
        """Log of the marginal likelihood, Laplace, up to what is equal for every prior."""
        return -normal.cost - self.ln_sizes() + self.prior.ln_kept(normal.matrix)

    def inside(self, theta: FloatArray) -> FloatArray:
        """Project on the bounds: positive sizes, time constants in order at every knot."""
        layout = self.layout
        theta = self.prior.inside(theta)
        for j in range(1, layout.branches):
            # B-splines are positive and sum to one: ordered coefficients give ordered tables.
            faster, slower = (
                theta[at : at + layout.block] for at in (layout.tau(j - 1), layout.tau(j))
            )
            np.maximum(slower, faster + math.log(LEAST_RATIO), out=slower)
        return theta


def products_of(jacobian: FloatArray, places: IndexArray) -> Products:
    """J' J of one log in parts that add up: of some rows that follow each other, few move."""
    found = []
    for part in np.array_split(jacobian, -(-len(jacobian) // ROWS_AT_ONCE)):
        moving = np.flatnonzero(part.any(axis=0))
        some = part[:, moving]
        found.append((places[moving], some.T @ some))
    return found


def independent_errors(log: PreparedLog) -> float:
    """How many independent errors a log holds: what it gets wrong it repeats SOC by SOC.

    ``cells`` are bins of the SOC, ``EVIDENCE.cell_soc`` wide.
    """
    shown = log.compared_soc
    # What shifts a low-rate test shifts it over twice as much alike.
    alike = EVIDENCE.cell_soc * (1.0 + log.item.low_rate)
    cells = EVIDENCE.fewest + float(np.ptp(shown)) / alike
    long = max(float(np.ptp(log.time_s)) / EVIDENCE.memory_s, EVIDENCE.fewest)
    return min(cells, long) * log.item.weight


def error_sizes(
    residual_V: FloatArray, polarisation_V: FloatArray, steep_V: FloatArray, weight: FloatArray
) -> tuple[float, float]:
    """Level [V] and share of the polarisation that make the residuals most probable.

    Normal errors of variance level^2 + (share drop)^2 + steep^2, large ones cut off.
    """
    square, polarisation2, steep2 = residual_V**2, polarisation_V**2, steep_V**2

    def cost(logarithms: FloatArray) -> float:
        level2, share2 = np.exp(2.0 * logarithms)
        variance = level2 + share2 * polarisation2 + steep2
        ratio = np.minimum(square / variance, EVIDENCE.robust**2)
        return float(weight @ (np.log(variance) + ratio))

    first = np.log([max(float(np.median(np.abs(residual_V))), EVIDENCE.least_V), 0.03])
    low, high = np.log([EVIDENCE.least_V, EVIDENCE.least_share]), np.log([1.0, EVIDENCE.most_share])
    found = minimize(cost, first, method="Nelder-Mead", bounds=list(zip(low, high, strict=True)),
                     options={"xatol": 0.02, "fatol": 0.01})  # fmt: skip
    level, share = np.exp(found.x)
    return float(level), float(share)


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
