"""Pulses written down in closed form: no recursion, nothing shared with the package.

The response of an RC branch to a current that starts at 0 and stops at T is
R I (1 - e^(-t/tau)) inside and R I (1 - e^(-T/tau)) e^(-(t-T)/tau) after.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellwise.identify.pulse_fit.pulse_data import PulseData, pulse_data

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Circuit:
    """2-RC circuit; slope in volt per unit SOC, at the mean SOC of the pulse."""

    r0: float = 2.0e-3
    r1: float = 1.0e-3
    tau1: float = 4.0
    r2: float = 1.5e-3
    tau2: float = 60.0
    ocv: float = 3.6
    slope: float = 0.8
    v1: float = 0.0
    v2: float = 0.0

    @property
    def values(self) -> Array:
        return np.array([self.r0, self.r1, self.tau1, self.r2, self.tau2, self.ocv])


def stamps(rng: np.random.Generator | None = None, *, pulse_s: float = 60.0, rest_s: float = 600.0,
           before_s: float = 30.0, pulse_hz: float = 10.0, rest_hz: float = 1.0,
           fast_s: float = 30.0, jitter: float = 0.0) -> Array:  # fmt: skip
    """Row times [s], the pulse from 0 to pulse_s; rows fall on both edges; jitter within rows."""
    before = np.arange(-before_s, 0.5 / rest_hz, 1.0 / rest_hz)
    pulse = np.arange(1, round(pulse_s * pulse_hz) + 1) / pulse_hz
    fast_s = min(fast_s, rest_s)
    fast = pulse_s + np.arange(1, round(fast_s * pulse_hz) + 1) / pulse_hz
    slow = pulse_s + fast_s + np.arange(1, round((rest_s - fast_s) * rest_hz) + 1) / rest_hz
    t = np.concatenate((before[before < 0.5 / pulse_hz], pulse, fast, slow))
    if rng is not None and jitter > 0.0:
        room = np.minimum(np.diff(t, prepend=t[0] - 1.0), np.diff(t, append=t[-1] + 1.0))
        moved = t + jitter * room * rng.uniform(-0.5, 0.5, t.size)
        edge = (np.abs(t) < 1e-9) | (np.abs(t - pulse_s) < 1e-9)
        t = np.where(edge, t, moved)
    return t


def closed_form(circuit: Circuit, t: Array, current: float, pulse_s: float, capacity: float
                ) -> tuple[Array, Array]:  # fmt: skip
    """Interval current [A] and voltage [V] at the row times."""
    inside = (t > 1e-9) & (t <= pulse_s + 1e-9)
    flow = np.where(inside, current, 0.0)
    charge = current * np.clip(t, 0.0, pulse_s) / 3600.0 / capacity
    x = 0.5 * current * pulse_s / 3600.0 / capacity - charge
    v = circuit.ocv + circuit.slope * x - circuit.r0 * flow
    for r, tau, v0 in ((circuit.r1, circuit.tau1, circuit.v1), (circuit.r2, circuit.tau2,
                                                                circuit.v2)):  # fmt: skip
        loaded = 1.0 - np.exp(-np.clip(t, 0.0, pulse_s) / tau)
        v = v - r * current * loaded * np.exp(-np.clip(t - pulse_s, 0.0, None) / tau)
        v = v - v0 * np.exp(-(t - t[0]) / tau)
    return flow, v


def closed_pulse(
    circuit: Circuit,
    t: Array,
    current: float = 20.0,
    pulse_s: float = 60.0,
    capacity: float = 40.0,
    noise: Array | float = 0.0,
) -> PulseData:
    """The pulse as the package takes it, at 50 % SOC, with the OCV's slope as a table."""
    flow, v = closed_form(circuit, t, current, pulse_s, capacity)
    start = int(np.argmax(flow != 0.0))
    stop = start + int(np.count_nonzero(flow))
    soc = 0.5 - current * np.clip(t, 0.0, pulse_s) / 3600.0 / capacity
    return pulse_data(t, flow, v + noise, soc, start, stop, ocv=lambda s: circuit.slope * s)


def random_circuit(rng: np.random.Generator) -> Circuit:
    """A circuit that a 60 s pulse with ten minutes of relaxation can tell."""
    return Circuit(
        r0=rng.uniform(1e-3, 4e-3),
        r1=rng.uniform(0.5e-3, 2e-3),
        tau1=rng.uniform(1.0, 8.0),
        r2=rng.uniform(0.5e-3, 4e-3),
        tau2=rng.uniform(25.0, 120.0),
        ocv=rng.uniform(3.2, 4.1),
        slope=rng.uniform(0.1, 4.0),
    )
