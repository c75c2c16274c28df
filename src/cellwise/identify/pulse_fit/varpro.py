"""Variable projection: a pulse fitted in its two time constants, everything else solved for.

.. math::

    v = OCV + s x + b_2 x^2 + b_3 x^3 + b_4 x^4
        - R_0 I - R_1 u_1 - R_2 u_2 - V_{10} e_1 - V_{20} e_2

with x the SOC minus the pulse's mean SOC, u_j the response of a branch of one ohm (exact for
current that is constant over an interval) and e_j the decay of what the branch held at the start.
Only tau1 and tau2 enter nonlinearly; at given time constants the rest is a small linear problem
with R >= 0 (Golub and Pereyra, doi:10.1137/0710036). The slope s is what keeps a pulse at the ends
of the SOC range from bending tau2.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.optimize import nnls

from cellwise.errors import InputError
from cellwise.identify.pulse_fit.fit_errors import describe, residual_statistics
from cellwise.identify.pulse_fit.pulse_data import PulseData, Weighting
from cellwise.identify.pulse_fit.pulse_parameters import (
    PulseFit,
    PulseParameters,
    PulseTrend,
    TauBounds,
)
from cellwise.identify.pulse_fit.pulse_problem import (
    NO_TREND,
    UNKNOWNS,
    Problem,
    Solution,
    build_problem,
    columns,
    log_limits,
    tau_slopes,
    window_tau_bounds,
)
from cellwise.typing import BoolArray, FloatArray

# A further unknown stays where it lowers the sum of squares by this many
# residual variances per independent residual and unknown: 3.5 standard errors.
CLEAR_GAIN = 12.0
# Over less SOC than this an OCV does not bend; what looks like it is some other nonlinearity.
BEND_SWING = 0.006
RESTED_TAUS = 5.0  # a branch then holds less than a hundredth of what it held
# Slope and resistances are not below zero; OCV and starting voltages have either sign.
BOUNDED = np.isin(np.arange(len(UNKNOWNS)), [1, 2, 3, 4])
RIDGE = 1e-13  # of the scaled normal equations: rounding


class _Search(NamedTuple):
    """How hard the minimum is looked for."""

    grid: int = 6  # start values per axis of the log tau plane
    starts: int = 2  # grid points that are followed
    passes: int = 100
    loose: float = 1e-4  # movement of log tau that ends the search on few rows ...
    tight: float = 1e-3  # ... and on all of them, where one step more is exact enough
    few_rows: int = 800  # more are averaged for the search ...
    part: float = 0.02  # ... over this part of the time since the last step of the current


SEARCH = _Search()


@dataclass(frozen=True)
class VarproOptions:
    """Choices of the fit; the defaults suit any pulse.

    Parameters
    ----------
    weighting : str           see `row_weights`
    tau : TauBounds or None   by default from the window, see `window_tau_bounds`
    bends : bool              keep the powers of the OCV inside the pulse, beyond its slope, that
                              the residual calls for
    initial : "auto" or bool  fit what the branches held at the window's start; ``auto`` does if
                              the residual calls for it
    """

    weighting: Weighting = "balanced"
    tau: TauBounds | None = None
    bends: bool = True
    initial: Literal["auto"] | bool = "auto"

    def __post_init__(self) -> None:
        if self.initial not in ("auto", True, False):
            raise InputError(
                f"initial = {self.initial!r}", "'auto', True or False", "Choose one of these."
            )


class _At(NamedTuple):
    """Cost at a pair of time constants, the linear unknowns solved for; its Gauss-Newton system.

    With J the derivative of the prediction to log tau at fixed linear unknowns, H = J'PJ and
    g = J'r, where P projects out the linear columns (Kaufman's form, doi:10.1007/BF01932995).
    """

    cost: float
    coefficients: FloatArray
    hessian: FloatArray
    gradient: FloatArray


def fit_varpro(
    data: PulseData,
    options: VarproOptions | None = None,
    trend: PulseTrend = NO_TREND,
    start_tau_s: tuple[float, float] | None = None,
) -> PulseFit:
    """Fit one pulse and its relaxation by variable projection.

    Parameters
    ----------
    data : PulseData
    options : VarproOptions
    trend : PulseTrend        change of the parameters with SOC, from neighbouring pulses
    start_tau_s : (2,) float  time constants to start from [s]; by default a grid is searched

    Returns
    -------
    PulseFit

    Raises
    ------
    InputError        bounds that leave no room, too few settled rows
    """
    options = options or VarproOptions()
    problem = build_problem(data, options.weighting, trend)
    limits = log_limits(options.tau or window_tau_bounds(data))
    include = np.ones(len(UNKNOWNS), dtype=np.bool_)
    include[1] = data.ocv_change_V is None
    plain = include.copy()
    plain[5:] = include[7:] = False
    few = _thinned(problem)
    grid = _grid(limits) if start_tau_s is None else np.log(np.array([start_tau_s]))
    seen = [_evaluate(few, plain, log_tau) for log_tau in grid]
    starts = grid[np.argsort([at.cost for at in seen])[: SEARCH.starts]]
    found = _lowest(few, include if options.initial is True else plain, limits, starts)
    tau2_s = float(np.exp(found.log_tau[1]))
    if options.initial == "auto" and data.rest_before_window_s < RESTED_TAUS * tau2_s:
        richer = _lowest(few, include, limits, (found.log_tau, *starts))
        found = richer if _called_for(few, found, richer) else found
    if options.bends and np.ptp(problem.dq) >= BEND_SWING:
        found = _with_bends(few, limits, found)
    solution = _descend(problem, found.include, limits, found.log_tau, SEARCH.tight)
    fit = describe(data, problem, solution, limits, "varpro")
    wide = _spread(few, found, grid, seen)
    return replace(fit, error=PulseParameters(*np.maximum(fit.error, wide).tolist()))


def _spread(few: Problem, found: Solution, grid: FloatArray, seen: Sequence[_At]) -> FloatArray:
    """Standard deviation of the parameters over the grid, weighed by the likelihood, shape (7,).

    A window that is short against tau2 fits almost as well with a tau2 twice as long: a long
    valley, of which the curvature at its lowest point says nothing.
    """
    memory = residual_statistics(few, found).rows_per_residual
    independent = np.count_nonzero(few.weight) / memory
    excess = np.array([max(at.cost - found.cost, 0.0) for at in seen])
    likelihood = np.exp(-0.5 * independent * excess / max(found.cost, 1e-300))
    coefficients = np.array([at.coefficients for at in seen]) - found.coefficients
    slow = np.exp(found.log_tau) * (grid - found.log_tau)
    ocv, slope, r0, r1, r2 = coefficients.T[:5]
    deviation = np.array([r0, r1, slow[:, 0], r2, slow[:, 1], ocv, slope])
    return np.asarray(np.sqrt(deviation**2 @ likelihood / (1.0 + np.sum(likelihood))))


def _with_bends(problem: Problem, limits: FloatArray, plain: Solution) -> Solution:
    """Add powers of the OCV inside the pulse, one after the other, while they are called for."""
    for power in range(7, len(UNKNOWNS)):
        include = plain.include.copy()
        include[power] = True
        richer = _descend(problem, include, limits, plain.log_tau, SEARCH.loose)
        if not _called_for(problem, plain, richer):
            break
        plain = richer
    return plain


def _called_for(problem: Problem, plain: Solution, richer: Solution) -> bool:
    """Whether the residual calls for the richer model."""
    memory = residual_statistics(problem, richer).rows_per_residual
    independent = np.count_nonzero(problem.weight) / memory
    gain = (plain.cost - richer.cost) * independent
    unknowns = np.count_nonzero(richer.include) - np.count_nonzero(plain.include)
    return bool(gain > CLEAR_GAIN * unknowns * richer.cost)


def _grid(limits: FloatArray) -> FloatArray:
    """Pairs of log time constants over the plane within the limits, shape (m, 2)."""
    fast = np.linspace(limits[0], limits[1], SEARCH.grid)
    slow = np.linspace(limits[2], limits[3], SEARCH.grid)
    return np.array([(f, s) for f in fast for s in slow if s - f >= limits[4] - 1e-9])


def _lowest(
    few: Problem, include: BoolArray, limits: FloatArray, starts: Iterable[FloatArray]
) -> Solution:
    """The lowest of the minima that the starts lead to."""
    found = (_descend(few, include, limits, start, SEARCH.loose) for start in starts)
    return min(found, key=lambda solution: solution.cost)


def _descend(
    problem: Problem, include: BoolArray, limits: FloatArray, start: FloatArray, tolerance: float
) -> Solution:
    """Levenberg-Marquardt on the two time constants from one start."""
    log_tau, damping, converged = start.copy(), 1e-4, False
    now = _evaluate(problem, include, log_tau)
    passes = 1
    while passes < SEARCH.passes and not converged:
        trial_tau = log_tau + _bounded_step(now, damping, log_tau, limits)
        moved = float(np.max(np.abs(trial_tau - log_tau)))
        trial = _evaluate(problem, include, trial_tau)
        passes += 1
        if trial.cost <= now.cost:
            # Where no circuit fits, steps creep along a valley: what gains nothing is the end.
            converged = moved < tolerance or now.cost - trial.cost <= 1e-9 * now.cost
            log_tau, now = trial_tau, trial
            damping = max(0.1 * damping, 1e-12)
        else:
            converged = moved < tolerance
            damping *= 10.0
    return Solution(now.cost, log_tau, now.coefficients, include, passes, converged)


def _bounded_step(at: _At, damping: float, log_tau: FloatArray, limits: FloatArray) -> FloatArray:
    """Step of (log tau1, log tau2) that keeps the limits: what a limit holds moves along it."""
    floor = 1e-12 * max(float(np.trace(at.hessian)), 1e-300)  # a branch of no resistance
    hessian = at.hessian + np.diag(damping * np.diag(at.hessian) + floor)
    low, high, apart = limits[[0, 2]], limits[[1, 3]], limits[4]
    step = np.clip(np.linalg.solve(hessian, at.gradient), -1.5, 1.5)
    held = ((log_tau <= low) & (step < 0.0)) | ((log_tau >= high) & (step > 0.0))
    if held.any():
        free = ~held
        step = np.where(free, at.gradient / np.diag(hessian), 0.0)
    target = np.clip(log_tau + step, low, high)
    if target[1] - target[0] < apart:
        along = float(np.sum(at.gradient) / np.sum(hessian))
        middle = 0.5 * (np.sum(log_tau) - apart) + along
        fast = np.clip(middle, max(low[0], low[1] - apart), min(high[0], high[1] - apart))
        target = np.array([fast, fast + apart])
    return np.asarray(target - log_tau)


def _evaluate(problem: Problem, include: BoolArray, log_tau: FloatArray) -> _At:
    """One pass over the samples at a pair of time constants."""
    linear, of_tau = columns(problem, log_tau, include)
    root = np.sqrt(problem.weight)
    used = np.flatnonzero(include)
    a, y = linear[used] * root, problem.known * root
    gram, right = a @ a.T, a @ y
    solved = _bounded_optimum(gram, right, BOUNDED[used])
    free = (solved != 0.0) | ~BOUNDED[used]
    coefficients = np.zeros(len(UNKNOWNS))
    coefficients[used] = solved
    residual = y - solved @ a
    jacobian = tau_slopes(of_tau, coefficients) * root
    explained = a[free] @ jacobian.T
    projected = _solve(gram[np.ix_(free, free)], explained)
    return _At(
        float(residual @ residual),
        coefficients,
        jacobian @ jacobian.T - explained.T @ projected,
        jacobian @ residual,
    )


def _bounded_optimum(gram: FloatArray, right: FloatArray, bounded: BoolArray) -> FloatArray:
    """Least squares by its normal equations, with some unknowns not below zero."""
    solved = _solve(gram, right)
    if np.all(solved[bounded] >= 0.0):
        return solved
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    factor = np.linalg.cholesky(gram / np.outer(scale, scale) + RIDGE * np.eye(scale.size)).T
    # What has either sign is a difference of two that have not.
    both = np.concatenate((factor, -factor[:, ~bounded]), axis=1)
    found = nnls(both, np.linalg.solve(factor.T, right / scale))[0]
    solved = found[: scale.size]
    solved[~bounded] -= found[scale.size :]
    return np.asarray(solved / scale)


def _solve(gram: FloatArray, right: FloatArray) -> FloatArray:
    """Normal equations, scaled; a column that depends on others shares with them."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(scale, scale) + RIDGE * np.eye(scale.size)
    return np.asarray((np.linalg.solve(scaled, (right.T / scale).T).T / scale).T)


def _thinned(problem: Problem) -> Problem:
    """Fewer rows for the search: neighbours averaged, finer after a step of the current.

    A group carries its mean time, voltage and charge and its summed weight, so against the rows
    that it replaces it errs by the square of its length only. Rows beside a step stay alone.
    """
    n = problem.dt.size
    if n <= SEARCH.few_rows:
        return problem
    t = np.cumsum(problem.dt)
    step = np.abs(np.diff(problem.current, prepend=problem.current[0]))
    steps = np.flatnonzero(step > 1e-2 * float(np.max(np.abs(problem.current))))
    begun = np.concatenate(([0], steps))[np.searchsorted(steps, np.arange(n), side="right")]
    since = t - t[np.maximum(begun - 1, 0)]
    dt = float(np.median(problem.dt[1:]))
    decade = np.floor(np.log1p(SEARCH.part * since / dt) / SEARCH.part)
    alone = np.isin(np.arange(n), np.concatenate([steps + k for k in (-2, -1, 0, 1)]))
    first = alone | (np.diff(begun, prepend=-1) != 0) | (np.diff(decade, prepend=-1.0) != 0.0)
    first |= np.concatenate(([False], alone[:-1]))
    start = np.flatnonzero(first)
    count = np.diff(np.append(start, n))
    weight = np.add.reduceat(problem.weight, start)

    def mean(x: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(x, start) / count)

    weighted = np.add.reduceat(problem.known * problem.weight, start)
    return problem._replace(
        dt=np.diff(mean(t), prepend=0.0),
        current=mean(problem.current),
        known=np.where(weight > 0.0, weighted / np.maximum(weight, 1e-300), mean(problem.known)),
        dq=mean(problem.dq),
        weight=weight,
    )
