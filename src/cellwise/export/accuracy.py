"""How far the exported filter is from the float64 one on a log, and samples that stress it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model import CellModel
from cellwise.data import load_dataset
from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.fixed.fixed_step import FixedStep, samples_of
from cellwise.estimate.fixed.layout import INPUT
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.estimate.noise import Noise
from cellwise.estimate.status import GATE_RECOVERY
from cellwise.estimate.trace import Trace
from cellwise.export import cross
from cellwise.export.cross import run_on_target
from cellwise.export.package import Export
from cellwise.logs.cell_log import CellLog, resample
from cellwise.plotting import Line, Panel, Plottable
from cellwise.typing import FloatArray

STEPS_TO_MEASURE = 4000


class Stress(NamedTuple):
    """The samples that make a step cost most: so many, persistent faults every ``round`` of them.

    On the target every so manyth is measured. A lock-out is ``settled`` samples at the truth, then
    those of an empty cell, by a filter whose variance is ``narrow``.
    """

    samples: int = 3000
    round: int = 3000
    every: int = 5
    soc: float = 0.9
    variance: float = 0.01
    narrow: float = 1e-5
    lock_out: int = 200
    settled: int = 50


STRESS = Stress()


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
    for first in range(0, rows - 900, STRESS.round):
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


def stress_of(model: CellModel, rows: int = STRESS.samples) -> NDArray[Any]:
    """Stress around the voltages and currents of a model."""
    at = np.interp([0.02, 0.3, 0.5, 0.98], model.soc, model.ocv_V[0])
    low, quarter, rest, full = (float(v) for v in at)
    return stress_samples(rows, 0, model.capacity_Ah, rest, (low, quarter, full))


def lock_out(model: CellModel) -> NDArray[Any]:
    """A cell at rest whose voltage turns out to be that of an empty one."""
    samples = np.zeros(STRESS.lock_out, dtype=INPUT)
    truth, empty = np.interp([STRESS.soc, 0.02], model.soc, model.ocv_V[0])
    samples["voltage_V"] = np.where(np.arange(STRESS.lock_out) < STRESS.settled, truth, empty)
    samples["temperature_C"] = model.usual_temperature_C
    samples["sequence"] = np.arange(STRESS.lock_out)
    return samples


def worst_case(model: CellModel, tables: FixedStepTables, core: str) -> WorstCase:
    """Count the instructions of stress, and of a step that re-initialises SOC.

    Raises
    ------
    InputError        no tools, or a core that is not known
    """
    faults, empty = stress_of(model), lock_out(model)
    cost = run_on_target(
        tables, core, faults, STRESS.soc, STRESS.variance, measure_every=STRESS.every
    ).cost
    most, stack = cost.instructions_most or 0.0, cost.stack_bytes or 0
    run = run_on_target(tables, core, empty, STRESS.soc, STRESS.narrow)
    found = np.flatnonzero(run.outputs["status"] & GATE_RECOVERY)
    if found.size == 0:
        return WorstCase(most, None, stack)
    at, rows = int(found[0]), empty[: int(found[0]) + 1]
    once = run_on_target(
        tables, core, rows, STRESS.soc, STRESS.narrow, measure_every=at + 1, measure_first=at
    ).cost
    reset = once.instructions_most or 0.0
    return WorstCase(max(most, reset), reset, max(stack, once.stack_bytes or 0))


def target_costs(
    export: Export, log: CellLog | None, follow: Callable[[str], object] = lambda _: None
) -> list[dict[str, Any]]:
    """Code, stack and instructions on every core; empty without a cross compiler.

    Counted on the log that is given, else on the embedded drive of an NMC cell; and under stress:
    every fault, and the step that re-initialises SOC after a lock-out.
    """
    here = cross.cores_here()
    if not here:
        return []
    tables = export.tables
    drive = load_dataset("nmc_drive_b") if log is None else log
    records = samples_of(export.model, drive, tables.dt_s).records[:STEPS_TO_MEASURE]
    costs = []
    for core in here:
        follow(f"counting instructions on {core}")
        count = partial(run_on_target, tables, core, records, 0.5, 0.0225, measure_every=10)
        worst = worst_case(export.model, tables, core)
        report = asdict(count().cost)
        report["stack_bytes"] = max(report["stack_bytes"], worst.stack_bytes)
        report["instructions_stress"] = worst.stress
        report["instructions_anew"] = worst.reset
        if export.cells:
            pack = count(cells=export.cells).cost
            report["pack_instructions_mean"] = pack.instructions_mean
            report["pack_instructions_most"] = pack.instructions_most
        costs.append(report)
    return costs


GRIDS = (11, 21, 51, 101, 201)  # SOC points to choose from


@dataclass(frozen=True, eq=False)
class FixedAndFloat(Plottable):
    """What is exported beside the float64 EKF over a log, from the same start; shapes (n,)."""

    points: int
    flash_bytes: int
    log: CellLog
    reference: Trace
    soc: FloatArray

    def to_dict(self) -> dict[str, Any]:
        """SOC lost, exported minus float64, as JSON values."""
        error = self.soc - self.reference.soc
        return {
            "points": self.points,
            "flash_bytes": self.flash_bytes,
            "soc_rmse": float(np.sqrt(np.mean(error * error))),
            "soc_max": float(np.max(np.abs(error))),
        }

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """Both SOCs, their difference, and what the filters see."""
        hours, float64 = self.log.time_s / 3600.0, self.reference
        both = (
            Line("float64 EKF", hours, float64.soc, 2.0 * float64.soc_std),
            Line("exported", hours, self.soc),
        )
        lost = Line("exported - float64", hours, 100.0 * (self.soc - float64.soc))
        return "time [h]", (
            Panel("SOC", both),
            Panel("difference [points]", (lost,)),
            Panel("voltage [V]", (Line("voltage", hours, self.log.voltage_V),)),
            Panel("current [A]", (Line("current", hours, self.log.current_A),)),
        )


def fixed_and_float(
    model: CellModel,
    log: CellLog,
    dt_s: float,
    *,
    soc0: float | None = None,
    lean: bool = False,
    points: int,
    noise: Noise | None = None,
) -> list[FixedAndFloat]:
    """Run what is exported (in Python, the same bits) by every grid, and the float64 EKF.

    Both take the log resampled to ``dt_s``, and the same start; soc0 None: as found at the log's
    start. ``points`` are those of the export. noise None: the model's.
    """
    even = resample(log, dt_s)
    start = initial_soc(model, even, soc0)
    reference = Ekf(model, noise).run(even, start.soc, start.std)
    found = []
    for count in sorted({*GRIDS, points}):
        step = FixedStep(model, noise, dt_s=dt_s, points=count, wide=not lean)
        soc = step.run(even, start.soc, start.std).soc
        flash_bytes = step.stepper(dt_s).tables.flash_bytes
        found.append(FixedAndFloat(count, flash_bytes, even, reference, soc))
    return found
