"""The capacity of a fit and how far it is open, beyond what the quadratic at its end says.

`at_open_capacity` fits again at the mean of the profile, and widens the covariance to its spread.

Near empty the OCV is steep and every table open, and a row may be far off there. A fit holds what
rows may be, step by step, so it does not pay for widening that: it lets logs end at empty, where
much is forgiven. So the other unknowns are fitted at each of several capacities, and each is
weighed by the likelihood that it reaches, with what the rows may be there (profile likelihood;
Murphy and van der Vaart 2000, doi:10.1080/01621459.2000.10474219), trusted as that of a start is.
The volume that is left of the prior does not weigh here: it is mostly that of tables at SOC where
no log has been, where the prior is wide on purpose, and would prefer a cell that is never emptied.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cellwise.fit.log_starts import TRIALS
from cellwise.fit.problem import Problem
from cellwise.fit.solve import FitResult
from cellwise.fit.solver import Prior
from cellwise.threads import one_blas_thread
from cellwise.typing import FloatArray


class Tried(NamedTuple):
    """Which capacities are tried, around the one that a fit has found.

    Parameters
    ----------
    step, below, above : float    of ln of the capacity; further where that is still probable
    nats : float                  so much less is improbable
    measured : float              a smaller deviation beforehand: a test has shown it
    rounds, iterations : int      at each capacity; between rounds the rows are weighed again
    """

    step: float = 0.02
    below: float = 0.08
    above: float = 0.16
    nats: float = 6.0
    measured: float = 0.05
    rounds: int = 2
    iterations: int = 6


TRIED = Tried()
HELD = 1e-4  # deviation of ln of a capacity that the other unknowns are fitted at


class OpenCapacity(NamedTuple):
    """Ln of a capacity over the one that the logs are counted over: mean and deviation."""

    mean: float
    std: float


def at_open_capacity(
    problem: Problem,
    fit: FitResult,
    again: Callable[[Prior, FloatArray], FitResult],
    tried: Tried = TRIED,
) -> FitResult:
    """A fit moved to the mean of the profile of its capacity, and as open as that.

    ``again`` fits the others with a prior that holds the capacity, from given unknowns.
    """
    place = fit.layout.capacity
    found = open_capacity(problem, fit, tried)
    theta = fit.theta.copy()
    theta[place] = found.mean
    moved = again(problem.prior.near(place, found.mean, HELD), theta)
    std = max(found.std, float(fit.theta_std[place]))
    return replace(moved, covariance=opened(moved.covariance, place, std))


@one_blas_thread
def open_capacity(problem: Problem, fit: FitResult, tried: Tried = TRIED) -> OpenCapacity:
    """The capacity by the profile of its likelihood, around that of a fit.

    Each capacity is fitted from its neighbour, upwards and downwards again, and has the better of
    both: on the way into another valley a few steps do not arrive.
    """
    place = problem.layout.capacity
    first = problem.prior
    mean, precision = float(first.mean[place]), float(first.precision[place, place])
    taken = float(fit.theta[place])
    low, high = (float(np.asarray(bound)[place]) for bound in (first.low, first.high))
    weights: dict[int, float] = {}

    def weigh(k: int, theta: FloatArray) -> FloatArray:
        """The others at the k-th capacity, from a neighbour's."""
        value = taken + tried.step * k
        problem.prior = first.held(place, value)
        problem.level_V, problem.share = fit.level_V, fit.share
        theta = theta.copy()
        theta[place] = value
        theta = problem.inside(theta)
        for _ in range(tried.rounds):
            problem.update_row_sizes(theta)
            theta, *_ = problem.minimise(theta, tried.iterations)
        problem.update_row_sizes(theta)
        cost = problem.normal_equations(theta).cost + problem.ln_sizes()
        found = -TRIALS.trust * cost
        found -= 0.5 * precision * (value - mean) ** 2
        weights[k] = max(found, weights.get(k, found))
        return theta

    def open_beyond(k: int) -> bool:
        """Whether the next capacity is to be tried, too."""
        near = -tried.below <= tried.step * k <= tried.above
        probable = weights[k] > max(weights.values()) - tried.nats
        return (near or probable) and low <= taken + tried.step * (k + np.sign(k)) <= high

    theta, k = weigh(0, fit.theta), 1
    while open_beyond(k - 1):
        theta, k = weigh(k, theta), k + 1
    k -= 2
    while k >= 0 or open_beyond(k + 1):
        theta, k = weigh(k, theta), k - 1
    for again in range(k + 2, 1):
        theta = weigh(again, theta)
    problem.prior = first
    at = taken + tried.step * np.array(list(weights))
    weight = np.exp(np.array(list(weights.values())) - max(weights.values()))
    mean_ln = float(np.average(at, weights=weight))
    # Between two capacities any may be.
    variance = float(np.average((at - mean_ln) ** 2, weights=weight)) + tried.step**2 / 12.0
    return OpenCapacity(mean_ln, float(np.sqrt(variance)))


def opened(covariance: FloatArray, place: int, std: float) -> FloatArray:
    """A covariance with another deviation of one unknown, which the others follow as before."""
    variance = float(covariance[place, place])
    along = covariance[:, place] / variance
    return np.asarray(covariance + (std**2 - variance) * np.outer(along, along))
