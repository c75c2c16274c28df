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

from cellwise.identify.pulse_fit.circuit import APART, Circuit, PulseFit, PulseParameters
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
    r0, r1, tau1, r2, tau2, ocv = position.T[..., None]
    u1, u2 = (circuit.responses(tau[:, 0]) for tau in (tau1, tau2))
    model = ocv - r0 * circuit.current_A - r1 * u1 - r2 * u2
    costs = (circuit.known - model) ** 2 @ circuit.weight
    return np.where(position[:, 2] < position[:, 4], costs, np.inf)
