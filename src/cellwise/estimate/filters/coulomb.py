"""Coulomb counting, the baseline that every filter has to beat."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import for_kernel, kernel, rows
from cellwise.cell.equations import soc_step
from cellwise.cell.model import CellModel, check_is_model
from cellwise.cell.point_kernels import CellScalars
from cellwise.cell.simulate import check_soc0, check_soc0_std, simulate
from cellwise.estimate.filters.kalman import check_state, reading_from
from cellwise.estimate.noise import Noise, noise_for
from cellwise.estimate.sensing_kernels import LOST_RATE
from cellwise.estimate.status import CLAMPED, CURRENT_INVALID, DUPLICATE, SEQUENCE_GAP, Status
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog, check_is_log
from cellwise.typing import BoolArray, FloatArray, IntArray


class CoulombState(NamedTuple):
    """What must be carried: SOC, its variance, the last valid current."""

    soc: float
    variance: float
    previous_A: float


class CoulombInfo(NamedTuple):
    """What may be looked at after a step."""

    soc: float
    soc_std: float
    status: Status


class CountRules(NamedTuple):
    """How fast a count drifts [1/sqrt(s)], and what SOC a gap may hide."""

    walk: float
    gap_soc: float


@kernel
def coulomb_step(
    cell: CellScalars,
    rules: CountRules,
    state: CoulombState,
    current_A: float,
    dt_s: float,
    gap: bool,
) -> tuple[CoulombState, int]:
    """One interval: the new state and the status bits."""
    status = 0
    current, variance = current_A, state.variance
    if not math.isfinite(current):
        current = state.previous_A
        status |= CURRENT_INVALID
    if gap:
        status |= SEQUENCE_GAP
        rate_A = max(LOST_RATE * cell.charge_As / 3600.0, abs(current), abs(state.previous_A))
        unseen = min(rules.gap_soc, rate_A * dt_s / cell.charge_As)
        variance += unseen * unseen
    elif dt_s <= 0.0:
        status |= DUPLICATE
    # Nobody knows what flowed in a gap.
    soc = soc_step(cell, state.soc, 0.0 if gap else current, dt_s)
    variance += rules.walk * rules.walk * dt_s
    if soc < 0.0 or soc > 1.0:
        soc = min(max(soc, 0.0), 1.0)
        status |= CLAMPED
    return CoulombState(soc, variance, current), status


@rows
def coulomb_rows(
    cell: CellScalars,
    rules: CountRules,
    start: CoulombState,
    current_A: FloatArray,
    dt_s: FloatArray,
    gap: BoolArray,
    out: FloatArray,
    status: IntArray,
) -> None:
    """Every row of a log through one step; ``out`` holds SOC and its deviation, shape (2, rows)."""
    state = start
    for k in range(dt_s.size):
        state, bits = coulomb_step(cell, rules, state, current_A[k], dt_s[k], gap[k])
        out[0, k] = state.soc
        out[1, k] = math.sqrt(state.variance)
        status[k] = bits


class Coulomb:
    """SOC by counting charge from a start that it can never correct."""

    name = "coulomb"

    def __init__(self, model: CellModel, noise: Noise | None = None) -> None:
        check_is_model(model)
        self.model = model
        self.noise = noise_for(model, noise)
        self._cell = model.parameters().cell
        scalars = self.noise.scalars()
        self.rules = CountRules(scalars.soc_per_sqrt_s, scalars.gap_soc)

    def init(self, soc0: float, soc0_std: float = 0.15) -> CoulombState:
        """State at ``soc0``; raises InputError outside 0..1, or a deviation not above zero."""
        check_soc0(soc0)
        check_soc0_std(soc0_std)
        return CoulombState(float(soc0), float(soc0_std) ** 2, 0.0)

    def step(
        self,
        state: CoulombState,
        current_A: float,
        voltage_V: float = math.nan,
        temperature_C: float | None = None,
        *,
        dt_s: float,
        gap: bool = False,
    ) -> tuple[CoulombState, CoulombInfo]:
        """Take the sample that ends an interval of ``dt_s`` seconds; the voltage is not used.

        Raises
        ------
        InputError        dt_s negative or not finite; a state or a reading of another type
        """
        check_state(state, CoulombState, self.name)
        r = reading_from(current_A, voltage_V, temperature_C, dt_s, gap)
        new, bits = coulomb_step(self._cell, self.rules, state, r.current_A, r.dt_s, r.gap)
        return new, CoulombInfo(new.soc, math.sqrt(new.variance), Status(bits))

    def run(self, log: CellLog, soc0: float, soc0_std: float = 0.15) -> Trace:
        """Count a whole log; the voltage shown is the model's own simulation."""
        check_is_log(log)
        n = len(log)
        out, status = np.empty((2, n)), np.empty(n, dtype=np.int32)
        start, current = self.init(soc0, soc0_std), for_kernel(log.interval_current_A)
        coulomb_rows(
            self._cell, self.rules, start, current, log.interval_s, log.gap_rows, out, status
        )
        voltage = simulate(self.model, log, soc0).voltage_V
        missing = np.full(n, np.nan)
        off = log.voltage_V - voltage
        return Trace(log.time_s, out[0], out[1], voltage, off, missing, missing, status)
