"""Gauges without a filter: counting, and the OCV of rests with counting between them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import inline, kernel, part, rows
from cellwise.cell.equations import CellTables, look_up, soc_step
from cellwise.cell.initial_soc.rest import RELAXED_S, REST_RATE, SHORT_REST_V
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.filters.filter_state import LogArrays
from cellwise.estimate.filters.kalman import (
    FilterOfModel,
    check_state,
    known_start,
    log_arrays,
    reading_from,
)
from cellwise.estimate.filters.predict_kernels import gap_variance
from cellwise.estimate.noise import Noise
from cellwise.estimate.sensing_kernels import MeasuredSample
from cellwise.estimate.status import CLAMPED, CURRENT_INVALID, DUPLICATE, SEQUENCE_GAP, Status
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray, IntArray

REST_S = 600.0
HALVINGS = 24
SMALLEST_STD = 1e-3


class CoulombState(NamedTuple):
    """What must be carried: SOC, its variance, the last valid current, how long it has rested.

    ``soc`` has the ``variance``; ``previous_A`` is that current. ``rest_s`` is infinite before the
    first sample of a gauge that reads the OCV: a cell that is switched on at rest has rested.
    """

    soc: float
    variance: float
    previous_A: float
    rest_s: float


class CoulombInfo(NamedTuple):
    """What may be looked at after a step: ``soc`` with ``soc_std``, the bits of ``status``.

    ``rested`` says that the voltage was used.
    """

    soc: float
    soc_std: float
    rested: bool
    status: Status


class CountRules(NamedTuple):
    """How fast a count drifts [1/sqrt(s)], what SOC a gap may hide, when a cell has rested [s].

    ``rest_after_s`` is infinite where no voltage is read.
    """

    walk: float
    gap_soc: float
    rest_after_s: float


@inline
def counted(
    tables: CellTables, rules: CountRules, state: CoulombState, sample: MeasuredSample
) -> tuple[CoulombState, int]:
    """One interval counted: the new state and the status bits."""
    cell = tables.cell
    status = 0
    current, variance = sample.current_A, state.variance
    if not math.isfinite(current):
        current = state.previous_A
        status |= CURRENT_INVALID
    if sample.gap:
        status |= SEQUENCE_GAP
        gap_A2 = current * current + state.previous_A * state.previous_A
        variance += gap_variance(rules.gap_soc, cell.charge_As, gap_A2, sample.dt_s)
    elif sample.dt_s <= 0.0:
        status |= DUPLICATE
    # Nobody knows what flowed in a gap.
    soc = soc_step(cell, state.soc, 0.0 if sample.gap else current, sample.dt_s)
    variance += rules.walk * rules.walk * sample.dt_s
    if soc < 0.0 or soc > 1.0:
        soc = min(max(soc, 0.0), 1.0)
        status |= CLAMPED
    resting = abs(sample.current_A) * 3600.0 < REST_RATE * cell.charge_As
    return CoulombState(
        soc, variance, current, state.rest_s + sample.dt_s if resting else 0.0
    ), status


@part
def soc_at(tables: CellTables, voltage_V: float, temperature_C: float) -> float:
    """SOC from 0 to 1 whose OCV is nearest to a voltage, by halving."""
    low = 0.0
    high = 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if look_up(tables, middle, temperature_C).ocv_V < voltage_V:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@kernel
def gauge_step(
    tables: CellTables, rules: CountRules, state: CoulombState, sample: MeasuredSample
) -> tuple[CoulombState, bool, int]:
    """Count one interval; where the cell has rested for long enough, read the OCV instead."""
    new, bits = counted(tables, rules, state, sample)
    soc, variance, rest, rested = new.soc, new.variance, new.rest_s, False
    if rest >= rules.rest_after_s and math.isfinite(sample.voltage_V):
        here = soc_at(tables, sample.voltage_V, sample.temperature_C)
        point = look_up(tables, here, sample.temperature_C)
        left = SHORT_REST_V * math.exp(-min(rest, 1e9) / RELAXED_S)
        off = math.sqrt(point.error_V**2 + point.m_V**2 + left * left)
        # Over a flat OCV every SOC of that voltage is as good.
        wide = soc_at(tables, sample.voltage_V + off, sample.temperature_C)
        narrow = soc_at(tables, sample.voltage_V - off, sample.temperature_C)
        spread = max(0.5 * (wide - narrow), SMALLEST_STD)
        rested = spread * spread < variance or math.isinf(rest)
        if rested:
            soc, variance = here, spread * spread
    rest = 0.0 if math.isinf(rest) else rest
    return CoulombState(soc, variance, new.previous_A, rest), rested, bits


@rows
def gauge_rows(
    tables: CellTables,
    rules: CountRules,
    start: CoulombState,
    default_C: float,
    log: LogArrays,
    out: FloatArray,
    status: IntArray,
) -> None:
    """Every row of a log through one step; ``out`` holds SOC and its deviation, shape (2, rows)."""
    state = start
    temperature_C = default_C
    for k in range(log.dt_s.size):
        if math.isfinite(log.temperature_C[k]):
            temperature_C = log.temperature_C[k]
        sample = MeasuredSample(
            log.current_A[k], log.voltage_V[k], temperature_C, log.dt_s[k], log.gap[k]
        )
        state, _, bits = gauge_step(tables, rules, state, sample)
        out[0, k] = state.soc
        out[1, k] = math.sqrt(state.variance)
        status[k] = bits


class RestOcv(FilterOfModel):
    """SOC by the open-circuit voltage wherever the cell rests, by counting in between.

    Parameters
    ----------
    model : CellModel
    noise : Noise or None     for the drift of the count; None: from the model
    rest_s : float            how long the current has to be below C/100 [s]
    """

    name = "rest-ocv"
    reads_voltage = True

    def __init__(
        self, model: CellModel | None = None, noise: Noise | None = None, rest_s: float = REST_S
    ) -> None:
        if not (np.isfinite(rest_s) and rest_s >= 0.0):
            raise InputError(f"rest_s = {rest_s}", "seconds, at least 0", "Give e.g. 600.")
        super().__init__(model, noise)
        scalars = self.noise.scalars()
        rest_after_s = float(rest_s) if self.reads_voltage else math.inf
        self._rules = CountRules(scalars.soc_per_sqrt_s, scalars.gap_soc, rest_after_s)

    def init(self, soc0: float, soc0_std: float = 0.15) -> CoulombState:
        """State at ``soc0``; raises InputError outside 0..1, or a deviation not above zero."""
        start = self.start(soc0, soc0_std)
        return CoulombState(start.soc, start.variance, 0.0, math.inf if self.reads_voltage else 0.0)

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
        """Take the sample that ends an interval of ``dt_s`` seconds.

        Raises
        ------
        InputError        dt_s negative or not finite; a state or a reading of another type
        """
        check_state(state, CoulombState, self.name)
        sample = reading_from(current_A, voltage_V, temperature_C, dt_s, gap)
        if temperature_C is None:
            sample = sample._replace(temperature_C=self._default_C)
        new, rested, bits = gauge_step(self._tables, self._rules, state, sample)
        return new, CoulombInfo(new.soc, math.sqrt(new.variance), rested, Status(bits))

    def run(self, log: CellLog, soc0: float | None = None, soc0_std: float = 0.15) -> Trace:
        """Replay a whole log; it predicts no voltage, so those figures are missing (NaN)."""
        soc0, log_rows, n = known_start(log, soc0), log_arrays(log), len(log)
        out, status = np.empty((2, n)), np.empty(n, dtype=np.int32)
        start = self.init(soc0, soc0_std)
        gauge_rows(self._tables, self._rules, start, self._default_C, log_rows, out, status)
        missing = np.full(n, np.nan)
        return Trace(log.time_s, out[0], out[1], missing, missing, missing, missing, status)


class Coulomb(RestOcv):
    """SOC by counting charge from a start that it can never correct; no voltage is read.

    Parameters
    ----------
    model : CellModel
    noise : Noise or None     for the drift of the count; None: from the model
    """

    name = "coulomb"
    reads_voltage = False

    def __init__(self, model: CellModel | None = None, noise: Noise | None = None) -> None:
        super().__init__(model, noise)

    def run(self, log: CellLog, soc0: float | None = None, soc0_std: float = 0.15) -> Trace:
        """Count a whole log; the voltage shown is the model's own simulation."""
        soc0 = known_start(log, soc0)
        voltage = simulate(self.model, log, soc0).voltage_V
        trace = super().run(log, soc0, soc0_std)
        return replace(trace, voltage_V=voltage, innovation_V=log.voltage_V - voltage)
