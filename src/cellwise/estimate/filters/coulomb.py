"""Coulomb counting, the baseline that every filter has to beat."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import kernel, rows
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


@kernel
def coulomb_step(
    cell: CellScalars,
    soc: float,
    variance: float,
    previous_A: float,
    current_A: float,
    dt_s: float,
    walk: float,
    gap_soc: float,
    gap: bool,
) -> tuple[float, float, float, int]:
    """One interval: the new SOC, its variance, the current that was used, the status bits."""
    status = 0
    current = current_A
    if not math.isfinite(current):
        current = previous_A
        status |= CURRENT_INVALID
    if gap:
        status |= SEQUENCE_GAP
        rate_A = max(LOST_RATE * cell.charge_As / 3600.0, abs(current), abs(previous_A))
        unseen = min(gap_soc, rate_A * dt_s / cell.charge_As)
        variance += unseen * unseen
    elif dt_s <= 0.0:
        status |= DUPLICATE
    soc = soc_step(cell, soc, 0.0 if gap else current, dt_s)  # nobody knows what flowed in a gap
    variance += walk * walk * dt_s
    if soc < 0.0 or soc > 1.0:
        soc = min(max(soc, 0.0), 1.0)
        status |= CLAMPED
    return soc, variance, current, status


@rows
def coulomb_rows(
    cell: CellScalars,
    soc0: float,
    variance0: float,
    current_A: FloatArray,
    dt_s: FloatArray,
    gap: BoolArray,
    walk: float,
    gap_soc: float,
    soc: FloatArray,
    std: FloatArray,
    status: IntArray,
) -> None:
    """Every row of a log through :func:`coulomb_step`."""
    s = soc0
    variance = variance0
    previous = 0.0
    for k in range(dt_s.size):
        s, variance, previous, bits = coulomb_step(
            cell, s, variance, previous, current_A[k], dt_s[k], walk, gap_soc, gap[k]
        )
        soc[k] = s
        std[k] = math.sqrt(variance)
        status[k] = bits


class Coulomb:
    """SOC by counting charge from a start that it can never correct."""

    name = "coulomb"

    def __init__(self, model: CellModel, noise: Noise | None = None) -> None:
        check_is_model(model)
        self.model = model
        self.noise = noise_for(model, noise)
        self._cell = model.parameters().cell
        self._noise = self.noise.scalars()

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
        reading = reading_from(current_A, voltage_V, temperature_C, dt_s, gap)
        soc, variance, previous, bits = coulomb_step(
            self._cell,
            state.soc,
            state.variance,
            state.previous_A,
            reading.current_A,
            reading.dt_s,
            self._noise.soc_per_sqrt_s,
            self._noise.gap_soc,
            reading.gap,
        )
        info = CoulombInfo(soc, math.sqrt(variance), Status(bits))
        return CoulombState(soc, variance, previous), info

    def run(self, log: CellLog, soc0: float, soc0_std: float = 0.15) -> Trace:
        """Count a whole log; the voltage shown is the model's own simulation."""
        check_is_log(log)
        start = self.init(soc0, soc0_std)
        gap = log.gap_rows
        n = len(log)
        soc, std = np.empty(n), np.empty(n)
        status = np.empty(n, dtype=np.int32)
        coulomb_rows(
            self._cell,
            start.soc,
            start.variance,
            np.array(log.interval_current_A),
            log.interval_s,
            gap,
            self._noise.soc_per_sqrt_s,
            self._noise.gap_soc,
            soc,
            std,
            status,
        )
        voltage = simulate(self.model, log, soc0).voltage_V
        missing = np.full(n, np.nan)
        return Trace(
            log.time_s, soc, std, voltage, log.voltage_V - voltage, missing, missing, status
        )
