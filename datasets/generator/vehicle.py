"""Stochastic driving: micro-trips of speed, road load, current of one cell.

No standard cycle is copied: speeds are drawn, so every seed is another route and a licence is no
question. Longitudinal dynamics as in any textbook:

    P_wheel = (m a + m g (c_r + slope) + 1/2 rho c_d A v^2) v
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .physics import FloatArray

GRAVITY = 9.81
AIR_DENSITY = 1.2


@dataclass(frozen=True)
class Vehicle:
    """Car and pack: power at the wheels to current of one cell.

    Attributes
    ----------
    mass_kg, drag_area_m2, rolling : float    road load; drag_area_m2 is c_d times the front area
    efficiency : float                        of the drive line, used both ways
    auxiliary_W : float                       heater, lights, computers [W]
    cells : int                               cells that share the power
    cell_V : float                            voltage at which power becomes current [V]
    peak_A, regen_A : float                   limits of the inverter per cell [A]
    """

    cells: int
    cell_V: float
    peak_A: float
    regen_A: float
    mass_kg: float = 1650.0
    drag_area_m2: float = 0.62
    rolling: float = 0.0095
    efficiency: float = 0.87
    auxiliary_W: float = 450.0


@dataclass(frozen=True)
class Style:
    """How a kind of road is driven: ranges from which each micro-trip draws.

    Attributes
    ----------
    speed_kmh : (low, high)         cruising speed
    cruise_s : (low, high)          time at about that speed
    accelerate, brake : (low, high) [m/s2]
    stop_s : (low, high)            standing time afterwards
    restless : float                standard deviation of the speed while cruising [m/s]
    slope : float                   standard deviation of the road's slope
    """

    speed_kmh: tuple[float, float]
    cruise_s: tuple[float, float]
    accelerate: tuple[float, float]
    brake: tuple[float, float]
    stop_s: tuple[float, float]
    restless: float
    slope: float


URBAN = Style((22.0, 58.0), (8.0, 60.0), (0.8, 2.3), (0.9, 2.4), (2.0, 40.0), 0.7, 0.008)
RURAL = Style((55.0, 95.0), (60.0, 240.0), (0.8, 2.2), (0.8, 2.0), (0.0, 15.0), 1.2, 0.018)
MOTORWAY = Style((95.0, 130.0), (180.0, 600.0), (0.7, 1.8), (0.5, 1.6), (0.0, 6.0), 1.8, 0.012)


def _ramp(start: float, end: float, rate: float) -> FloatArray:
    """Speeds of a ramp at 1 Hz, without its first value, softened at both ends [m/s]."""
    seconds = max(2, int(np.ceil(abs(end - start) / rate)))
    phase = np.arange(1, seconds + 1) / seconds
    blend = 0.6 * phase + 0.4 * (3.0 * phase**2 - 2.0 * phase**3)
    return np.asarray(start + (end - start) * blend, dtype=np.float64)


def _wander(seconds: int, deviation: float, rng: np.random.Generator) -> FloatArray:
    """Speed about its target at 1 Hz, shape (seconds,), standard deviation about `deviation` [m/s].

    A damped oscillator kicked at random: acceleration has a memory of some seconds, as a foot on
    a pedal has, and the speed is drawn back to the target.
    """
    damping, stiffness = 0.15, 0.004
    kick = deviation * np.sqrt(2.0 * damping * stiffness)
    speeds = np.zeros(seconds)
    speed = acceleration = 0.0
    for k, noise in enumerate(rng.standard_normal(seconds)):
        acceleration += -damping * acceleration - stiffness * speed + kick * noise
        speed += acceleration
        speeds[k] = speed
    return speeds


def micro_trip(style: Style, rng: np.random.Generator) -> FloatArray:
    """One trip from standstill to standstill: speed at 1 Hz, shape (n,) [m/s].

    Half the trips change their cruising speed once on the way, as traffic demands.
    """
    parts: list[FloatArray] = []
    speed = 0.0
    for _ in range(1 + int(rng.random() < 0.5)):
        target = rng.uniform(*style.speed_kmh) / 3.6
        limits = style.accelerate if target > speed else style.brake
        parts.append(_ramp(speed, target, rng.uniform(*limits)))
        seconds = int(rng.uniform(*style.cruise_s))
        wander = _wander(seconds, style.restless, rng)
        wander *= np.minimum(1.0, np.arange(seconds, 0, -1) / 10.0)
        parts.append(np.maximum(target + wander, 0.5))
        speed = target
    parts.append(_ramp(speed, 0.0, rng.uniform(*style.brake)))
    parts.append(np.zeros(1 + int(rng.uniform(*style.stop_s))))
    return np.concatenate(parts)


def cell_current(
    speed: FloatArray, slope_sd: float, vehicle: Vehicle, rng: np.random.Generator
) -> FloatArray:
    """Current of one cell for a speed trace at 1 Hz, shape (n,), positive on discharge [A]."""
    rows = speed.size
    slope = np.zeros(rows)
    for k in range(1, rows):
        slope[k] = 0.97 * slope[k - 1] + 0.243 * slope_sd * rng.standard_normal()
    acceleration = np.diff(speed, prepend=speed[0])
    force = vehicle.mass_kg * (acceleration + GRAVITY * (vehicle.rolling + slope) * (speed > 0))
    force += 0.5 * AIR_DENSITY * vehicle.drag_area_m2 * speed**2
    wheel = force * speed
    electric = np.where(wheel > 0, wheel / vehicle.efficiency, wheel * vehicle.efficiency)
    # Below walking pace friction brakes take over from the machine.
    electric = np.where((wheel < 0) & (speed < 2.0), 0.0, electric)
    current = (electric + vehicle.auxiliary_W) / (vehicle.cells * vehicle.cell_V)
    limited = np.clip(current, -vehicle.regen_A, vehicle.peak_A)
    return np.round(limited, 2)


def drive_current(
    styles: tuple[Style, ...], vehicle: Vehicle, charge_Ah: float, rng: np.random.Generator
) -> FloatArray:
    """Currents at 1 Hz of a drive that takes a net charge from the cell, shape (n,) [A].

    Parameters
    ----------
    styles : tuple of Style        each micro-trip draws one of them
    vehicle : Vehicle
    charge_Ah : float              where the drive ends: net discharged charge [Ah]
    rng : numpy.random.Generator
    """
    parts: list[FloatArray] = []
    taken = 0.0
    while taken < charge_Ah:
        style = styles[int(rng.integers(len(styles)))]
        trip = micro_trip(style, rng)
        current = cell_current(trip, style.slope, vehicle, rng)
        parts.append(current)
        taken += float(current.sum()) / 3600.0
    current = np.concatenate(parts)
    enough = int(np.argmax(np.cumsum(current) >= 3600.0 * charge_Ah))
    return current[: enough + 1]


def depleting_cycle(
    vehicle: Vehicle, charge_Ah: float, seconds: int, rng: np.random.Generator
) -> FloatArray:
    """One charge-depleting cycle of exact length and exact net charge, shape (seconds,) [A].

    Town and country in turn, cut to length; the mean is then moved to the wanted charge, which
    stands for a change of the auxiliary load.
    """
    parts: list[FloatArray] = []
    length = 0
    while length < seconds:
        style = (URBAN, RURAL)[len(parts) % 2]
        trip = micro_trip(style, rng)
        parts.append(cell_current(trip, style.slope, vehicle, rng))
        length += trip.size
    current = np.concatenate(parts)[:seconds]
    share = 3600.0 * charge_Ah / float(current.sum())
    if 0.5 < share < 2.0:
        current = current * share
    current = current + (3600.0 * charge_Ah - float(current.sum())) / seconds
    return np.round(current, 3)
