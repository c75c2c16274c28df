"""Compiled kernels of the pulse fit: algebra on the small matrix of normal equations.

Nothing here sees samples except through `varpro_kernels.accumulate`. The unknowns that enter
linearly are solved exactly, with their sign bounds, at every pair of time constants; what remains
is a bounded minimisation in two variables, log tau1 and log tau2.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.compiled import cached
from cellwise.identify.pulse_fit.varpro_kernels import (
    COLUMN_OF,
    COLUMNS,
    LINEAR,
    TILE,
    Window,
    accumulate,
    bounded_step,
    columns_used,
    next_boost,
    within,
)
from cellwise.typing import BoolArray, FloatArray

IntVector = NDArray[np.int64]
Scratch = tuple[FloatArray, FloatArray, IntVector, FloatArray, FloatArray]

PIVOT_LIMIT = 1e-12
LONGEST_STEP = 1.5  # in log tau
STALLED = 1e-11  # relative gain of a pass below which only rounding is left
DAMPING_START, DAMPING_LEAST = 1e-4, 1e-12


@cached()
def _solve_subset(
    gram: FloatArray, columns: IntVector, m: int, chol: FloatArray, x: FloatArray
) -> float:
    """Least squares on ``m`` columns by Cholesky of the scaled normal equations.

    Leaves the scaled factor in ``chol`` and the solution in ``x``; returns the remaining cost.
    A column that depends on those before it gets coefficient zero.
    """
    for i in range(m):
        ci = columns[i]
        si = math.sqrt(gram[ci, ci])
        for j in range(i + 1):
            cj = columns[j]
            scale = si * math.sqrt(gram[cj, cj])
            s = gram[ci, cj] / scale if scale > 0.0 else 0.0
            for k in range(j):
                s -= chol[i, k] * chol[j, k]
            if j < i:
                chol[i, j] = s / chol[j, j] if chol[j, j] > 0.0 else 0.0
            else:
                chol[i, i] = math.sqrt(s) if s > PIVOT_LIMIT else 0.0
        s = gram[0, ci] / si if si > 0.0 else 0.0
        for k in range(i):
            s -= chol[i, k] * x[k]
        x[i] = s / chol[i, i] if chol[i, i] > 0.0 else 0.0
    cost = gram[0, 0]
    for i in range(m):
        cost -= x[i] * x[i]
    for i in range(m - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, m):
            s -= chol[k, i] * x[k]
        x[i] = s / chol[i, i] if chol[i, i] > 0.0 else 0.0
    for i in range(m):
        d = math.sqrt(gram[columns[i], columns[i]])
        x[i] = x[i] / d if d > 0.0 else 0.0
    return float(max(cost, 0.0))


@cached()
def solve_linear(
    gram: FloatArray,
    include: BoolArray,
    non_negative: BoolArray,
    coefficients: FloatArray,
    free: BoolArray,
    columns: IntVector,
    chol: FloatArray,
    x: FloatArray,
) -> float:
    """Linear unknowns with sign bounds: the feasible subset of least cost, found exactly.

    At most four unknowns are bounded, so every choice of those that sit at zero is tried; for a
    convex quadratic the best feasible one is the bounded optimum.

    Parameters
    ----------
    gram : (15, 15) float             from `accumulate`
    include, non_negative : (10,) bool     unknowns in the model; unknowns that must not be negative
    coefficients : (10,) float, free : (10,) bool       result: values; not at a bound
    columns : (10,) int, chol : (10, 10) float, x : (10,) float       scratch

    Returns
    -------
    float         remaining cost, the weighted sum of squared residuals [V^2]
    """
    bounded = 0
    for u in range(LINEAR):
        if include[u] and non_negative[u]:
            bounded += 1
    best = math.inf
    for mask in range(1 << bounded):
        m = 0
        bit = 0
        for u in range(LINEAR):
            if not include[u]:
                continue
            at_zero = False
            if non_negative[u]:
                at_zero = (mask >> bit) & 1 == 1
                bit += 1
            if not at_zero:
                columns[m] = COLUMN_OF[u]
                m += 1
        cost = _solve_subset(gram, columns, m, chol, x)
        if cost >= best:
            continue
        feasible = True
        for i in range(m):
            for u in range(LINEAR):
                if COLUMN_OF[u] == columns[i] and non_negative[u] and x[i] < 0.0:
                    feasible = False
        if not feasible:
            continue
        best = cost
        for u in range(LINEAR):
            coefficients[u] = 0.0
            free[u] = False
            for i in range(m):
                if COLUMN_OF[u] == columns[i]:
                    coefficients[u] = x[i]
                    free[u] = True
        if mask == 0:
            break
    return best


@cached()
def _reduced_normal(
    gram: FloatArray,
    coefficients: FloatArray,
    free: BoolArray,
    columns: IntVector,
    chol: FloatArray,
    x: FloatArray,
    hessian: FloatArray,
    gradient: FloatArray,
) -> None:
    """Gauss-Newton system in (log tau1, log tau2) after the linear unknowns are eliminated.

    With J the derivative of the prediction to log tau at fixed linear unknowns, H = J'PJ and
    g = J'r, where P projects out the linear columns (Kaufman's form, doi:10.1007/BF01932995).
    """
    m = 0
    for u in range(LINEAR):
        if free[u]:
            columns[m] = COLUMN_OF[u]
            m += 1
    _solve_subset(gram, columns, m, chol, x)
    # Each derivative is a sum of two columns: of the driven branch and of its initial decay.
    b = np.zeros((2, LINEAR))
    for t in range(2):
        r = coefficients[3 + t]
        v = coefficients[8 + t]
        gradient[t] = r * gram[0, 6 + t] + v * gram[0, 13 + t]
        for u in range(LINEAR):
            if free[u]:
                c = COLUMN_OF[u]
                gradient[t] -= coefficients[u] * (r * gram[c, 6 + t] + v * gram[c, 13 + t])
        for i in range(m):
            c = columns[i]
            d = math.sqrt(gram[c, c])
            s = (r * gram[c, 6 + t] + v * gram[c, 13 + t]) / d if d > 0.0 else 0.0
            for k in range(i):
                s -= chol[i, k] * b[t, k]
            b[t, i] = s / chol[i, i] if chol[i, i] > 0.0 else 0.0
    for t in range(2):
        for q in range(2):
            rt, vt = coefficients[3 + t], coefficients[8 + t]
            rq, vq = coefficients[3 + q], coefficients[8 + q]
            s = rt * rq * gram[6 + t, 6 + q] + vt * vq * gram[13 + t, 13 + q]
            s += rt * vq * gram[6 + t, 13 + q] + vt * rq * gram[13 + t, 6 + q]
            for i in range(m):
                s -= b[t, i] * b[q, i]
            hessian[t, q] = s


@cached()
def _scratch() -> Scratch:
    """Buffers that one search uses for all its passes."""
    return (
        np.empty((COLUMNS, TILE)),
        np.empty(TILE),
        np.zeros(LINEAR, dtype=np.int64),
        np.zeros((LINEAR, LINEAR)),
        np.zeros(LINEAR),
    )


@cached()
def _evaluate(
    window: Window,
    p1: float,
    p2: float,
    include: BoolArray,
    non_negative: BoolArray,
    scratch: Scratch,
    gram: FloatArray,
    coefficients: FloatArray,
    free: BoolArray,
) -> float:
    """Cost [V^2] at (log tau1, log tau2), with the linear unknowns solved for: one pass."""
    tile, tile_weight, columns, chol, x = scratch
    accumulate(window, math.exp(p1), math.exp(p2), columns_used(include), tile, tile_weight, gram)
    return solve_linear(gram, include, non_negative, coefficients, free, columns, chol, x)


@cached()
def _keep(
    trial: FloatArray,
    trial_coefficients: FloatArray,
    trial_free: BoolArray,
    gram: FloatArray,
    coefficients: FloatArray,
    free: BoolArray,
) -> None:
    """Copy the accepted pass; by element, as whole-array assignment takes seconds to compile."""
    for i in range(COLUMNS):
        for j in range(COLUMNS):
            gram[i, j] = trial[i, j]
    for u in range(LINEAR):
        coefficients[u] = trial_coefficients[u]
        free[u] = trial_free[u]


@cached()
def minimise(
    window: Window,
    include: BoolArray,
    non_negative: BoolArray,
    limits: FloatArray,
    log_tau: FloatArray,
    iterations: int,
    tolerance: float,
    gram: FloatArray,
    coefficients: FloatArray,
    free: BoolArray,
) -> tuple[float, int, bool]:
    """Levenberg-Marquardt on the two time constants, the linear unknowns projected out.

    Parameters
    ----------
    window : Window
    include, non_negative : (10,) bool                 as in `solve_linear`
    limits : (5,) float       of log tau1 and log tau2, and their least distance
    log_tau : (2,) float      start; overwritten with the optimum
    iterations : int          most passes over the samples
    tolerance : float         converged when log tau moves less than this
    gram : (15, 15), coefficients : (10,), free : (10,)     result at the optimum

    Returns
    -------
    cost [V^2], passes over the samples, whether it converged
    """
    scratch = _scratch()
    _, _, columns, chol, x = scratch
    trial = np.empty((COLUMNS, COLUMNS))
    trial_coefficients = np.zeros(LINEAR)
    trial_free = np.zeros(LINEAR, dtype=np.bool_)
    hessian = np.zeros((2, 2))
    gradient = np.zeros(2)
    step = np.zeros(2)
    cost = math.inf
    damping = DAMPING_START
    boost, last1, last2 = 1.0, 0.0, 0.0
    p1, p2 = log_tau[0], log_tau[1]
    for n in range(iterations):
        new = _evaluate(
            window, p1, p2, include, non_negative, scratch, trial, trial_coefficients, trial_free
        )
        moved = max(abs(p1 - log_tau[0]), abs(p2 - log_tau[1]))
        if new < cost or n == 0:
            stalled = cost - new <= STALLED * cost
            log_tau[0], log_tau[1] = p1, p2
            cost = new
            _keep(trial, trial_coefficients, trial_free, gram, coefficients, free)
            damping = max(0.1 * damping, DAMPING_LEAST)
            if n > 0 and (moved < tolerance or stalled):
                return cost, n + 1, True
            _reduced_normal(gram, coefficients, free, columns, chol, x, hessian, gradient)
        elif moved < tolerance:
            return cost, n + 1, True
        elif boost > 1.0:
            boost = 1.0
        else:
            damping *= 10.0
        if hessian[0, 0] + hessian[1, 1] <= 0.0:  # no branch at all: no tau to look for
            return cost, n + 1, True
        # A branch of zero resistance says nothing about its tau: keep the system regular.
        floor = 1e-12 * (hessian[0, 0] + hessian[1, 1])
        bounded_step(
            hessian[0, 0] * (1.0 + damping) + floor, hessian[0, 1],
            hessian[1, 1] * (1.0 + damping) + floor, gradient[0], gradient[1],
            log_tau[0], log_tau[1], limits, step,
        )  # fmt: skip
        if new <= cost:
            boost = next_boost(boost, step, last1, last2)
            last1, last2 = step[0], step[1]
        p1 = within(
            log_tau[0] + within(boost * step[0], -LONGEST_STEP, LONGEST_STEP), limits[0], limits[1]
        )
        p2 = within(
            log_tau[1] + within(boost * step[1], -LONGEST_STEP, LONGEST_STEP), limits[2], limits[3]
        )
        p2 = max(p2, p1 + limits[4])
    return cost, iterations, False


@cached()
def scan(
    window: Window,
    include: BoolArray,
    non_negative: BoolArray,
    log_tau: FloatArray,
    costs: FloatArray,
) -> None:
    """Cost [V^2] at every given pair of log time constants, shape (m, 2) -> (m,)."""
    scratch = _scratch()
    gram = np.empty((COLUMNS, COLUMNS))
    coefficients = np.zeros(LINEAR)
    free = np.zeros(LINEAR, dtype=np.bool_)
    for k in range(costs.size):
        costs[k] = _evaluate(
            window, log_tau[k, 0], log_tau[k, 1], include, non_negative, scratch, gram,
            coefficients, free,
        )  # fmt: skip
