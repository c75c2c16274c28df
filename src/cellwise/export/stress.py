"""Samples with every fault, and what a step costs under them at most."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import model_temperature_C
from cellwise.estimate.fixed.layout import INPUT
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.estimate.status import GATE_RECOVERY
from cellwise.export.cross import run_on_target

ROUND = 3000  # samples between two rounds of persistent faults
STEPS = 3000
EVERY = 5
START_SOC, START_VARIANCE, NARROW = 0.9, 0.01, 1e-5
LOCK_OUT_STEPS, SETTLED = 200, 50


@dataclass(frozen=True)
class WorstCase:
    """Instructions of the costliest steps [1].

    ``stress`` is the most under stress, ``reset`` that of a step which re-initialises SOC after a
    lock-out, or widens its variance (None where the voltage of an empty cell locks nothing out);
    ``stack_bytes`` the most that either took.
    """

    stress: float
    reset: float | None
    stack_bytes: int


def stress_samples(
    rows: int,
    seed: int = 0,
    scale_A: float = 3.0,
    rest_V: float = 3.7,
    off_V: tuple[float, ...] = (3.1, 3.4, 4.1),
) -> NDArray[Any]:
    """Random samples with every fault, records of INPUT.

    Any bits, repeated and missing sequence numbers, sensors that fall silent, freeze or are off by
    volts. ``scale_A`` is a current of the cell's size, ``rest_V`` a voltage in its middle,
    ``off_V`` voltages that contradict it.
    """
    rng = np.random.default_rng(seed)
    samples = np.zeros(rows, dtype=INPUT)
    samples["current_A"] = rng.normal(0.2, 1.0, rows) * scale_A
    samples["voltage_V"] = rest_V + rng.normal(0.0, 0.1, rows)
    samples["temperature_C"] = rng.uniform(-25.0, 50.0, rows)
    jumps = rng.choice([1] * 50 + [0, 2, 3, 50, 10**5, 10**9, 2**32 - 3], rows)
    samples["sequence"] = np.cumsum(jumps.astype(np.uint64)).astype(np.uint32)
    for first in range(0, rows - 900, ROUND):
        samples["current_A"][first : first + 60] = np.nan
        samples["voltage_V"][first + 100 : first + 160] = np.nan
        samples["voltage_V"][first + 200 : first + 300] = rest_V
        samples["voltage_V"][first + 400 : first + 500] = rng.choice(off_V)
        samples["voltage_V"][first + 400 : first + 500] += rng.normal(0.0, 0.01, 100)
        samples["current_A"][first + 400 : first + 450] = 0.0
        samples["current_A"][first + 500 : first + 700] = rng.choice([-40.0, 40.0]) * scale_A
    for field in ("current_A", "voltage_V", "temperature_C"):
        at = rng.integers(0, rows, rows // 30)
        bits = rng.integers(0, 2**32, at.size, dtype=np.uint64).astype(np.uint32)
        samples[field].view(np.uint32)[at] = bits
    return samples


def stress_of(model: CellModel, rows: int = STEPS) -> NDArray[Any]:
    """Stress around the voltages and currents of a model."""
    at = np.interp([0.02, 0.3, 0.5, 0.98], model.soc, model.ocv_V[0])
    low, quarter, rest, full = (float(v) for v in at)
    return stress_samples(rows, 0, model.capacity_Ah, rest, (low, quarter, full))


def lock_out(model: CellModel) -> NDArray[Any]:
    """A cell at rest whose voltage turns out to be that of an empty one."""
    samples = np.zeros(LOCK_OUT_STEPS, dtype=INPUT)
    truth, empty = np.interp([START_SOC, 0.02], model.soc, model.ocv_V[0])
    samples["voltage_V"] = np.where(np.arange(LOCK_OUT_STEPS) < SETTLED, truth, empty)
    samples["temperature_C"] = model_temperature_C(model)
    samples["sequence"] = np.arange(LOCK_OUT_STEPS)
    return samples


def worst_case(model: CellModel, tables: FixedStepTables, core: str) -> WorstCase:
    """Count the instructions of stress, and of a step that re-initialises SOC.

    Raises
    ------
    InputError        no tools, or a core that is not known
    """
    cost = run_on_target(
        tables, core, stress_of(model), START_SOC, START_VARIANCE, measure_every=EVERY
    ).cost
    most, stack = cost.instructions_most or 0.0, cost.stack_bytes or 0
    samples = lock_out(model)
    run = run_on_target(tables, core, samples, START_SOC, NARROW)
    found = np.flatnonzero(run.outputs["status"] & GATE_RECOVERY)
    if found.size == 0:
        return WorstCase(most, None, stack)
    at = int(found[0])
    once = run_on_target(
        tables, core, samples[: at + 1], START_SOC, NARROW, measure_every=at + 1, measure_first=at
    ).cost
    reset = once.instructions_most or 0.0
    return WorstCase(max(most, reset), reset, max(stack, once.stack_bytes or 0))
