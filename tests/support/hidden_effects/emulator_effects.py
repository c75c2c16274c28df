"""The sixteen effects as they are hidden: each of a size that is asked for in volt.

The size of an effect is the root mean square of what it adds to the error of a perfect plain model
that is driven by the logged current: the same measure for a sensor, a capacity and a resistance,
on every chemistry.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cellwise.diagnose.causes.catalogue import ON_REQUEST
from emulator import Array, Cell, Sensor, Table, emulate, flat, seen
from emulator_cells import FINE, rising, wave
from emulator_drives import Load

FARADAY_OVER_2RT = 96485.33 / (2.0 * 8.314463 * 298.15)  # [1/V]


@dataclass(frozen=True, eq=False)
class World:
    """A cell, its instrument, and by how much the logs begin above the SOC that is told."""

    cell: Cell
    sensor: Sensor = field(default_factory=Sensor)
    soc0_shift: float = 0.0


@dataclass(frozen=True, eq=False)
class Draw:
    """What is random in an effect besides its size."""

    sign: float
    shape: Array  # smooth over SOC, no mean, unit deviation
    slow_s: float
    gamma: float
    thermal_s: float


Values = dict[str, float]
Put = Callable[[World, Draw, float], tuple[World, Values]]


def draw_effect(rng: np.random.Generator) -> Draw:
    return Draw(
        sign=1.0 if rng.random() < 0.5 else -1.0,
        shape=wave(rng, np.linspace(0.0, 1.0, FINE), 3),
        slow_s=float(np.exp(rng.uniform(np.log(500.0), np.log(2500.0)))),
        gamma=float(np.exp(rng.uniform(np.log(10.0), np.log(80.0)))),
        thermal_s=float(np.exp(rng.uniform(np.log(200.0), np.log(1200.0)))),
    )


def _with_sensor(world: World, **values: float) -> tuple[World, Values]:
    return replace(world, sensor=replace(world.sensor, **values)), values


def _with_cell(world: World, **values: float) -> tuple[World, Values]:
    return replace(world, cell=replace(world.cell, **values)), values


def _current_offset(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    return _with_sensor(world, offset_A=draw.sign * x * 0.01 * world.cell.capacity_Ah)


def _current_gain(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    return _with_sensor(world, gain=1.0 + draw.sign * 0.01 * x)


def _voltage_offset(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    return _with_sensor(world, offset_V=draw.sign * 1e-3 * x)


def _time_skew(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    return _with_sensor(world, skew_s=0.1 * x)


def _initial_soc(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    shift = draw.sign * 0.01 * x
    return replace(world, soc0_shift=shift), {"soc0": shift}  # told SOC added when it is known


def _capacity(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    return _with_cell(world, capacity_Ah=world.cell.capacity_Ah * (1.0 - draw.sign * 0.01 * x))


def _resistance_scale(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    scale = 1.0 + draw.sign * 0.02 * x
    c = world.cell
    cell = replace(
        c,
        r0_ohm=c.r0_ohm.times(scale),
        r1_ohm=c.r1_ohm.times(scale),
        r2_ohm=c.r2_ohm.times(scale),
        r3_ohm=c.r3_ohm.times(scale),
    )
    return replace(world, cell=cell), {"scale": scale}


def _ocv_shift(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    ocv = world.cell.ocv_V(np.linspace(0.0, 1.0, FINE))
    ocv = rising(ocv + draw.sign * 1e-3 * x * draw.shape)
    return replace(world, cell=replace(world.cell, ocv_V=Table(ocv))), {}


def _slow_diffusion(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    values = {"r3_ohm": 0.005 * x / world.cell.capacity_Ah, "tau3_s": draw.slow_s}
    if np.any(world.cell.r3_ohm.values > 0.0):  # a cell that has one: it gets stronger
        grown = Table(world.cell.r3_ohm(np.linspace(0.0, 1.0, FINE)) + values["r3_ohm"])
        return replace(world, cell=replace(world.cell, r3_ohm=grown)), values
    cell = replace(world.cell, r3_ohm=flat(values["r3_ohm"]), tau3_s=flat(values["tau3_s"]))
    return replace(world, cell=cell), values


def _hysteresis(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    values = {"m_V": 1e-3 * x, "gamma": draw.gamma}
    cell = replace(world.cell, m_V=flat(values["m_V"]), gamma=values["gamma"])
    return replace(world, cell=cell), values


def _temperature(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    return _with_cell(world, activation_K=world.cell.activation_K + 200.0 * x)


def _rate(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    return _with_cell(world, rate_h=0.02 * x)


def _charge_transfer(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    """The reaction runs more slowly: what was linear in the current follows asinh now."""
    scale = 1.0 + 0.1 * x
    r1 = world.cell.r1_ohm.times(scale)
    changed, _ = _with_cell(world, r1_ohm=r1, transfer_per_V=FARADAY_OVER_2RT)
    return changed, {"exchange_scale": 1.0 / scale}


def _charge_asymmetry(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    return _with_cell(world, charge_scale=(1.0 + 0.05 * x) ** draw.sign)


def _self_heating(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    c = world.cell
    at_1c = c.capacity_Ah**2 * float(np.mean(c.r0_ohm.values + c.r1_ohm.values + c.r2_ohm.values))
    return _with_cell(world, rth_K_per_W=x / at_1c, thermal_s=draw.thermal_s)  # x kelvin at 1C


def _self_discharge(world: World, draw: Draw, x: float) -> tuple[World, Values]:
    return _with_cell(world, leak_A=0.01 * x * world.cell.capacity_Ah)


# name: how it is put in, and the largest amplitude that is still physical
EFFECTS: dict[str, tuple[Put, float]] = {
    "current_offset": (_current_offset, 12.0),
    "current_gain": (_current_gain, 20.0),
    "voltage_offset": (_voltage_offset, 60.0),
    "time_skew": (_time_skew, 50.0),
    "initial_soc": (_initial_soc, 12.0),
    "capacity": (_capacity, 15.0),
    "resistance_scale": (_resistance_scale, 25.0),
    "ocv_shift": (_ocv_shift, 60.0),
    "slow_diffusion": (_slow_diffusion, 40.0),
    "hysteresis": (_hysteresis, 60.0),
    "temperature_dependence": (_temperature, 40.0),
    "rate_dependence": (_rate, 25.0),
    "charge_asymmetry": (_charge_asymmetry, 20.0),
    "self_heating": (_self_heating, 30.0),
    "self_discharge": (_self_discharge, 12.0),
    "charge_transfer": (_charge_transfer, 40.0),
}
NAMES = tuple(n for n in EFFECTS if n not in ON_REQUEST)

# Effects that leave alike traces: a pair is drawn from two of these families.
FAMILIES = (
    ("current_offset", "self_discharge", "initial_soc", "capacity", "current_gain"),
    (
        "resistance_scale",
        "temperature_dependence",
        "rate_dependence",
        "charge_asymmetry",
        "self_heating",
    ),
    ("voltage_offset", "ocv_shift", "hysteresis", "slow_diffusion"),
    ("time_skew",),
)

# The parameter that says how large an effect is, and where it is neutral (of the model: a name).
PRINCIPAL: dict[str, tuple[str, float | str]] = {
    "current_offset": ("offset_A", 0.0),
    "current_gain": ("gain", 1.0),
    "voltage_offset": ("offset_V", 0.0),
    "time_skew": ("skew_s", 0.0),
    "initial_soc": ("soc0", "told"),
    "capacity": ("capacity_Ah", "model"),
    "resistance_scale": ("scale", 1.0),
    "slow_diffusion": ("r3_ohm", 0.0),
    "hysteresis": ("m_V", 0.0),
    "temperature_dependence": ("activation_K", 0.0),
    "rate_dependence": ("rate_h", 0.0),
    "charge_asymmetry": ("charge_scale", 1.0),
    "self_heating": ("rth_K_per_W", 0.0),
    "self_discharge": ("leak_A", 0.0),
    "charge_transfer": ("exchange_scale", 1.0),
}


def added_error_V(plain: World, changed: World, load: Load, told_soc0: float) -> Array:
    """What the change adds to a perfect plain model's error on a load, row by row [V]."""
    start = told_soc0 + changed.soc0_shift
    run = emulate(changed.cell, load.time_s, load.current_A, load.temperature_C, start)
    current, voltage = seen(run, changed.sensor)
    model = emulate(plain.cell, load.time_s, current, load.temperature_C, told_soc0)
    return np.asarray(voltage - model.voltage_V)


def amplitude(
    name: str, draw: Draw, plain: World, loads: Sequence[tuple[Load, float]], size_V: float
) -> float:
    """The amplitude at which the effect has the wanted size, as near as physics allows.

    The size grows about in proportion to the amplitude: a few steps of the rule of three do.
    """
    put, largest = EFFECTS[name]
    x = largest / 4.0
    for _ in range(4):
        is_V = size_of(plain, put(plain, draw, x)[0], loads)
        x = float(np.clip(x * size_V / max(is_V, 1e-9), 1e-3, largest))
        if abs(is_V / size_V - 1.0) < 0.02:
            break
    return _within_soc(put, draw, plain, loads, x)


def size_of(plain: World, changed: World, loads: Sequence[tuple[Load, float]]) -> float:
    """Root mean square of what the change adds to a perfect plain model's error [V]."""
    parts = [added_error_V(plain, changed, load, soc0) for load, soc0 in loads]
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def _within_soc(
    put: Put, draw: Draw, plain: World, loads: Sequence[tuple[Load, float]], x: float
) -> float:
    """The amplitude, made smaller until no log leaves 2 % to 100 % of the true cell."""
    for _ in range(20):
        changed, _ = put(plain, draw, x)
        soc = np.concatenate(
            [
                emulate(
                    changed.cell,
                    load.time_s,
                    load.current_A,
                    load.temperature_C,
                    told + changed.soc0_shift,
                ).soc
                for load, told in loads
            ]
        )
        if soc.min() >= 0.02 and soc.max() <= 1.0:
            return x
        x *= 0.8
    return x
