"""Loads of a satellite in a low orbit and of a multicopter."""

from __future__ import annotations

import numpy as np

from .physics import FloatArray
from .tester import ConstantCurrent, RowPlan, Step

ORBIT_ROWS: RowPlan = ((10.0, 1.0), (1e9, 10.0))
ECLIPSE_S = 2160.0
SUN_S = 3240.0


def orbit_steps(nominal_Ah: float, orbits: int, rng: np.random.Generator) -> list[Step]:
    """Orbits of 90 minutes: 36 in eclipse on the battery, 54 in the sun to charge it to its limit.

    An eclipse takes about 30 % of nominal, by the bus and by a payload that is on for some minutes;
    the charge is held at the upper limit for the rest of the sunlit part.
    """
    steps: list[Step] = []
    for _ in range(orbits):
        before = float(rng.uniform(300.0, 1200.0))
        payload = float(rng.uniform(300.0, 720.0))
        bus, extra = rng.uniform(0.40, 0.46), rng.uniform(0.20, 0.35)
        for seconds, rate in (
            (before, bus),
            (payload, bus + extra),
            (ECLIPSE_S - before - payload, bus),
        ):
            steps.append(ConstantCurrent(round(rate * nominal_Ah, 3), ORBIT_ROWS, seconds))
        steps.append(ConstantCurrent(-0.4 * nominal_Ah, ORBIT_ROWS, SUN_S, hold_at_limit=True))
    return steps


def flight_current(nominal_Ah: float, hover_s: float, rng: np.random.Generator) -> FloatArray:
    """Current of one flight at 1 Hz, shape (n,) [A]: climb, hover and cruise in gusts, landing."""

    def gusty(seconds: float, rate: float, restless: float) -> FloatArray:
        rows = int(seconds)
        wander = np.zeros(rows)
        for k in range(1, rows):
            wander[k] = 0.85 * wander[k - 1] + restless * rng.standard_normal()
        return np.clip(rate + wander, 0.3, 2.9)

    parts = [gusty(20.0, 2.3, 0.03)]
    left = hover_s
    while left > 0.0:
        seconds = min(float(rng.uniform(30.0, 150.0)), left)
        parts.append(gusty(seconds, float(rng.uniform(1.0, 1.5)), 0.08))
        left -= seconds
        if rng.random() < 0.4:
            parts.append(gusty(8.0, 2.4, 0.05))
    parts.append(gusty(30.0, 0.9, 0.04))
    return np.round(np.concatenate(parts) * nominal_Ah, 2)
