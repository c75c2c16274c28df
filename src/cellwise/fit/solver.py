"""The most probable unknowns under a normal prior, and what data leave open of them (Laplace)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from cellwise.typing import BoolArray, FloatArray

T = TypeVar("T")


# Least share of the diagonal, and that of a step that is tried again.
UNDAMPED, DAMPED = 1e-9, 1e-3
NONE, EXCHANGES = 1e-9, 60  # a pull that is none, in deviations; unknowns to bounds and back


class SolverSettings(NamedTuple):
    """When a search ends, and how far a step may go.

    Parameters
    ----------
    iterations : int                  points at most from which a step is taken
    least_gain, least_share : float   a step that gains less is the last one, one that would is
                                      none: in nats, and as a share of the cost
    largest_step : float              of any unknown
    damping : float                   of the first step: added to the diagonal, as a share of it
    """

    iterations: int = 40
    least_gain: float = 1e-3
    least_share: float = 1e-3
    largest_step: float = math.inf
    damping: float = DAMPED


class Normal(NamedTuple):
    """Cost at a point [nats], its gradient downhill, and its Gauss-Newton matrix."""

    cost: float
    gradient: FloatArray
    matrix: FloatArray

    def gain(self, step: FloatArray) -> float:
        """What a step gains by the quadratic."""
        return float(step @ (self.gradient - 0.5 * self.matrix @ step))

    def lowest(self, free: BoolArray) -> tuple[float, FloatArray]:
        """Least cost of the quadratic, where some unknowns are free, and the way there."""
        step = self.way(free)
        return self.cost - self.gain(step), step

    def way(self, free: BoolArray) -> FloatArray:
        """The step to the least cost of the quadratic, where some unknowns are free."""
        step = np.zeros(free.size)
        step[free] = _solved(self.matrix[np.ix_(free, free)], self.gradient[free])
        return step


@dataclass(frozen=True, eq=False)
class Prior:
    """A normal distribution of the unknowns within bounds; those not ``free`` keep their mean.

    Parameters
    ----------
    mean : (size,) float
    precision : (size, size) float      inverse of the covariance, of the free ones
    free : (size,) bool
    low, high : (size,) float           bounds
    """

    mean: FloatArray
    precision: FloatArray
    free: BoolArray
    low: FloatArray | float = -math.inf
    high: FloatArray | float = math.inf

    def cost(self, theta: FloatArray) -> float:
        """What a point costs: -ln of its density, up to a constant."""
        deviation = theta - self.mean
        return 0.5 * float(deviation @ self.precision @ deviation)

    def with_data(
        self, theta: FloatArray, cost: float, gradient: FloatArray, matrix: FloatArray
    ) -> Normal:
        """What the data say at a point, and the prior."""
        held = self.precision @ (theta - self.mean)
        return Normal(cost + self.cost(theta), gradient - held, matrix + self.precision)

    def held(self, place: int, value: float) -> Prior:
        """With one unknown known."""
        mean, free = self.mean.copy(), self.free.copy()
        mean[place], free[place] = value, False
        return replace(self, mean=mean, free=free)

    def near(self, place: int, value: float, std: float) -> Prior:
        """With another distribution of one unknown that is independent of the others."""
        mean, precision = self.mean.copy(), self.precision.copy()
        mean[place], precision[place, place] = value, std**-2
        return replace(self, mean=mean, precision=precision)

    def inside(self, theta: FloatArray) -> FloatArray:
        """The nearest point within the bounds."""
        return np.asarray(np.clip(theta, self.low, self.high))

    def covariance(self, matrix: FloatArray | None = None) -> FloatArray:
        """Inverse of a Gauss-Newton matrix (None: the prior's own); zero of what is not free."""
        free = np.flatnonzero(self.free)
        found = np.zeros_like(self.precision)
        system = (self.precision if matrix is None else matrix)[np.ix_(free, free)]
        found[np.ix_(free, free)] = _solved(system, np.eye(free.size))
        return found

    def ln_kept(self, matrix: FloatArray) -> float:
        """Ln of the share of the prior's volume that a Gauss-Newton matrix leaves of the free ones.

        With the cost at the minimum it makes the marginal likelihood (Laplace).
        """
        free = np.ix_(self.free, self.free)
        after, before = (np.linalg.slogdet(m[free])[1] for m in (matrix, self.precision))
        return 0.5 * float(before - after)


@dataclass(frozen=True, eq=False)
class Minimum(Generic[T]):
    """Where a search ended: the point, what the data showed there, and how many steps it took.

    ``normal`` is the posterior's where the last step began.
    """

    theta: FloatArray
    seen: T
    cost: float
    normal: Normal
    steps: int


def minimise(
    prior: Prior,
    cost_of: Callable[[FloatArray], tuple[float, T]],
    normal_of: Callable[[FloatArray, T], tuple[FloatArray, FloatArray]],
    theta: FloatArray,
    search: SolverSettings,
    inside: Callable[[FloatArray], FloatArray] | None = None,
) -> Minimum[T]:
    """Damped Gauss-Newton within bounds (Levenberg-Marquardt).

    Damped less after a step that gained what the quadratic says, more and more where none does
    (Nielsen 1999, IMM-REP-1999-05).

    Parameters
    ----------
    cost_of : callable        what the data cost at a point [nats], and what was seen there
    normal_of : callable      their gradient and matrix, from a point and what was seen there
    theta : (size,) float     where to begin, inside the bounds
    inside : callable or None     projects a point on what is possible; None: on the bounds
    """
    inside = inside or prior.inside
    data, seen = cost_of(theta)
    cost, damping = data + prior.cost(theta), search.damping
    for steps in range(1, search.iterations + 1):
        normal = prior.with_data(theta, data, *normal_of(theta, seen))
        least = max(search.least_gain, search.least_share * cost)
        # What `inside` has put beyond a bound, since an order goes before it, stays there.
        low = np.minimum(np.maximum(prior.low - theta, -search.largest_step), 0.0)
        high = np.maximum(np.minimum(prior.high - theta, search.largest_step), 0.0)
        gain, harder = 0.0, 2.0
        while not gain > 0.0:
            step = bounded_step(normal, prior.free, low, high, damping)
            expected = normal.gain(step)
            if not expected > least:
                return Minimum(theta, seen, cost, normal, steps)
            trial = inside(theta + step)
            trial_data, trial_seen = cost_of(trial)
            gain = cost - trial_data - prior.cost(trial)
            if not gain > 0.0:
                damping, harder = max(harder * damping, DAMPED), 2.0 * harder
        theta, data, seen, cost = trial, trial_data, trial_seen, cost - gain
        damping *= max(1.0 / 3.0, 1.0 - (2.0 * gain / expected - 1.0) ** 3)
        damping = max(damping, UNDAMPED)
        if gain < least:
            break
    return Minimum(theta, seen, cost, normal, steps)


def bounded_step(
    normal: Normal, free: BoolArray, low: FloatArray, high: FloatArray, damping: float
) -> FloatArray:
    """The damped step that is best within its bounds (active set; Nocedal and Wright 2006).

    A step cut off at a bound leaves the others where they make up for what was cut: so what would
    leave is held at its bound and the rest solved again, until none would leave or come back.
    """
    matrix = normal.matrix.copy()
    matrix.flat[:: free.size + 1] *= 1.0 + damping
    least = NONE * np.sqrt(np.diag(matrix))

    def inwards(step: FloatArray, pull: FloatArray) -> BoolArray:
        return free & ((step > low) | (pull > least)) & ((step < high) | (pull < -least))

    step = np.zeros(free.size)
    here = Normal(0.0, normal.gradient, matrix)
    moving = inwards(step, here.gradient)
    for _ in range(EXCHANGES):
        way = here.way(moving)
        whole = np.clip(step + way, low, high)
        share = np.divide(whole - step, way, out=np.ones(free.size), where=whole != step + way)
        part = np.clip(step + share.min() * way, low, high)
        # All to their bounds at once where that gains more than the way to the first of them.
        arrives = bool(np.all(share == 1.0))
        at_once = arrives or here.gain(whole - step) >= here.gain(part - step)
        step = whole if at_once else part
        here = Normal(0.0, normal.gradient - matrix @ step, matrix)
        before = moving
        if arrives:
            moving = before | inwards(step, here.gradient)
            if np.all(moving == before):
                break
        else:
            moving = before & (share == 1.0 if at_once else share > share.min())
    return step


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of a positive definite system, scaled to a diagonal of ones."""
    size = 1.0 / np.sqrt(np.diag(matrix))
    by = size if right.ndim == 1 else size[:, None]
    scaled = matrix * size
    scaled *= size[:, None]
    # Symmetric: its transpose is as LAPACK has it, and is not copied.
    factor = cho_factor(scaled.T, overwrite_a=True)
    return np.asarray(by * cho_solve(factor, by * right))
