"""How far the exported filter is from the float64 one on a log, and samples that stress it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.model import CellModel
from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.fixed.layout import INPUT
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.estimate.noise import Noise
from cellwise.estimate.status import GATE_RECOVERY
from cellwise.estimate.trace import Trace
from cellwise.export.cross import run_on_target
from cellwise.logs.cell_log import CellLog, resample
from cellwise.plotting import Line, Panel, Plottable
from cellwise.typing import FloatArray


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
    cost = run_on_target(
        tables, core, stress_of(model), STRESS.soc, STRESS.variance, measure_every=STRESS.every
    ).cost
    most, stack = cost.instructions_most or 0.0, cost.stack_bytes or 0
    samples = lock_out(model)
    run = run_on_target(tables, core, samples, STRESS.soc, STRESS.narrow)
    found = np.flatnonzero(run.outputs["status"] & GATE_RECOVERY)
    if found.size == 0:
        return WorstCase(most, None, stack)
    at = int(found[0])
    once = run_on_target(
        tables,
        core,
        samples[: at + 1],
        STRESS.soc,
        STRESS.narrow,
        measure_every=at + 1,
        measure_first=at,
    ).cost
    reset = once.instructions_most or 0.0
    return WorstCase(max(most, reset), reset, max(stack, once.stack_bytes or 0))


GRIDS = (11, 21, 51, 101, 201)


@dataclass(frozen=True)
class GridAccuracy:
    """SOC of the fixed step minus SOC of the float64 EKF, for one number of SOC points."""

    points: int
    flash_bytes: int
    soc_rmse: float
    soc_max: float


@dataclass(frozen=True, eq=False)
class FixedAndFloat(Plottable):
    """Both filters over a log at the target's time step, from the same start; shapes (n,)."""

    log: CellLog
    float_soc: FloatArray
    float_soc_std: FloatArray
    fixed_soc: FloatArray

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """Both SOCs, their difference, and what the filters see."""
        hours = self.log.time_s / 3600.0
        both = (
            Line("float64 EKF", hours, self.float_soc, 2.0 * self.float_soc_std),
            Line("exported", hours, self.fixed_soc),
        )
        lost = Line("exported - float64", hours, 100.0 * (self.fixed_soc - self.float_soc))
        return "time [h]", (
            Panel("SOC", both),
            Panel("difference [points]", (lost,)),
            Panel("voltage [V]", (Line("voltage", hours, self.log.voltage_V),)),
            Panel("current [A]", (Line("current", hours, self.log.current_A),)),
        )


def accuracy_by_grid(
    model: CellModel,
    log: CellLog,
    dt_s: float,
    *,
    soc0: float | None = None,
    wide: bool = True,
    grids: Sequence[int] = GRIDS,
    noise: Noise | None = None,
) -> list[GridAccuracy]:
    """Accuracy lost by every grid, the model's own among them.

    Both filters take the log resampled to ``dt_s``, and the same start; soc0 None: as found at the
    log's start. wide False: as with ``--lean``. noise None: the model's.
    """
    even, start, reference = _float_ekf(model, log, dt_s, soc0, noise)
    found = []
    for points in sorted({*grids, model.points}):
        step = FixedStep(model, noise, dt_s=dt_s, points=points, wide=wide)
        error = step.run(even, start.soc, start.std).soc - reference.soc
        found.append(
            GridAccuracy(
                points,
                step.stepper(dt_s).tables.flash_bytes,
                float(np.sqrt(np.mean(error * error))),
                float(np.max(np.abs(error))),
            )
        )
    return found


def fixed_and_float(
    model: CellModel,
    log: CellLog,
    dt_s: float,
    *,
    soc0: float | None = None,
    points: int | None = None,
    lean: bool = False,
    noise: Noise | None = None,
) -> FixedAndFloat:
    """Run what is exported (in Python, the same bits) and the float64 EKF over a log.

    Parameters as of `accuracy_by_grid` and of `FixedStep`; soc0 None: as found at the log's start.
    """
    even, start, reference = _float_ekf(model, log, dt_s, soc0, noise)
    step = FixedStep(
        model,
        noise,
        dt_s=dt_s,
        points=points,
        wide=not lean,
    )
    exported = step.run(even, start.soc, start.std)
    return FixedAndFloat(even, reference.soc, reference.soc_std, exported.soc)


def _float_ekf(
    model: CellModel, log: CellLog, dt_s: float, soc0: float | None, noise: Noise | None
) -> tuple[CellLog, InitialSoc, Trace]:
    """The log at the target's time step, its start, and the float64 EKF over it."""
    even = resample(log, dt_s)
    start = initial_soc(model, even, soc0)
    return even, start, Ekf(model, noise).run(even, start.soc, start.std)
