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

from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import cached
from cellwise.cell.equations.states import decay, relaxed
from cellwise.identify.pulse_fit.circuit import (
    APART,
    SAME_INTERVAL,
    Circuit,
    PulseFit,
    PulseParameters,
)
from cellwise.identify.pulse_fit.pulse_data import PulseData
from cellwise.typing import FloatArray


class _Box(NamedTuple):
    """The box that is searched: tau1 a few seconds and tau2 up to two minutes, as in the paper."""

    fastest_s: float = 0.5
    between_s: float = 15.0
    slowest_s: float = 120.0
    rest_s: float = 10.0  # the paper's OCV: mean voltage over the last 10 s before the pulse
    wall: float = -0.5  # a particle that leaves is put on the wall and turned back at half pace


BOX = _Box()


class _Swarm(NamedTuple):
    """The paper's swarm; ``cognition`` is phi, above 4."""

    particles: int = 64
    neighbours: int = 8
    iterations: int = 180
    cognition: float = 4.1


SWARM = _Swarm()


def fit_swarm(
    data: PulseData,
    iterations: int = SWARM.iterations,
    rng: np.random.Generator | None = None,
) -> PulseFit:
    """Fit R0, R1, tau1, R2, tau2 of one pulse by fully informed particle swarm.

    The OCV is that of the rest before, as in the paper.

    Parameters
    ----------
    data : PulseData
    iterations : int          by default the paper's
    rng : numpy Generator     by default one seeded with 0

    Returns
    -------
    PulseFit

    Raises
    ------
    InputError        bounds that leave no room, too few settled rows
    """
    rng = rng or np.random.default_rng(0)
    circuit = Circuit(data)
    low, high = _box(circuit)
    value = PulseParameters(*_swarm(circuit, low, high, iterations, rng).tolist())
    free = value._fields[:5]
    held = [
        name
        for name, x, least, most in zip(value._fields, value, low, high, strict=True)
        if name in free and not least < x < (np.inf if name.endswith("ohm") else most)
    ]
    return circuit.described("pso", value, free, held)


def _box(circuit: Circuit) -> tuple[FloatArray, FloatArray]:
    """Search box of R0, R1, tau1, R2, tau2, OCV, shape (6,) each.

    The paper's time constants, within what the window can show.
    """
    data, window = circuit.data, circuit.tau_bounds()
    slowest, fastest = min(BOX.slowest_s, window.slowest_s), max(BOX.fastest_s, window.fastest_s)
    between = float(np.clip(BOX.between_s, APART * fastest, slowest / APART))
    swing = float(np.ptp(data.voltage_V[data.first :]))
    most = 2.0 * swing / max(abs(data.pulse_current_A), 1e-12)
    before = data.time_s[max(data.start - 1, 0)]
    rest = slice(int(np.searchsorted(data.time_s, before - BOX.rest_s)), max(data.start, 1))
    ocv = float(np.mean(circuit.known[rest]))
    low = np.array([0.0, 0.0, fastest, 0.0, between, ocv])
    high = np.array([most, most, between, most, slowest, ocv])
    return low, high


def _swarm(
    circuit: Circuit,
    low: FloatArray,
    high: FloatArray,
    iterations: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Best position, shape (6,)."""
    phi = SWARM.cognition
    chi = 2.0 / (phi - 2.0 + np.sqrt(phi * phi - 4.0 * phi))
    count, half = SWARM.particles, SWARM.neighbours // 2
    steps = np.concatenate((np.arange(-half, 0), np.arange(1, half + 1)))
    neighbours = (np.arange(count)[:, None] + steps) % count
    position = low + (high - low) * rng.random((count, low.size))
    velocity = np.zeros_like(position)
    best = position.copy()
    best_cost = costs_of(circuit, position)
    for _ in range(iterations):
        pull = phi / steps.size * rng.random((count, steps.size, low.size))
        velocity += np.sum(pull * (best[neighbours] - position[:, None, :]), axis=1)
        velocity *= chi
        position += velocity
        outside = (position < low) | (position > high)
        velocity[outside] *= BOX.wall
        np.clip(position, low, high, out=position)
        cost = costs_of(circuit, position)
        better = cost < best_cost
        best[better], best_cost[better] = position[better], cost[better]
    return np.asarray(best[int(np.argmin(best_cost))])


def costs_of(circuit: Circuit, position: FloatArray) -> FloatArray:
    """Weighted sum of squared residuals of every particle [V^2], shape (m, 6) -> (m,).

    Infinite where tau1 >= tau2.
    """
    costs = np.empty(len(position))
    fit = circuit.dt_s, circuit.current_A, circuit.known, circuit.weight
    sum_squares(*fit, position, costs)
    return np.where(position[:, 2] < position[:, 4], costs, np.inf)


@cached()
def sum_squares(
    dt_s: FloatArray,
    current_A: FloatArray,
    known_V: FloatArray,
    weight: FloatArray,
    position: FloatArray,
    out_V2: FloatArray,
) -> None:
    """Weighted sum of squared residuals of every particle, result of shape (m,): row by row."""
    for j in range(position.shape[0]):
        r0, r1, tau1, r2, tau2, ocv = position[j]
        u1 = u2 = a1 = a2 = total = 0.0
        last = -1.0
        for k in range(dt_s.size):
            if abs(dt_s[k] - last) > SAME_INTERVAL * dt_s[k]:
                last = dt_s[k]
                a1, a2 = decay(last, tau1), decay(last, tau2)
            u1 = relaxed(u1, a1, 1.0 - a1, current_A[k])
            u2 = relaxed(u2, a2, 1.0 - a2, current_A[k])
            off = known_V[k] - (ocv - r0 * current_A[k] - r1 * u1 - r2 * u2)
            total += weight[k] * off * off
        out_V2[j] = total
