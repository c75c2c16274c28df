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
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from cellwise.benchmark.certify.gauge import SAMPLE, Gauge, GaugeConfig
from cellwise.benchmark.certify.virtual_cells import CellSpread
from cellwise.benchmark.certify.worlds import AGED_ALIKE, AS_THE_MODEL, World, score, world_of
from cellwise.estimate.sensor import Sensor
from cellwise.typing import FloatArray

LIVES, HOURS = 8, 24.0
MUCH = 0.1  # of the error: less is not worth a correction
COARSE, FINE = 7, 8  # values of a correction that are tried over its range, and around the best
PROBED, PROBE_H, FAR_SOC = 21, 24.0, 0.1  # SOC points at which the table is looked at, and how


class GaugeCause(NamedTuple):
    """What a cause costs in points of SOC error (RMS), and what was corrected for it.

    ``is_open``: an end of the correction's range does as well, so that no value is the right one.
    """

    name: str
    points: float
    correction: float = 0.0
    unit: str = ""
    is_open: bool = False

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


Fitted = tuple[WorldCorrection, float, float, bool]  # as of `_search`


def own_causes(
    gauge: Gauge, sensor: Sensor | None, seed: int
) -> tuple[list[GaugeCause], float, float]:
    """Causes of a gauge's own, the largest first; its error as it is, and without them.

    What a cause costs depends on what else is wrong: its points are the mean of what it takes off
    the error alone, and of what it puts back onto the error with every cause made right.

    Parameters
    ----------
    sensor : Sensor or None     the target's, where it is stated; None: perfect ones
    seed : int                  of the lives

    Returns
    -------
    (list of GaugeCause, float, float)     the errors as of `score`
    """
    worlds = _drawn(gauge, sensor, seed, AS_THE_MODEL)
    base = score(gauge, worlds)
    tried = corrections(gauge, worlds[0].config)
    alone = [(one, *_search(gauge, worlds, one)) for one in tried]
    right, left = _all_right(gauge, worlds, base, alone)
    found = []
    for one, value, error, is_open in alone:
        others = [other for other in right if other[0] is not one]
        back = left if len(others) == len(right) else score(gauge, _moved(worlds, others))
        points = 0.5 * (base - error + back - left)
        found.append(GaugeCause(one.name, points, value, one.unit, is_open))
    # Of the squares: what remains with everything else right.
    tuning = base - math.sqrt(max(base**2 - left**2, 0.0))
    aged = score(gauge, _drawn(gauge, sensor, seed, AGED_ALIKE))
    found += [
        GaugeCause("tuning", tuning),
        GaugeCause("age", aged - base),
        GaugeCause("restart", _restart_cost(gauge, worlds, seed)),
    ]
    return sorted(found, key=lambda c: -c.points), base, left


def to_correct(found: Sequence[GaugeCause], error: float) -> str | None:
    """The wrong number whose correction brings most; None: no correction brings much.

    What aged cells and losses of power add, what tuning leaves: no number of a gauge corrects it.
    What else seems wrong may be right once this one is.
    """
    much = (c.name for c in found if c.unit and not c.is_open and c.points > MUCH * error)
    return next(much, None)


def _drawn(gauge: Gauge, sensor: Sensor | None, seed: int, spread: CellSpread) -> list[World]:
    return [world_of(gauge, sensor, HOURS, spread, (seed, k)) for k in range(LIVES)]


def _restart_cost(gauge: Gauge, worlds: Sequence[World], seed: int) -> float:
    """What losses of power add to the error, of the rows with power."""
    size_Ah = worlds[0].config.capacity_Ah
    lost = [
        world.restarted(gauge.dt_s, size_Ah, np.random.default_rng([seed, k, 5]))
        for k, world in enumerate(worlds)
    ]
    same_rows = [replace(world, on=one.on) for world, one in zip(worlds, lost, strict=True)]
    return score(gauge, lost) - score(gauge, same_rows)


def _all_right(
    gauge: Gauge, worlds: list[World], base: float, alone: Sequence[Fitted]
) -> tuple[list[tuple[WorldCorrection, float]], float]:
    """Corrections that help beside each other with their numbers, and the error with all."""
    right: list[tuple[WorldCorrection, float]] = []
    left = base
    for one, _, error_alone, _ in sorted(alone, key=lambda fitted: fitted[2]):
        if error_alone < base:
            value, error, _ = _search(gauge, worlds, one)
            if error < left:
                left = error
                right.append((one, value))
                worlds = _moved(worlds, right[-1:])
    return right, left


def _moved(
    worlds: Sequence[World], corrected: Sequence[tuple[WorldCorrection, float]]
) -> list[World]:
    found = list(worlds)
    for one, value in corrected:
        found = [one.corrected(world, value) for world in found]
    return found


def corrections(gauge: Gauge, config: GaugeConfig) -> list[WorldCorrection]:
    """What can be made perfect, with the range that its number is searched in."""
    size_Ah, r0_ohm = config.capacity_Ah, config.r0_ohm
    table = _table(gauge, config)

    def capacity(world: World, factor: float) -> World:
        return world.raised((1.0 - factor) * r0_ohm * world.current_A).scaled(factor)

    def resistance(world: World, share: float) -> World:
        return world.raised(share * r0_ohm * world.current_A)

    def start(world: World, soc: float) -> World:
        return replace(world, config=world.config._replace(soc0=world.config.soc0 + soc))

    def offset(world: World, current_A: float) -> World:
        return replace(world, current_A=world.true_A + current_A)

    def voltage(world: World, voltage_V: float) -> World:
        return replace(world, voltage_V=world.true_V + voltage_V)

    def warm(world: World, _: float) -> World:
        usual_C = np.full(world.soc.size, gauge.model.usual_temperature_C)
        return replace(world.raised(world.warming_V), temperature_C=usual_C)

    def fitting(world: World, share: float) -> World:
        return world.raised(share * table(world.soc))

    return [
        WorldCorrection("capacity", "of the capacity", 0.7, 1.4, capacity),
        WorldCorrection("resistance", "of R0", -1.0, 4.0, resistance),
        WorldCorrection("start", "SOC", -0.35, 0.35, start),
        WorldCorrection("current_sensor", "A", -0.04 * size_Ah, 0.04 * size_Ah, offset),
        WorldCorrection("voltage_sensor", "V", -0.06, 0.06, voltage),
        WorldCorrection("temperature", "", 0.0, 0.0, warm),
        WorldCorrection("table", "of what the gauge's table is off by", 0.0, 1.25, fitting),
    ]


def _search(
    gauge: Gauge, worlds: Sequence[World], one: WorldCorrection
) -> tuple[float, float, bool]:
    """The number that a correction does most with, the error then, and whether an end does too."""

    def error(value: float) -> float:
        return score(gauge, [one.corrected(world, value) for world in worlds])

    if one.low == one.high:
        return one.low, error(one.low), False
    tried = np.linspace(one.low, one.high, COARSE)
    errors = [error(value) for value in tried]
    best = int(np.argmin(errors))
    around = tried[max(best - 1, 0)], tried[min(best + 1, COARSE - 1)]
    finer = minimize_scalar(error, bounds=around, method="bounded", options={"maxiter": FINE})
    least, value = min((errors[best], float(tried[best])), (float(finer.fun), float(finer.x)))
    return value, least, min(errors[0], errors[-1]) <= least


def _table(gauge: Gauge, config: GaugeConfig) -> Callable[[FloatArray], FloatArray]:
    """By SOC, what must be added to a voltage for the gauge to read it rightly; 0: no table seen.

    It is looked at in rests of a day: where a gauge comes to from two starts is its table's SOC,
    and one that stays where it was has none.
    """
    soc = np.linspace(0.05, 0.95, PROBED)
    rests = np.interp(soc, config.soc, config.ocv_V)
    starts = [np.clip(soc + far, 0.0, 1.0) for far in (-FAR_SOC, FAR_SOC)]
    low, high = (_rested(gauge, config, rests, start) for start in starts)
    kept = (high - low) / (starts[1] - starts[0])  # of where it started
    reads = (low - kept * starts[0]) / np.maximum(1.0 - kept, 0.5)  # where it would stay
    if not np.all(np.isfinite(reads)) or np.mean(np.abs(kept)) > 0.5:
        return np.zeros_like
    reads, first = np.unique(np.maximum.accumulate(reads), return_index=True)
    off_V = np.interp(soc, reads, rests[first]) - rests  # the voltage that it reads as this SOC
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
        started = config._replace(soc0=float(one[1]))
        return float(gauge.run(started, found).soc[-1])

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return np.array(list(pool.map(rest, zip(rests_V, starts, strict=True))))
