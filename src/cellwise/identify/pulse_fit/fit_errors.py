"""Standard errors of a pulse fit, from its Jacobian and from what its residual looks like."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.identify.pulse_fit.pulse_parameters import PulseParameters
from cellwise.identify.pulse_fit.pulse_problem import Problem, Solution, residual_V
from cellwise.identify.pulse_fit.varpro_kernels import (
    COLUMN_OF,
    COLUMNS,
    LINEAR,
    TILE,
    accumulate,
    autocorrelation_time,
    columns_used,
)
from cellwise.identify.pulse_fit.varpro_search import LOOSE, descend
from cellwise.typing import FloatArray

LONGEST_MEMORY = 1000  # rows
SMALLEST_EIGENVALUE = 1e-15
# A window that is short against tau2 fits almost as well with a tau2 twice as long, an OCV slope a
# little lower and a larger R2: a long valley, or a second one. The curvature at its lowest point
# says nothing of that; walking along it does.
WALK_ABOVE = 0.05  # relative standard error of a branch above which the valley is walked
POINTS = 13  # values of tau2 along it


class ResidualStatistics(NamedTuple):
    """What the residual says: its size and how many rows share one independent value."""

    rmse_V: float
    noise_V: float
    rows_per_residual: float


def residual_statistics(problem: Problem, solution: Solution) -> ResidualStatistics:
    """Size and memory of the residual over the rows that count."""
    residual = residual_V(problem, solution.log_tau, solution.coefficients)
    used = problem.weight > 0.0
    residual, weight = residual[used], problem.weight[used]
    unknowns = int(np.count_nonzero(solution.include)) + 2
    memory = autocorrelation_time(
        np.sqrt(weight) * residual, min(LONGEST_MEMORY, residual.size // 4)
    )
    freedom = max(residual.size - unknowns, 1)
    return ResidualStatistics(
        float(np.sqrt(np.sum(weight * residual**2) / np.sum(weight))),
        float(np.sqrt(np.sum(residual**2) / freedom)),
        memory,
    )


def standard_errors(
    problem: Problem, solution: Solution, statistics: ResidualStatistics
) -> tuple[PulseParameters, float]:
    """Standard error of every parameter, and the condition number of the scaled problem.

    With A = J'WJ and the noise equal in all rows, cov = s^2 m A^-1 (J'W^2 J) A^-1; s^2 is the
    residual variance and m the rows that share one independent residual. A time constant whose
    branch has no resistance is not seen: inf. An unknown that the model does not have: 0.

    Returns
    -------
    errors : PulseParameters
    condition : float         of the scaled Jacobian [-]
    """
    transform, names = _jacobian_columns(solution)
    gram_squared = np.empty((COLUMNS, COLUMNS))
    tau1, tau2 = np.exp(solution.log_tau)
    accumulate(
        problem.window._replace(weight=problem.weight**2), tau1, tau2,
        columns_used(solution.include), np.empty((COLUMNS, TILE)), np.empty(TILE), gram_squared,
    )  # fmt: skip
    normal = transform.T @ solution.gram @ transform
    spread = transform.T @ gram_squared @ transform
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    values = np.maximum(values, SMALLEST_EIGENVALUE * values[-1])
    inverse = (vectors / values) @ vectors.T
    middle = spread / np.outer(scale, scale)
    covariance = inverse @ middle @ inverse / np.outer(scale, scale)
    factor = statistics.noise_V**2 * statistics.rows_per_residual
    error = dict(zip(names, np.sqrt(factor * np.maximum(np.diag(covariance), 0.0)), strict=True))
    return (
        PulseParameters(
            r0_ohm=error.get("r0", np.inf),
            r1_ohm=error.get("r1", np.inf),
            tau1_s=float(tau1) * error.get("log_tau1", np.inf),
            r2_ohm=error.get("r2", np.inf),
            tau2_s=float(tau2) * error.get("log_tau2", np.inf),
            ocv_V=error.get("ocv", 0.0),
            ocv_slope_V=error.get("slope", 0.0),
        ),
        float(np.sqrt(values[-1] / values[0])),
    )


_NAMES = ("ocv", "slope", "r0", "r1", "r2", "bend2", "bend3", "bend4", "v1", "v2")


def _jacobian_columns(solution: Solution) -> tuple[FloatArray, list[str]]:
    """The unknowns' derivatives as sums of the kernel's columns, shape (15, unknowns)."""
    columns: list[FloatArray] = []
    names: list[str] = []
    for unknown in range(LINEAR):
        if solution.include[unknown]:
            column = np.zeros(COLUMNS)
            column[COLUMN_OF[unknown]] = 1.0
            columns.append(column)
            names.append(_NAMES[unknown])
    for branch in range(2):
        column = np.zeros(COLUMNS)
        column[6 + branch] = solution.coefficients[3 + branch]
        column[13 + branch] = solution.coefficients[8 + branch]
        if np.any(column != 0.0):
            columns.append(column)
            names.append(f"log_tau{branch + 1}")
    return np.column_stack(columns), names


def profile_errors(
    few: Problem,
    found: Solution,
    limits: FloatArray,
    value: PulseParameters,
    error: PulseParameters,
) -> PulseParameters:
    """Standard errors that also hold along the profile likelihood of tau2.

    At each of `POINTS` values of tau2 over its range everything else is fitted. The deviations of
    the parameters from the optimum, weighted by the likelihood there, give a second variance; the
    larger of it and the linear one counts. Costs nothing where the branches are well known.

    Parameters
    ----------
    few, found : Problem, Solution    thinned rows, and the minimum on them
    limits : (5,) float               as in `log_limits`
    value, error : PulseParameters    the fit and its linear standard errors

    Returns
    -------
    PulseParameters       standard errors, none smaller than given
    """
    branches = ("r1_ohm", "tau1_s", "r2_ohm", "tau2_s")
    if all(getattr(error, n) <= WALK_ABOVE * getattr(value, n) for n in branches):
        return error
    walked = _walk(few, found, limits)
    memory = residual_statistics(few, found).rows_per_residual
    independent = np.count_nonzero(few.weight) / memory
    excess = np.array([max(s.cost - found.cost, 0.0) for s in walked])
    likelihood = np.exp(-0.5 * independent * excess / max(found.cost, 1e-300))
    spacing = (limits[3] - limits[2]) / (POINTS - 1)
    deviation = np.array([_unknowns(s) for s in walked]) - _unknowns(found)
    scale = np.array([1.0, 1.0, value.tau1_s, 1.0, value.tau2_s, 1.0, 1.0])
    linear = np.array(error)
    width = min(float(linear[4]) / value.tau2_s, limits[3] - limits[2])
    own = np.sqrt(2.0 * np.pi) * width  # what the optimum's own surroundings weigh
    seen = own + spacing * np.sum(likelihood)
    spread = spacing * (likelihood @ (deviation * scale) ** 2)
    # Unknowns that the branches do not show at all (inf) stay so.
    finite = np.isfinite(linear)
    wide = np.sqrt((own * np.where(finite, linear, 0.0) ** 2 + spread) / max(seen, 1e-300))
    return PulseParameters(*(float(e) for e in np.where(finite, np.maximum(linear, wide), linear)))


def _walk(few: Problem, found: Solution, limits: FloatArray) -> list[Solution]:
    """Minima at fixed tau2, at equal steps of its logarithm over its range."""
    walked = []
    for log_tau2 in np.linspace(limits[2], limits[3], POINTS):
        highest = min(limits[1], log_tau2 - limits[4])
        if highest < limits[0]:
            continue
        here = np.array([limits[0], highest, log_tau2, log_tau2, limits[4]])
        start = np.array([np.clip(found.log_tau[0], limits[0], highest), log_tau2])
        walked.append(descend(few, found.include, here, start, LOOSE))
    return walked


def _unknowns(solution: Solution) -> FloatArray:
    """R0, R1, log tau1, R2, log tau2, OCV, slope."""
    c, (fast, slow) = solution.coefficients, solution.log_tau
    return np.array([c[2], c[3], fast, c[4], slow, c[0], c[1]])
