"""What makes a gauge wrong: each cause made perfect in turn on cells that its model describes.

A gauge's own numbers cannot be seen. So the world is made to fit them: the current is scaled until
the gauge's capacity is right, the voltage moved until its table is, and what that takes off the
error is the cause's. A gauge that keeps its table in its source is judged like any other.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from cellwise.benchmark.certify.gauge import SAMPLE, Gauge, GaugeConfig, config_of
from cellwise.benchmark.certify.lives import SETTLED_S
from cellwise.benchmark.certify.virtual_cells import NO_FAULT, CellSpread, draw_cell, with_sensor
from cellwise.benchmark.faults import faulty_log
from cellwise.cell.model_error import ModelError
from cellwise.cell.protocol import run_protocol
from cellwise.cell.simulate import simulate
from cellwise.estimate.sensor import Sensor
from cellwise.typing import FloatArray

PERFECT = Sensor(
    0.0, 0.0, 0.0, 0.0, 0.0, voltage_offset_V=0.0, voltage_noise_V=0.0, temperature_K=0.0
)
AS_THE_MODEL = CellSpread(*[0.0] * 9)
LIVES, HOURS = 8, 24.0
COARSE, FINE = 7, 8  # values of a correction that are tried over its range, and around the best
PROBED, PROBE_H, FAR_SOC = 21, 24.0, 0.1  # SOC points at which the table is looked at, and how


@dataclass(frozen=True, eq=False)
class World:
    """A life as a gauge sees it, and the truth.

    Parameters
    ----------
    config : GaugeConfig
    current_A, voltage_V, temperature_C : (n,) float     what its sensors say
    true_A, true_V : (n,) float                          what is there
    usual_V : (n,) float      the voltage at the temperature that the gauge's numbers are of
    soc : (n,) float          true
    """

    config: GaugeConfig
    current_A: FloatArray
    voltage_V: FloatArray
    temperature_C: FloatArray
    true_A: FloatArray
    true_V: FloatArray
    usual_V: FloatArray
    soc: FloatArray


class GaugeCause(NamedTuple):
    """What a cause costs in points of SOC error (RMS), and what was corrected for it."""

    name: str
    points: float
    correction: float
    unit: str

    def to_dict(self) -> dict[str, object]:
        """As JSON values."""
        return self._asdict()


Correct = Callable[[World, float], World]


class WorldCorrection(NamedTuple):
    """How the world is made to fit a gauge: by a number from ``low`` to ``high``, of a unit."""

    name: str
    unit: str
    low: float
    high: float
    corrected: Correct


def own_causes(
    gauge: Gauge, sensor: Sensor | None, seed: int
) -> tuple[list[GaugeCause], float, float]:
    """Causes of a gauge's own, the largest first; its error as it is, and without them.

    Parameters
    ----------
    sensor : Sensor or None     the target's, where it is stated; None: perfect ones
    seed : int                  of the lives

    Returns
    -------
    (list of GaugeCause, float, float)     the errors as of `score`
    """
    worlds = [world_of(gauge, sensor, seed, k) for k in range(LIVES)]
    base = score(gauge, worlds)
    found, fitted = [], []
    for one in corrections(gauge, worlds[0].config):
        value, error = _search(gauge, worlds, one)
        found.append(GaugeCause(one.name, base - error, value, one.unit))
        fitted.append((base - error, one, value))
    left = base
    for gain, one, value in sorted(fitted, key=lambda f: -f[0]):
        moved = [one.corrected(world, value) for world in worlds]
        error = score(gauge, moved) if gain > 0.0 else math.inf
        if error < left:
            left, worlds = error, moved
    return sorted(found, key=lambda c: -c.points), base, left


def world_of(gauge: Gauge, sensor: Sensor | None, seed: int, number: int) -> World:
    """A cell that is the model's, at some temperature, for a day."""
    model = replace(gauge.model, posterior=None, error=ModelError.of_white_and_slow(0.0, 0.0))
    cell = draw_cell(model, 2 * number, seed, HOURS, gauge.dt_s, PERFECT, AS_THE_MODEL)
    log = run_protocol(cell.truth, cell.steps, cell.soc0, gauge.dt_s, cell.temperature_C)
    log = log.part(0, int(np.searchsorted(log.time_s, 3600.0 * HOURS, side="right")))
    usual_C = np.full(len(log), gauge.model.usual_temperature_C)
    rng = np.random.default_rng([seed, number, 4])
    own = (sensor or PERFECT).of_cell(model.capacity_Ah)
    seen = faulty_log(with_sensor(NO_FAULT, own, model.capacity_Ah, rng), log, 1.0, rng)
    truth = simulate(cell.truth, log, cell.soc0)
    usual = simulate(cell.truth, replace(log, temperature_C=usual_C), cell.soc0)
    sensed_C = np.asarray(seen.temperature_C)
    usual_V = log.voltage_V + usual.voltage_V - truth.voltage_V
    return World(
        config_of(cell.truth, cell.soc0), seen.current_A, seen.voltage_V, sensed_C, log.current_A,
        log.voltage_V, usual_V, truth.soc,
    )  # fmt: skip


def score(gauge: Gauge, worlds: Sequence[World]) -> float:
    """RMS of the SOC error of lives whose first hour weighs as much as all that follows.

    A filter forgets its start, and a user sees it. A row without an answer is all wrong.
    """
    first = int(SETTLED_S / gauge.dt_s) + 1

    def squares(world: World) -> tuple[float, float]:
        error = gauge.run(world.config, samples(world, gauge.dt_s)).soc - world.soc
        each = np.where(np.isfinite(error), error**2, 1.0)
        return float(each[:first].mean()), float(each[first:].mean())

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return float(np.sqrt(np.mean(list(pool.map(squares, worlds)))))


def samples(world: World, dt_s: float) -> np.ndarray:
    """What a gauge is handed."""
    found = np.zeros(world.soc.size, dtype=SAMPLE)
    for name in ("current_A", "voltage_V", "temperature_C"):
        found[name] = getattr(world, name)
    found["dt_s"] = dt_s
    return found


def corrections(gauge: Gauge, config: GaugeConfig) -> list[WorldCorrection]:
    """What can be made perfect, with the range that its number is searched in."""
    size_Ah, r0_ohm = config.capacity_Ah, config.r0_ohm
    table = _table(gauge, config)

    def capacity(world: World, factor: float) -> World:
        kept_V = world.voltage_V - (factor - 1.0) * r0_ohm * world.current_A
        return replace(world, current_A=factor * world.current_A, voltage_V=kept_V)

    def resistance(world: World, share: float) -> World:
        return replace(world, voltage_V=world.voltage_V + share * r0_ohm * world.current_A)

    def start(world: World, soc: float) -> World:
        return replace(world, config=world.config._replace(soc0=world.config.soc0 + soc))

    def offset(world: World, current_A: float) -> World:
        return replace(world, current_A=world.true_A + current_A)

    def voltage(world: World, voltage_V: float) -> World:
        return replace(world, voltage_V=world.true_V + voltage_V)

    def warm(world: World, _: float) -> World:
        usual_C = np.full(world.soc.size, gauge.model.usual_temperature_C)
        moved_V = world.voltage_V + world.usual_V - world.true_V
        return replace(world, voltage_V=moved_V, temperature_C=usual_C)

    def fitting(world: World, share: float) -> World:
        return replace(world, voltage_V=world.voltage_V + share * table(world.soc))

    return [
        WorldCorrection("capacity", "of the capacity", 0.7, 1.4, capacity),
        WorldCorrection("resistance", "of R0", -1.0, 2.0, resistance),
        WorldCorrection("start", "SOC", -0.35, 0.35, start),
        WorldCorrection("current_sensor", "A", -0.04 * size_Ah, 0.04 * size_Ah, offset),
        WorldCorrection("voltage_sensor", "V", -0.06, 0.06, voltage),
        WorldCorrection("temperature", "", 0.0, 0.0, warm),
        WorldCorrection("table", "of what the gauge's table is off by", 0.0, 1.0, fitting),
    ]


def _search(gauge: Gauge, worlds: Sequence[World], one: WorldCorrection) -> tuple[float, float]:
    """The number that a correction does most with, and the error then."""

    def error(value: float) -> float:
        return score(gauge, [one.corrected(world, value) for world in worlds])

    if one.low == one.high:
        return one.low, error(one.low)
    tried = np.linspace(one.low, one.high, COARSE)
    errors = [error(value) for value in tried]
    best = int(np.argmin(errors))
    around = tried[max(best - 1, 0)], tried[min(best + 1, COARSE - 1)]
    finer = minimize_scalar(error, bounds=around, method="bounded", options={"maxiter": FINE})
    return min((errors[best], tried[best]), (float(finer.fun), float(finer.x)))[::-1]


def _table(gauge: Gauge, config: GaugeConfig) -> Callable[[FloatArray], FloatArray]:
    """By SOC, what must be added to a voltage for the gauge to read it rightly; 0: no table seen.

    It is looked at in rests of a day: where a gauge comes to from two starts is its table's SOC,
    and one that stays where it was has none.
    """
    soc = np.linspace(0.05, 0.95, PROBED)
    rests = np.interp(soc, config.soc, config.ocv_V)
    low, high = (_rested(gauge, config, rests, soc + far) for far in (-FAR_SOC, FAR_SOC))
    reads = 0.5 * (low + high)
    if not np.all(np.isfinite(reads)) or np.mean(np.abs(high - low)) > FAR_SOC:
        return np.zeros_like
    reads, kept = np.unique(np.maximum.accumulate(reads), return_index=True)
    off_V = np.interp(soc, reads, rests[kept]) - rests  # the voltage that it reads as this SOC
    return lambda at: np.asarray(np.interp(at, soc, off_V))


def _rested(
    gauge: Gauge, config: GaugeConfig, rests_V: FloatArray, starts: FloatArray
) -> FloatArray:
    """Where a gauge comes to in rests at voltages, each from its start."""
    rows = max(int(3600.0 * PROBE_H / gauge.dt_s), 2)

    def rest(one: tuple[float, float]) -> float:
        found = np.zeros(rows, dtype=SAMPLE)
        found["voltage_V"], found["dt_s"] = one[0], gauge.dt_s
        found["temperature_C"] = gauge.model.usual_temperature_C
        started = config._replace(soc0=float(np.clip(one[1], 0.0, 1.0)))
        return float(gauge.run(started, found).soc[-1])

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return np.array(list(pool.map(rest, zip(rests_V, starts, strict=True))))
