"""An independent cell: its differential equations on a fine grid, plain NumPy, and its instrument.

Nothing is shared with the package's kernels: every relaxing quantity (RC branches, hysteresis, the
core's heat) is y' = (u - y) a with its own u and a, summed with an integrating factor over
sub-steps; values of tables are those at the middle of a sub-step. Discharge current is positive.

    run = emulate(cell, time_s, current_A, temperature_C, soc0=0.9)
    log = measure(run, Sensor(offset_A=0.05, noise_V=1e-3), rng)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cellwise.logs.cell_log import CellLog

Array = NDArray[np.float64]

KELVIN = 273.15
LONGEST_SUBSTEP_S = 0.5
MOST_SUBSTEPS = 20  # in one interval: nothing moves much in a long one
LARGEST_EXPONENT = 300.0
HEAT_ROUNDS = 6  # heat changes the resistances, which change the heat: a fast contraction


@dataclass(frozen=True, eq=False)
class Table:
    """A function of SOC by its values on an even grid from 0 to 1."""

    values: Array

    def __call__(self, soc: Array) -> Array:
        return np.interp(soc, np.linspace(0.0, 1.0, self.values.size), self.values)

    def times(self, factor: float) -> Table:
        return Table(self.values * factor)


def flat(value: float) -> Table:
    return Table(np.full(2, float(value)))


@dataclass(frozen=True, eq=False)
class Cell:
    """The truth: tables over SOC [V, ohm, s] and every effect, neutral unless given."""

    capacity_Ah: float
    ocv_V: Table
    r0_ohm: Table
    r1_ohm: Table
    tau1_s: Table
    r2_ohm: Table
    tau2_s: Table
    r3_ohm: Table = field(default_factory=lambda: flat(0.0))
    tau3_s: Table = field(default_factory=lambda: flat(1000.0))
    m_V: Table = field(default_factory=lambda: flat(0.0))
    gamma: float = 0.0
    activation_K: float = 0.0
    reference_C: float = 25.0
    rate_h: float = 0.0
    transfer_per_V: float = 0.0
    charge_scale: float = 1.0
    leak_A: float = 0.0
    rth_K_per_W: float = 0.0
    thermal_s: float = 600.0
    charge_efficiency: float = 1.0


@dataclass(frozen=True, eq=False)
class Run:
    """What the cell did, row by row; ``current_A`` flowed in the interval that ends at the row."""

    time_s: Array
    current_A: Array
    temperature_C: Array
    voltage_V: Array
    soc: Array
    branches_V: Array  # (3, rows)
    h: Array
    heat_K: Array


@dataclass(frozen=True, eq=False)
class Sensor:
    """What the instrument does to the truth; steps are its resolution, 0 for none."""

    offset_A: float = 0.0
    gain: float = 1.0
    offset_V: float = 0.0
    skew_s: float = 0.0
    noise_A: float = 0.0
    noise_V: float = 0.0
    noise_C: float = 0.0
    step_A: float = 0.0
    step_V: float = 0.0
    step_C: float = 0.0


@dataclass(frozen=True, eq=False)
class _Grid:
    """Sub-steps: length, current, temperature, SOC at the middle, and where the rows end."""

    dt_s: Array
    current_A: Array
    temperature_C: Array
    soc: Array
    row_end: NDArray[np.int64]
    soc_rows: Array


def emulate(
    cell: Cell,
    time_s: Array,
    current_A: Array,
    temperature_C: Array | float,
    soc0: float,
    h0: float | None = None,
    substep_s: float = LONGEST_SUBSTEP_S,
) -> Run:
    """The cell from rest at ``soc0``; hysteresis starts as charged into above SOC 0.5."""
    surface = np.broadcast_to(np.asarray(temperature_C, dtype=float), time_s.shape)
    grid = _grid(cell, time_s, current_A, surface, soc0, substep_s)
    heat = np.zeros(grid.dt_s.size)
    for _ in range(HEAT_ROUNDS if cell.rth_K_per_W else 1):
        branches = _branches(cell, grid, heat)
        if cell.rth_K_per_W:
            middle = 0.5 * (branches + np.concatenate((np.zeros((3, 1)), branches[:, :-1]), axis=1))
            r0 = _factor(cell, grid.current_A, grid.temperature_C + heat) * cell.r0_ohm(grid.soc)
            power = grid.current_A * (r0 * grid.current_A + middle.sum(axis=0))
            warmed = relax(0.0, cell.rth_K_per_W * power, grid.dt_s / cell.thermal_s)
            heat = 0.5 * (warmed + np.concatenate(([0.0], warmed[:-1])))
    start_h = h0 if h0 is not None else (1.0 if soc0 > 0.5 else -1.0)
    passed = cell.gamma * np.abs(grid.current_A) * grid.dt_s / (3600.0 * cell.capacity_Ah)
    h = relax(start_h, -np.sign(grid.current_A), passed)
    end = grid.row_end

    def rows(values: Array, start: float) -> Array:
        return np.concatenate(([start], values[end]))

    v = np.array([rows(branch, 0.0) for branch in branches])
    heat_rows = rows(warmed, 0.0) if cell.rth_K_per_W else np.zeros(time_s.size)
    h_rows = rows(h, start_h)
    r0 = _factor(cell, current_A, surface + heat_rows) * cell.r0_ohm(grid.soc_rows)
    voltage = cell.ocv_V(grid.soc_rows) - r0 * current_A - v.sum(axis=0)
    voltage = voltage + cell.m_V(grid.soc_rows) * h_rows
    return Run(
        time_s, current_A, np.array(surface), voltage, grid.soc_rows, v, h_rows, heat_rows
    )  # fmt: skip


def _grid(
    cell: Cell, time_s: Array, current_A: Array, surface_C: Array, soc0: float, substep_s: float
) -> _Grid:
    dt = np.diff(time_s)
    parts = np.clip(np.ceil(dt / substep_s - 1e-9), 1, MOST_SUBSTEPS).astype(np.int64)
    of = np.repeat(np.arange(dt.size), parts)
    end = np.cumsum(parts) - 1
    place = np.arange(of.size) - (end[of] - parts[of] + 1)
    fine = (dt / parts)[of]
    current = current_A[1:][of]
    put = np.where(current > 0.0, current, current * cell.charge_efficiency) + cell.leak_A
    fall = put * fine / (3600.0 * cell.capacity_Ah)
    after = soc0 - np.cumsum(fall)
    share = (place + 0.5) / parts[of]
    return _Grid(
        dt_s=fine,
        current_A=current,
        temperature_C=surface_C[:-1][of] * (1.0 - share) + surface_C[1:][of] * share,
        soc=after + 0.5 * fall,
        row_end=end,
        soc_rows=np.concatenate(([soc0], after[end])),
    )


def _factor(cell: Cell, current_A: Array, core_C: Array, *, slow: bool = False) -> Array:
    """What temperature, rate and direction do to a resistance; the slow branch knows no rate."""
    reference = cell.reference_C + KELVIN
    factor = np.exp(cell.activation_K * (1.0 / (core_C + KELVIN) - 1.0 / reference))
    factor = factor * np.where(current_A < 0.0, cell.charge_scale, 1.0)
    return factor if slow else factor / (1.0 + cell.rate_h * np.abs(current_A) / cell.capacity_Ah)


def _branches(cell: Cell, grid: _Grid, heat_K: Array) -> Array:
    """Voltage of the three branches at the end of each sub-step, shape (3, sub-steps)."""
    core = grid.temperature_C + heat_K
    fast = _factor(cell, grid.current_A, core) * grid.current_A
    slow = _factor(cell, grid.current_A, core, slow=True) * grid.current_A
    driven = (
        (cell.r1_ohm, cell.tau1_s, fast),
        (cell.r2_ohm, cell.tau2_s, fast),
        (cell.r3_ohm, cell.tau3_s, slow),
    )
    drives = [r(grid.soc) * u for r, _, u in driven]
    if cell.transfer_per_V:  # Butler-Volmer, one electron and symmetric: sinh turned round
        drives[0] = np.arcsinh(cell.transfer_per_V * drives[0]) / cell.transfer_per_V
    return np.array(
        [
            relax(0.0, drive, grid.dt_s / tau(grid.soc))
            for drive, (_, tau, _) in zip(drives, driven, strict=True)
        ]
    )


def relax(start: float, target: Array, passed: Array) -> Array:
    """y after each sub-step for y' = target - y in the variable whose growth is ``passed``.

    y = e^-A (y0 + sum of e^A target (1 - e^-dA)), A the sum of dA: exact for a target that is
    constant within a sub-step, and done in stretches over which e^A stays a float.
    """
    passed = np.minimum(passed, LARGEST_EXPONENT)
    total = np.cumsum(passed)
    added = target * -np.expm1(-passed)
    cuts = np.searchsorted(total, np.arange(LARGEST_EXPONENT, total[-1], LARGEST_EXPONENT))
    out = np.empty(passed.size)
    edges = np.unique(np.concatenate(([0], cuts, [passed.size])))
    level, gone = start, 0.0
    for low, high in pairwise(edges):
        exponent = total[low:high] - gone
        out[low:high] = np.exp(-exponent) * (level + np.cumsum(np.exp(exponent) * added[low:high]))
        level, gone = out[high - 1], total[high - 1]
    return out


def seen(run: Run, sensor: Sensor) -> tuple[Array, Array]:
    """Current and voltage as the instrument would log them without noise and resolution.

    A skewed voltage is that of ``skew_s`` before, linear between the rows of its own channel.
    """
    current = sensor.gain * run.current_A + sensor.offset_A
    voltage = run.voltage_V + sensor.offset_V
    if sensor.skew_s:
        voltage = np.interp(run.time_s - sensor.skew_s, run.time_s, voltage)
    return current, voltage


def measure(run: Run, sensor: Sensor, rng: np.random.Generator, name: str = "log") -> CellLog:
    """The run as a log."""
    current, voltage = seen(run, sensor)
    n = run.time_s.size
    return CellLog(
        time_s=run.time_s,
        current_A=_read(current, sensor.noise_A, sensor.step_A, rng, n),
        voltage_V=_read(voltage, sensor.noise_V, sensor.step_V, rng, n),
        temperature_C=_read(run.temperature_C, sensor.noise_C, sensor.step_C, rng, n),
        name=name,
    )


def _read(value: Array, noise: float, step: float, rng: np.random.Generator, n: int) -> Array:
    noisy = value + noise * rng.standard_normal(n)
    return np.round(noisy / step) * step if step > 0.0 else noisy
