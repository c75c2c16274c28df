"""The capacity by its marginal likelihood, every other unknown integrated out.

Where the capacity is open, the most probable unknowns together do not have the most probable
capacity. Near empty the OCV is steep and every table is open: a fit that lets the log end there
finds a peak that is high and narrow. So the others are fitted at each of several capacities, and
each is weighed by the volume that its logs leave them (Laplace), as starts are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.fit.problem import Problem
from cellwise.fit.solve import FitResult
from cellwise.threads import one_blas_thread
from cellwise.typing import FloatArray


class Tried(NamedTuple):
    """Which capacities are tried, around the one that a fit has found.

    Parameters
    ----------
    step, below, above : float    of ln of the capacity; further where that is still probable
    nats : float                  so much less is improbable
    known : float                 a deviation of less is no question
    rounds, iterations : int      at each capacity; between rounds the rows are weighed anew
    """

    step: float = 0.02
    below: float = 0.08
    above: float = 0.16
    nats: float = 6.0
    known: float = 0.005
    rounds: int = 2
    iterations: int = 6


TRIED = Tried()


class WeighedCapacity(NamedTuple):
    """A capacity, and the other unknowns there.

    Parameters
    ----------
    median, std : float       of its logarithm, and the deviation from the median
    theta, slope : (size,) float      all unknowns there, and how they follow the capacity
    """

    median: float
    std: float
    theta: FloatArray
    slope: FloatArray


@one_blas_thread
def weigh_capacities(problem: Problem, fit: FitResult) -> WeighedCapacity:
    """Weigh capacities around that of a fit by their marginal likelihood.

    Each is fitted from its neighbour, upwards and downwards again, and has the better of both: on
    the way into another valley a few steps do not arrive.
    """
    place = problem.layout.capacity
    first = problem.prior
    mean, precision = float(first.mean[place]), float(first.precision[place, place])
    taken = float(fit.theta[place])
    low, high = (float(np.asarray(bound)[place]) for bound in (first.low, first.high))
    evidence: dict[int, float] = {}
    thetas: dict[int, FloatArray] = {}

    def weigh(k: int, theta: FloatArray) -> FloatArray:
        """Fit the others at the k-th capacity, keep them where they are the better ones."""
        value = taken + TRIED.step * k
        problem.prior = first.held(place, value)
        problem.level_V, problem.share = fit.level_V, fit.share
        theta = theta.copy()
        theta[place] = value
        theta = problem.inside(theta)
        for _ in range(TRIED.rounds):
            problem.judge_sizes(theta)
            theta, *_ = problem.minimise(theta, TRIED.iterations)
        problem.judge_sizes(theta)
        found = problem.log_evidence(problem.normal_equations(theta))
        found -= 0.5 * precision * (value - mean) ** 2
        if found > evidence.get(k, -np.inf):
            evidence[k], thetas[k] = found, theta
        return theta

    def open_at(k: int) -> bool:
        """Whether the next capacity is to be tried, too."""
        inside = -TRIED.below <= TRIED.step * k <= TRIED.above
        probable = evidence[k] > max(evidence.values()) - TRIED.nats
        value = taken + TRIED.step * (k + np.sign(k))
        possible = low <= value <= high
        return bool((inside or probable) and possible)

    theta, k = weigh(0, fit.theta), 1
    while open_at(k - 1):
        theta, k = weigh(k, theta), k + 1
    k -= 2
    while k >= 0 or open_at(k + 1):
        theta, k = weigh(k, theta), k - 1
    for j in range(k + 2, 1):
        theta = weigh(j, theta)
    problem.prior = first
    places = sorted(evidence)
    grid = taken + TRIED.step * np.array(places)
    each = np.array([evidence[k] for k in places])
    weight = np.exp(each - each.max())
    weight /= weight.sum()
    # Between two valleys the mean is improbable, the median is in one of them.
    edges = np.append(grid, grid[-1] + TRIED.step) - 0.5 * TRIED.step
    median = float(np.interp(0.5, np.concatenate(([0.0], np.cumsum(weight))), edges))
    # Between two capacities any may be.
    std = float(np.sqrt(weight @ (grid - median) ** 2 + TRIED.step**2 / 12.0))
    nearest = thetas[places[int(np.argmin(np.abs(grid - median)))]].copy()
    nearest[place] = median
    return WeighedCapacity(median, std, nearest, _slope(problem, nearest, place))


def _slope(problem: Problem, theta: FloatArray, place: int) -> FloatArray:
    """How the other unknowns follow one that is moved, by the quadratic at a point."""
    problem.judge_sizes(theta)
    matrix = problem.normal_equations(theta).matrix
    others = problem.prior.free.copy()
    others[place] = False
    slope = np.zeros(theta.size)
    slope[others] = -np.linalg.solve(matrix[np.ix_(others, others)], matrix[others, place])
    slope[place] = 1.0
    return slope
