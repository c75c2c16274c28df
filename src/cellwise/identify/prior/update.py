"""The most probable model, given a prior and logs: a few Gauss-Newton steps, and what they left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cellwise.cell.equations import CellTables, empty_state
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import known_temperature_C, simulate_rows, start_hysteresis
from cellwise.identify.prior.corrections import Corrections
from cellwise.identify.refinement.problem import independent_samples
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray, IndexArray

STEP = 0.02  # standard deviations, for differences
SOC_STEP = 1e-4
H_STEP = 0.05
# Two logs of one cell are not alike within less: temperature inside, relaxation, sensors.
LEAST_SIGMA_V = 0.005
FIRST_SIGMA_V = 0.02
ROBUST = 4.0
FEWEST_INDEPENDENT = 4.0
# Residuals of a fit forget sooner than the model's error does: tables are wrong for as long as the
# SOC stays near. The filters' default noise has the same time.
MEMORY_S = 300.0
ROWS_OF_ONE = 20.0  # compared rows that are worth one, where fits are compared
MOST_OF_A_LOG = 50.0
SAME_SOC = 0.02
MOST_COMPARED = 1500
PASSES = (6, 4, 6)
CONVERGED = 1e-3
LARGEST_MOVE = 2.0  # standard deviations in one step


@dataclass(frozen=True, eq=False)
class PriorLog:
    """A log to update on: SOC at its first row with its standard deviation, and what to compare.

    ``compare`` marks rows, shape (n,); None: all with a voltage. ``h0_std`` is how little is known
    of its hysteresis state there: 0 as :func:`start_hysteresis` says, 1 nothing.
    """

    log: CellLog
    soc0: float
    soc0_std: float
    compare: BoolArray | None = None
    h0_std: float = 0.0


@dataclass(frozen=True, eq=False)
class Update:
    """The most probable corrections and initial SOCs.

    ``z`` (size,) with its ``covariance`` (size, size); ``soc0`` (logs,) and its standard deviation;
    ``rows`` the compared rows of every log, ``residual_V`` measured minus model there;
    ``distance`` is half the squared distance from the prior, in standard deviations.
    """

    model: CellModel
    z: FloatArray
    covariance: FloatArray
    soc0: FloatArray
    soc0_std: FloatArray
    rows: tuple[IndexArray, ...]
    residual_V: tuple[FloatArray, ...]
    distance: float

    @property
    def misfit(self) -> float:
        """Minus the log probability, up to a constant; every log counts alike from every start."""
        total = self.distance
        for r in self.residual_V:
            worth = float(np.clip(r.size / ROWS_OF_ONE, FEWEST_INDEPENDENT, MOST_OF_A_LOG))
            total += worth * float(np.log(np.hypot(np.sqrt(np.mean(r * r)), LEAST_SIGMA_V)))
        return total


def update_from(corrections: Corrections, starts: Sequence[Sequence[PriorLog]]) -> Update:
    """The best of the fits from several guesses of the initial SOCs.

    Curves that resemble themselves elsewhere have several solutions: what the others that are
    nearly as probable say differently is part of the covariance and of the SOCs' deviations.

    Parameters
    ----------
    starts : sequence of the same logs with other ``soc0``; guesses alike are tried once
    """
    guesses = [np.array([item.soc0 for item in logs]) for logs in starts]
    distinct = [
        k
        for k, guess in enumerate(guesses)
        if all(np.max(np.abs(guess - other)) > SAME_SOC for other in guesses[:k])
    ]
    found = sorted((update(corrections, starts[k]) for k in distinct), key=lambda f: f.misfit)
    best = found[0]
    covariance, variance = best.covariance.copy(), best.soc0_std**2
    for other in found[1:]:
        share = 1.0 / (1.0 + np.exp(min(other.misfit - best.misfit, MOST_OF_A_LOG)))
        apart = other.z - best.z
        covariance += share * (1.0 - share) * np.outer(apart, apart)
        variance = variance + share * (1.0 - share) * (other.soc0 - best.soc0) ** 2
    return replace(best, covariance=covariance, soc0_std=np.sqrt(variance))


class _Rows(NamedTuple):
    """A log as the simulation takes it, and which rows are compared."""

    interval_s: FloatArray
    current_A: FloatArray
    temperature_C: FloatArray
    compared: IndexArray
    measured_V: FloatArray


def update(corrections: Corrections, logs: Sequence[PriorLog]) -> Update:
    """Fit corrections and initial SOCs to the logs' voltages, held by the prior.

    Each log counts with the number of its independent residuals and their size, both found on the
    way: a model is wrong for longer than a sample, and thousands of rows are no thousand proofs.

    Parameters
    ----------
    corrections : Corrections
    logs : sequence of PriorLog       each with at least one row to compare

    Returns
    -------
    Update
    """
    rows = [_rows(corrections.prior, item) for item in logs]
    means = np.array([item.soc0 for item in logs])
    stds = np.array([item.soc0_std for item in logs])
    branch = np.array([item.h0_std for item in logs])
    size, count = corrections.size, len(logs)
    x = np.zeros(size + 2 * count)  # corrections, initial SOCs, initial hysteresis
    sigma = np.full(len(logs), FIRST_SIGMA_V)
    most = np.array([max(item.log.duration_s / MEMORY_S, FEWEST_INDEPENDENT) for item in logs])
    worth = most

    def at(point: FloatArray) -> list[FloatArray]:
        tables = corrections.model(point[:size]).parameters()
        starts = _starts(point[size:], means, stds, branch)
        return [_residual(tables, one, *s) for one, s in zip(rows, starts, strict=True)]

    def cost(point: FloatArray, residuals: Sequence[FloatArray]) -> float:
        total = float(point @ point)
        for r, s, n in zip(residuals, sigma, worth, strict=True):
            scale = ROBUST * s
            root = np.sqrt(1.0 + (r / scale) ** 2)
            total += n * float(np.mean(2.0 * scale**2 * (root - 1.0))) / s**2
        return total

    residuals = at(x)
    system = np.eye(x.size)
    for steps in PASSES:
        best, damping = cost(x, residuals), 1e-3
        for _ in range(steps):
            system, slope = _system(
                corrections, rows, x, residuals, sigma, worth, means, stds, branch
            )
            moved = False
            while damping < 1e6 and not moved:
                lifted = system + damping * np.diag(np.diag(system))
                move = np.linalg.solve(lifted, slope)
                trial = x + np.clip(move, -LARGEST_MOVE, LARGEST_MOVE)
                own = slice(size, size + count)
                trial[own] = (_inside(means + stds * trial[own]) - means) / stds
                found = at(trial)
                value = cost(trial, found)
                moved = value < best
                damping = damping / 5.0 if moved else damping * 8.0
            if not moved:
                break
            gain, x, residuals, best = best - value, trial, found, value
            if gain < CONVERGED * best:
                break
        sigma, worth = _sizes(residuals, most)
    system, _ = _system(corrections, rows, x, residuals, sigma, worth, means, stds, branch)
    inverse = np.asarray(np.linalg.inv(system), dtype=np.float64)
    return Update(
        model=corrections.model(x[:size]),
        z=x[:size],
        covariance=inverse[:size, :size],
        soc0=_inside(means + stds * x[size : size + count]),
        soc0_std=stds * np.sqrt(np.diag(inverse)[size : size + count]),
        rows=tuple(one.compared for one in rows),
        residual_V=tuple(residuals),
        distance=0.5 * float(x @ x),
    )


def _inside(soc0: FloatArray) -> FloatArray:
    return np.clip(soc0, 0.0, 1.0)


def _starts(
    own: FloatArray, means: FloatArray, stds: FloatArray, branch: FloatArray
) -> list[tuple[float, float]]:
    """SOC and hysteresis state at the first row of every log; unknown, the latter is about zero."""
    count = means.size
    socs = _inside(means + stds * own[:count])
    found = []
    for soc0, std, z in zip(socs, branch, own[count:], strict=True):
        known = (1.0 - std) * start_hysteresis(float(soc0))
        found.append((float(soc0), float(np.clip(known + std * z, -1.0, 1.0))))
    return found


def _rows(prior: CellModel, item: PriorLog) -> _Rows:
    """The log's columns; compared are rows with a voltage, evenly over its time."""
    log = item.log
    usable = np.isfinite(log.voltage_V)
    if item.compare is not None:
        usable &= item.compare
    known = np.flatnonzero(usable)
    if known.size > MOST_COMPARED:
        time_s = log.time_s[known]
        wanted = np.linspace(time_s[0], time_s[-1], MOST_COMPARED)
        known = np.unique(known[np.searchsorted(time_s, wanted).clip(0, known.size - 1)])
    return _Rows(
        np.array(log.interval_s),
        np.array(log.known_current_A()),
        known_temperature_C(prior, log),
        known,
        log.voltage_V[known],
    )


def _residual(tables: CellTables, rows: _Rows, soc0: float, h0: float) -> FloatArray:
    """Measured minus simulated voltage of the compared rows [V]."""
    voltage, soc = np.empty(rows.current_A.size), np.empty(rows.current_A.size)
    start = empty_state(soc0, h0)
    simulate_rows(tables, start, rows.interval_s, rows.current_A, rows.temperature_C, voltage, soc)
    return np.asarray(rows.measured_V - voltage[rows.compared])


def _system(
    corrections: Corrections,
    rows: Sequence[_Rows],
    x: FloatArray,
    residuals: Sequence[FloatArray],
    sigma: FloatArray,
    worth: FloatArray,
    means: FloatArray,
    stds: FloatArray,
    branch: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Gauss-Newton matrix and right-hand side; derivatives by differences."""
    size = corrections.size
    count = len(rows)
    starts = _starts(x[size:], means, stds, branch)
    jacobians = [np.empty((r.size, size)) for r in residuals]
    for k in range(size):
        z = x[:size].copy()
        z[k] += STEP
        tables = corrections.model(z).parameters()
        for j, one in enumerate(rows):
            jacobians[j][:, k] = (_residual(tables, one, *starts[j]) - residuals[j]) / STEP
    here = corrections.model(x[:size]).parameters()
    matrix, slope = np.eye(x.size), -x.copy()
    for j, (one, r) in enumerate(zip(rows, residuals, strict=True)):
        soc0, h0 = starts[j]
        step = SOC_STEP if soc0 <= 0.5 else -SOC_STEP
        by_soc = (_residual(here, one, soc0 + step, h0) - r) / step * stds[j]
        step = H_STEP if h0 <= 0.0 else -H_STEP
        by_h = (_residual(here, one, soc0, h0 + step) - r) / step * branch[j]
        full = np.column_stack((jacobians[j], by_soc, by_h))
        w = worth[j] / (r.size * sigma[j] ** 2 * np.sqrt(1.0 + (r / (ROBUST * sigma[j])) ** 2))
        places = np.append(np.arange(size), (size + j, size + count + j))
        matrix[np.ix_(places, places)] += (full * w[:, None]).T @ full
        slope[places] -= full.T @ (w * r)
    return matrix, slope


def _sizes(residuals: Sequence[FloatArray], most: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Size of every log's residual, and how many independent values it is worth."""
    sigma = [max(1.4826 * float(np.median(np.abs(r))), LEAST_SIGMA_V) for r in residuals]
    worth = [max(independent_samples(r), FEWEST_INDEPENDENT) for r in residuals]
    return np.array(sigma), np.minimum(worth, most)
