"""Loads drawn at random: drives with regen and stops, pulses, steady loads, rests, charges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

LOWEST_SOC, FULL_SOC = 0.12, 0.985  # of the nominal cell: room for a cell that holds less


@dataclass(frozen=True, eq=False)
class Load:
    """Rows of true current [A] and surface temperature [degC]."""

    time_s: Array
    current_A: Array
    temperature_C: Array


def random_load(
    rng: np.random.Generator,
    capacity_Ah: float,
    soc0: float,
    *,
    rows: int,
    rate_hz: float,
    charge: bool,
    temperature_C: tuple[float, float],
) -> Load:
    """Stretches in a random order from ``soc0`` down, until the rows are full or the cell empty.

    The mean rate is such that the rows bring the cell low; ``charge`` puts a charge in the middle.
    """
    dt = 1.0 / rate_hz
    seconds = rows * dt
    rest = rng.uniform(60.0, 300.0)
    # What must flow in the rows that are neither the first rest nor other rests.
    mean = float(np.clip((soc0 - 0.15 + 0.25 * charge) * 3600.0 / (0.62 * seconds), 0.25, 1.3))
    charge_at = rng.uniform(0.3, 0.6) if charge else 2.0
    parts = [np.zeros(max(round(rest / dt), 2))]
    soc, count = soc0, parts[0].size
    while count < rows:
        if count / rows > charge_at:
            charge_at = 2.0
            part = _charge(rng, dt, soc)
        else:
            kinds: tuple[Callable[..., Array], ...] = (_drive, _drive, _drive, _pulses, _steady)
            part = kinds[rng.integers(len(kinds))](rng, dt, mean)
        part, soc = _within(part, soc, dt)
        parts.append(part)
        count += part.size
        if soc <= LOWEST_SOC + 0.01 or rng.random() < 0.3:
            idle = np.zeros(round(rng.uniform(60.0, 900.0) / dt))
            parts.append(idle)
            count += idle.size
        if soc <= LOWEST_SOC + 0.01:
            break
    rated = np.concatenate(parts)[:rows]
    rated[-min(round(120.0 / dt), rows // 20) :] = 0.0
    time = dt * np.arange(rated.size)
    return Load(time, capacity_Ah * rated, _surface(rng, time, temperature_C))


def _drive(rng: np.random.Generator, dt: float, mean: float) -> Array:
    """A vehicle: a wandering demand with braking, and stops."""
    rows = round(rng.uniform(300.0, 900.0) / dt)
    memory = np.exp(-dt / rng.uniform(3.0, 12.0))
    wander = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], rng.standard_normal(rows))
    demand = mean * (1.1 + rng.uniform(0.8, 1.6) * wander)
    demand = np.clip(demand, -rng.uniform(0.5, 1.5), rng.uniform(2.0, 3.5))
    for _ in range(rng.integers(1, 5)):
        begin = rng.integers(rows)
        demand[begin : begin + round(rng.uniform(10.0, 60.0) / dt)] = 0.0
    return demand


def _pulses(rng: np.random.Generator, dt: float, mean: float) -> Array:
    """Steps of several rates with rests between."""
    made = []
    for _ in range(rng.integers(4, 9)):
        rate = mean * rng.uniform(0.5, 3.0) * (1.0 if rng.random() < 0.8 else -0.5)
        made.append(np.full(round(rng.uniform(10.0, 60.0) / dt), np.clip(rate, -1.5, 3.5)))
        made.append(np.zeros(round(rng.uniform(20.0, 120.0) / dt)))
    return np.concatenate(made)


def _steady(rng: np.random.Generator, dt: float, mean: float) -> Array:
    return np.full(round(rng.uniform(120.0, 500.0) / dt), mean * rng.uniform(0.6, 1.6))


def _charge(rng: np.random.Generator, dt: float, soc: float) -> Array:
    rate = rng.uniform(0.5, 1.0)
    gained = min(rng.uniform(0.15, 0.30), 0.95 - soc)
    return np.full(max(round(max(gained, 0.02) * 3600.0 / rate / dt), 1), -rate)


def _within(part: Array, soc: float, dt: float) -> tuple[Array, float]:
    """The part with braking left out above full, cut where the cell is empty."""
    part = part.copy()
    level = soc - np.cumsum(part) * dt / 3600.0
    if level.max() > FULL_SOC:
        part[(level > FULL_SOC) & (part < 0.0)] = 0.0
        level = soc - np.cumsum(part) * dt / 3600.0
    empty = np.flatnonzero(level < LOWEST_SOC)
    stop = empty[0] + 1 if empty.size else part.size
    return part[:stop], float(level[stop - 1])


def _surface(rng: np.random.Generator, time: Array, between: tuple[float, float]) -> Array:
    """Ambient temperature that drifts and wanders within two limits."""
    low, high = between
    start, end = rng.uniform(low, high, 2)
    middle = rng.uniform(low, high)
    knots = np.array([0.0, rng.uniform(0.3, 0.7), 1.0]) * time[-1]
    return np.interp(time, knots, [start, middle, end]) + 0.3 * np.sin(time / rng.uniform(300, 900))
