"""Standard errors where the Jacobian at the optimum is not enough.

A window that is short against tau2 fits almost as well with a tau2 twice as long, an OCV slope a
little lower and a larger R2: a long valley, or a second one. The curvature at its lowest point
says nothing of that; walking along it does.
"""

from __future__ import annotations

import numpy as np

from cellwise.identify.pulse_fit.pulse_parameters import PulseParameters
from cellwise.identify.pulse_fit.pulse_problem import Problem, Solution
from cellwise.identify.pulse_fit.variable_projection.fit_errors import residual_statistics
from cellwise.identify.pulse_fit.variable_projection.varpro_search import LOOSE, descend
from cellwise.typing import FloatArray

WALK_ABOVE = 0.05  # relative standard error of a branch above which the valley is walked
POINTS = 13  # values of tau2 along it


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
