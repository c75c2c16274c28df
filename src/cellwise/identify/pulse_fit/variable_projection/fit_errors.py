"""Standard errors of a pulse fit, from its Jacobian and from what its residual looks like."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.identify.pulse_fit.pulse_parameters import PulseParameters
from cellwise.identify.pulse_fit.pulse_problem import Problem, Solution, residual_V
from cellwise.identify.pulse_fit.variable_projection.varpro_kernels import (
    COLUMN_OF,
    COLUMNS,
    LINEAR,
    TILE,
    accumulate,
    autocorrelation_time,
    columns_used,
)
from cellwise.typing import FloatArray

LONGEST_MEMORY = 1000  # rows
SMALLEST_EIGENVALUE = 1e-15


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
