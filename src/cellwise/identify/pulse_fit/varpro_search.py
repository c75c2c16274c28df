"""The search for the two time constants of a pulse: a grid, then Levenberg-Marquardt."""

from __future__ import annotations

import numpy as np

from cellwise.identify.pulse_fit.pulse_problem import Problem, Solution
from cellwise.identify.pulse_fit.varpro_algebra_kernels import minimise, scan
from cellwise.identify.pulse_fit.varpro_kernels import COLUMNS, LINEAR, thin
from cellwise.typing import BoolArray, FloatArray

GRID = 9  # start values per axis of the log tau plane
STARTS = 3  # grid points that are followed
THIN_ABOVE = 800  # rows; fewer are searched as they are
THIN_PART = 0.02  # of the time since the last step: resolution of the search for start values
PASSES = 60
LOOSE, TIGHT = 1e-4, 1e-6  # movement of log tau that ends the search and the final fit

# OCV slope and resistances; the OCV, its bends and the starting voltages have either sign.
NON_NEGATIVE = np.zeros(LINEAR, dtype=np.bool_)
NON_NEGATIVE[1:5] = True


def search(
    few: Problem, include: BoolArray, limits: FloatArray, start: FloatArray | None
) -> Solution:
    """Minimum on thinned rows, from a start or from the best points of a grid."""
    if start is not None:
        return descend(few, include, limits, _clip(start, limits), LOOSE)
    fast = np.linspace(limits[0], limits[1], GRID)
    slow = np.linspace(limits[2], limits[3], GRID)
    grid = np.array([(f, s) for f in fast for s in slow if s - f >= limits[4] - 1e-9])
    costs = np.empty(len(grid))
    scan(few.window, include, NON_NEGATIVE, grid, costs)
    best = grid[np.argsort(costs)[:STARTS]]
    return min((descend(few, include, limits, s, LOOSE) for s in best), key=lambda f: f.cost)


def thinned(problem: Problem) -> Problem:
    """Fewer rows for the search: neighbours averaged, finer after a current step."""
    if problem.dt.size <= THIN_ABOVE:
        return problem
    step = 1e-2 * float(np.max(np.abs(problem.current)))
    out = np.empty((5, problem.dt.size))
    count = thin(
        problem.dt, problem.current, problem.known, problem.dq, problem.weight, THIN_PART, step, out
    )
    dt, current, known, dq, weight = (np.ascontiguousarray(row[:count]) for row in out)
    return problem._replace(dt=dt, current=current, known=known, dq=dq, weight=weight)


def descend(
    problem: Problem, include: BoolArray, limits: FloatArray, start: FloatArray, tolerance: float
) -> Solution:
    """Levenberg-Marquardt from one start."""
    log_tau = start.copy()
    gram = np.empty((COLUMNS, COLUMNS))
    coefficients = np.zeros(LINEAR)
    free = np.zeros(LINEAR, dtype=np.bool_)
    cost, passes, converged = minimise(
        problem.window, include, NON_NEGATIVE, limits, log_tau, PASSES, tolerance, gram,
        coefficients, free,
    )  # fmt: skip
    return Solution(cost, log_tau, coefficients, include, gram, passes, converged)


def _clip(log_tau: FloatArray, limits: FloatArray) -> FloatArray:
    """Nearest allowed start."""
    fast = np.clip(log_tau[0], limits[0], limits[1])
    slow = np.clip(log_tau[1], max(limits[2], fast + limits[4]), limits[3])
    return np.array([fast, slow])
