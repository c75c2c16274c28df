r"""Particle swarm identification of a pulse, as the LFP040AHA paper does it.

Fully informed swarm (Mendes, Kennedy, Neves, doi:10.1109/TEVC.2004.826074): every particle is
drawn to the best places of all its neighbours at once,

.. math::

    v \leftarrow \chi \Big( v + \sum_{k \in N} U(0, \varphi / |N|) \circ (p_k - x) \Big),
    \qquad \chi = 2 / (\varphi - 2 + \sqrt{\varphi^2 - 4 \varphi})

with cognition phi = 4.1, 64 particles, 180 iterations and a ring lattice of order 8: neighbours are
the four particles on either side. Kept as the paper's method and as a reference.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellwise.cell.compiled import cached
from cellwise.errors import InputError
from cellwise.identify.pulse_fit.pulse_data import PulseData, Weighting
from cellwise.identify.pulse_fit.pulse_parameters import PulseFit, PulseTrend, TauBounds
from cellwise.identify.pulse_fit.pulse_problem import (
    Problem,
    Solution,
    build_problem,
    log_limits,
    window_tau_bounds,
)
from cellwise.identify.pulse_fit.varpro import describe
from cellwise.identify.pulse_fit.varpro_kernels import (
    COLUMNS,
    LINEAR,
    SAME_INTERVAL,
    TILE,
    Window,
    accumulate,
)
from cellwise.typing import FloatArray

PAPER_BOUNDS = TauBounds(0.5, 15.0, 15.0, 120.0)
OCV_REST_S = 10.0  # the paper's OCV: mean voltage over the last 10 s before the pulse
WALL = -0.5  # a particle that leaves the search box is put on its wall and turned back at half pace
OCV_ROOM = 0.1  # search range of a free OCV over the voltage swing of the window


@dataclass(frozen=True)
class SwarmOptions:
    """Choices of the swarm; the defaults are the paper's.

    Parameters
    ----------
    particles, neighbours, iterations : int
    cognition : float         phi, above 4
    free : 5 or 7             R0, R1, tau1, R2, tau2 with the OCV from the rest before (the
                              paper's), or the OCV and its slope as well
    tau : TauBounds           search range; "tau1 a few seconds", tau2 up to 120 s in the paper
    weighting : str           see `row_weights`
    """

    particles: int = 64
    neighbours: int = 8
    iterations: int = 180
    cognition: float = 4.1
    free: Literal[5, 7] = 5
    tau: TauBounds | None = None
    weighting: Weighting = "balanced"

    def __post_init__(self) -> None:
        if not (2 <= self.neighbours < self.particles and self.neighbours % 2 == 0):
            raise InputError(
                f"{self.neighbours} neighbours among {self.particles} particles",
                "an even number of neighbours, at least 2 and below the number of particles",
                "Change one of the two.",
            )
        if not self.cognition > 4.0 or self.iterations < 1 or self.free not in (5, 7):
            raise InputError(
                f"cognition {self.cognition}, {self.iterations} iterations, {self.free} free",
                "cognition above 4, at least 1 iteration, 5 or 7 free parameters",
                "Change the setting.",
            )


def fit_swarm(
    data: PulseData, options: SwarmOptions | None = None, rng: np.random.Generator | None = None
) -> PulseFit:
    """Fit one pulse by fully informed particle swarm.

    Parameters
    ----------
    data : PulseData
    options : SwarmOptions
    rng : numpy Generator     by default one seeded with 0

    Returns
    -------
    PulseFit

    Raises
    ------
    InputError        bounds that leave no room, too few settled rows
    """
    options = options or SwarmOptions()
    rng = rng or np.random.default_rng(0)
    problem = build_problem(data, options.weighting, PulseTrend())
    bounds = options.tau or _paper_bounds(data)
    limits = log_limits(bounds)
    low, high = _box(data, problem, bounds, options.free)
    best, cost, passes = _swarm(problem, low, high, options, rng)
    solution = _solution(problem, best, cost, passes, options, data)
    return describe(data, problem, solution, limits, PulseTrend(), "pso")


def _paper_bounds(data: PulseData) -> TauBounds:
    """The paper's search range, within what the window can show."""
    window, paper = window_tau_bounds(data), PAPER_BOUNDS
    slowest = min(paper.tau2_max_s, window.tau2_max_s)
    fastest = max(paper.tau1_min_s, window.tau1_min_s)
    between = float(np.clip(paper.tau1_max_s, 1.5 * fastest, slowest / 1.5))
    return TauBounds(fastest, between, between, slowest)


def _box(
    data: PulseData, problem: Problem, bounds: TauBounds, free: int
) -> tuple[FloatArray, FloatArray]:
    """Search box of R0, R1, tau1, R2, tau2, OCV minus reference, OCV slope, shape (7,) each."""
    swing = float(np.ptp(data.voltage_V))
    most = 2.0 * swing / max(abs(data.pulse_current_A), 1e-12)
    before = data.time_s[max(data.start - 1, 0)]
    rest = slice(int(np.searchsorted(data.time_s, before - OCV_REST_S)), max(data.start, 1))
    ocv = float(np.mean(problem.known[rest]))
    low = np.array([0.0, 0.0, bounds.tau1_min_s, 0.0, bounds.tau2_min_s, ocv, 0.0])
    high = np.array([most, most, bounds.tau1_max_s, most, bounds.tau2_max_s, ocv, 0.0])
    if free == 7:
        moved = max(float(np.ptp(problem.dq)), 1e-9)
        low[5], high[5] = ocv - OCV_ROOM * swing, ocv + OCV_ROOM * swing
        high[6] = 0.0 if data.ocv_change_V is not None else 2.0 * swing / moved
    return low, high


def _swarm(
    problem: Problem,
    low: FloatArray,
    high: FloatArray,
    options: SwarmOptions,
    rng: np.random.Generator,
) -> tuple[FloatArray, float, int]:
    """Best position, its cost [V^2], and the number of passes over the samples."""
    phi = options.cognition
    chi = 2.0 / (phi - 2.0 + np.sqrt(phi * phi - 4.0 * phi))
    count, half = options.particles, options.neighbours // 2
    steps = np.concatenate((np.arange(-half, 0), np.arange(1, half + 1)))
    neighbours = (np.arange(count)[:, None] + steps) % count
    position = low + (high - low) * rng.random((count, low.size))
    velocity = np.zeros_like(position)
    best = position.copy()
    best_cost = _costs(problem, position)
    for _ in range(options.iterations):
        pull = phi / steps.size * rng.random((count, steps.size, low.size))
        velocity += np.sum(pull * (best[neighbours] - position[:, None, :]), axis=1)
        velocity *= chi
        position += velocity
        outside = (position < low) | (position > high)
        velocity[outside] *= WALL
        np.clip(position, low, high, out=position)
        cost = _costs(problem, position)
        better = cost < best_cost
        best[better], best_cost[better] = position[better], cost[better]
    winner = int(np.argmin(best_cost))
    return best[winner], float(best_cost[winner]), count * (options.iterations + 1)


def _costs(problem: Problem, position: FloatArray) -> FloatArray:
    costs = np.empty(len(position))
    swarm_costs(problem.window, position, costs)
    return costs


def _solution(
    problem: Problem,
    best: FloatArray,
    cost: float,
    passes: int,
    options: SwarmOptions,
    data: PulseData,
) -> Solution:
    """The swarm's best place in the terms of the least-squares fit, for the same statistics."""
    r0, r1, tau1, r2, tau2, ocv, slope = best
    coefficients = np.zeros(LINEAR)
    coefficients[:5] = ocv, slope, r0, r1, r2
    include = np.zeros(LINEAR, dtype=np.bool_)
    include[2:5] = True
    include[0] = options.free == 7
    include[1] = options.free == 7 and data.ocv_change_V is None
    gram = np.empty((COLUMNS, COLUMNS))
    accumulate(problem.window, tau1, tau2, COLUMNS, np.empty((COLUMNS, TILE)), np.empty(TILE), gram)
    return Solution(cost, np.log([tau1, tau2]), coefficients, include, gram, passes, True)


@cached()
def swarm_costs(
    window: Window,
    positions: FloatArray,
    costs: FloatArray,
) -> None:
    """Weighted sum of squared residuals of every particle [V^2].

    Parameters
    ----------
    window : Window                   its trend is not used
    positions : (m, 7) float          R0, R1, tau1, R2, tau2, OCV minus reference, OCV slope
    costs : (m,) float                result; infinite where tau1 >= tau2
    """
    dt, current, known, dq, weight, _, centre = window
    for p in range(positions.shape[0]):
        r0, r1, tau1 = positions[p, 0], positions[p, 1], positions[p, 2]
        r2, tau2, ocv, slope = (
            positions[p, 3], positions[p, 4], positions[p, 5], positions[p, 6],
        )  # fmt: skip
        if tau1 >= tau2:
            costs[p] = math.inf
            continue
        v1 = v2 = total = 0.0
        a1 = a2 = 0.0
        last_dt = -1.0
        for k in range(dt.size):
            if abs(dt[k] - last_dt) > SAME_INTERVAL * dt[k]:
                last_dt = dt[k]
                a1 = math.exp(-dt[k] / tau1)
                a2 = math.exp(-dt[k] / tau2)
            v1 = r1 * current[k] + a1 * (v1 - r1 * current[k])
            v2 = r2 * current[k] + a2 * (v2 - r2 * current[k])
            error = known[k] - (ocv + slope * (centre - dq[k]) - r0 * current[k] - v1 - v2)
            total += weight[k] * error * error
        costs[p] = total
