"""Days of cells that are a gauge's model's, as the gauge sees them, and how wrong it is on them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellwise.benchmark.certify.gauge import SAMPLE, Gauge, GaugeConfig, config_of
from cellwise.benchmark.certify.lives import SETTLED_S
from cellwise.benchmark.certify.restarts import REST_C, power_events
from cellwise.benchmark.certify.virtual_cells import NO_FAULT, CellSpread, draw_cell, with_sensor
from cellwise.benchmark.faults import faulty_log
from cellwise.cell.model_error import ModelError
from cellwise.cell.protocol import run_protocol
from cellwise.cell.simulate import simulate
from cellwise.estimate.sensor import Sensor
from cellwise.typing import BoolArray, FloatArray

PERFECT = Sensor(
    0.0, 0.0, 0.0, 0.0, 0.0, voltage_offset_V=0.0, voltage_noise_V=0.0, temperature_K=0.0
)
AS_THE_MODEL = CellSpread(*[0.0] * 9)
AGED_ALIKE = replace(
    AS_THE_MODEL,
    faded=CellSpread.faded,
    resistance_grown=CellSpread.resistance_grown,
    slipped_soc=CellSpread.slipped_soc,
)


@dataclass(frozen=True, eq=False)
class World:
    """A life as a gauge sees it, and the truth.

    Parameters
    ----------
    config : GaugeConfig
    current_A, voltage_V, temperature_C : (n,) float     what its sensors say
    true_A, true_V : (n,) float                          what is there
    warming_V : (n,) float    added where the cell is at the temperature of the gauge's numbers
    soc : (n,) float          true
    event : (n,) int          before each sample, as in a life
    on : (n,) bool            whether the power is on: what is scored
    """

    config: GaugeConfig
    current_A: FloatArray
    voltage_V: FloatArray
    temperature_C: FloatArray
    true_A: FloatArray
    true_V: FloatArray
    warming_V: FloatArray
    soc: FloatArray
    event: NDArray[Any]
    on: BoolArray

    def raised(self, by_V: FloatArray) -> World:
        """With another voltage of the cell."""
        return replace(self, voltage_V=self.voltage_V + by_V, true_V=self.true_V + by_V)

    def scaled(self, factor: float) -> World:
        """With another current through the cell."""
        return replace(self, current_A=factor * self.current_A, true_A=factor * self.true_A)

    def restarted(self, dt_s: float, capacity_Ah: float, rng: np.random.Generator) -> World:
        """With losses of power, as a certified life has them."""
        loaded = np.abs(self.true_A) > REST_C * capacity_Ah
        event, on = power_events(dt_s * np.arange(self.soc.size, dtype=np.float64), loaded, rng)
        return replace(self, event=event, on=on)


def world_of(
    gauge: Gauge, sensor: Sensor | None, hours: float, spread: CellSpread, key: tuple[int, int]
) -> World:
    """A cell that is the model's but for a spread, at some temperature; ``key``: seed, number."""
    seed, number = key
    model = replace(gauge.model, posterior=None, error=ModelError.of_white_and_slow(0.0, 0.0))
    cell = draw_cell(model, 2 * number, seed, hours, gauge.dt_s, PERFECT, spread)
    log = run_protocol(cell.truth, cell.steps, cell.soc0, gauge.dt_s, cell.temperature_C)
    log = log.part(0, int(np.searchsorted(log.time_s, 3600.0 * hours, side="right")))
    usual_C = np.full(len(log), gauge.model.usual_temperature_C)
    rng = np.random.default_rng([seed, number, 4])
    own = (sensor or PERFECT).of_cell(model.capacity_Ah)
    seen = faulty_log(with_sensor(NO_FAULT, own, model.capacity_Ah, rng), log, 1.0, rng)
    truth = simulate(cell.truth, log, cell.soc0)
    usual = simulate(cell.truth, replace(log, temperature_C=usual_C), cell.soc0)
    sensed_C = np.asarray(seen.temperature_C)
    return World(
        config_of(model, cell.soc0), seen.current_A, seen.voltage_V, sensed_C, log.current_A,
        log.voltage_V, usual.voltage_V - truth.voltage_V, truth.soc,
        np.zeros(len(log), np.uint32), np.ones(len(log), np.bool_),
    )  # fmt: skip


def score(gauge: Gauge, worlds: Sequence[World]) -> float:
    """RMS of the SOC error of lives whose first hour weighs as much as all that follows.

    A filter forgets its start, and a user sees it. A row without an answer is all wrong.
    """
    first = int(SETTLED_S / gauge.dt_s) + 1

    def squares(world: World) -> float:
        error = answers(gauge, world) - world.soc
        each = np.where(np.isfinite(error), error**2, 1.0)
        parts = (slice(None, first), slice(first, None))
        return float(np.mean([each[part][world.on[part]].mean() for part in parts]))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return float(np.sqrt(np.mean(list(pool.map(squares, worlds)))))


def answers(gauge: Gauge, world: World) -> FloatArray:
    """SOC that a gauge says at each row; without power it is handed nothing, and says nothing."""
    handed = world.on if world.event.any() else np.ones_like(world.on)
    samples = np.zeros(world.soc.size, dtype=SAMPLE)
    for name in ("current_A", "voltage_V", "temperature_C", "event"):
        samples[name] = getattr(world, name)
    samples["dt_s"] = gauge.dt_s
    soc = np.full(world.soc.size, np.nan)
    soc[handed] = gauge.run(world.config, samples[handed]).soc
    return soc
