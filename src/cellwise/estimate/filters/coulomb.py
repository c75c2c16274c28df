"""Gauges without a filter: counting, and the OCV of rests with counting between them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import for_kernel, kernel, part, rows
from cellwise.cell.equations import CellTables, look_up, soc_step
from cellwise.cell.initial_soc.rest import RELAXED_S, REST_RATE, SHORT_REST_V
from cellwise.cell.model import CellModel, check_is_model
from cellwise.cell.point_kernels import CellScalars
from cellwise.cell.simulate import check_soc0, check_soc0_std, simulate
from cellwise.errors import InputError
from cellwise.estimate.filters.filter_state import LogArrays
from cellwise.estimate.filters.kalman import check_state, log_arrays, reading_from
from cellwise.estimate.noise import Noise, noise_for
from cellwise.estimate.sensing_kernels import LOST_RATE, Reading
from cellwise.estimate.status import CLAMPED, CURRENT_INVALID, DUPLICATE, SEQUENCE_GAP, Status
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog, check_is_log
from cellwise.typing import BoolArray, FloatArray, IntArray

REST_S = 600.0
HALVINGS = 24
SMALLEST_STD = 1e-3


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


class RestOcvState(NamedTuple):
    """What must be carried: SOC, its variance, the last valid current, how long it has rested.

    ``rest_s`` is infinite before the first sample: a cell that is switched on at rest has rested.
    """

    soc: float
    variance: float
    previous_A: float
    rest_s: float


class RestRules(NamedTuple):
    """How a count drifts, and when a cell has rested [s]."""

    counting: CountRules
    rest_after_s: float


class RestOcvInfo(NamedTuple):
    """What may be looked at after a step; ``rested`` says that the voltage was used."""

    soc: float
    soc_std: float
    rested: bool
    status: Status


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
def rest_ocv_step(
    tables: CellTables,
    state: RestOcvState,
    r: Reading,
    rules: RestRules,
) -> tuple[RestOcvState, bool, int]:
    """Count one interval; where the cell has rested for long enough, read the OCV instead."""
    current_A, voltage_V, temperature_C = r.current_A, r.voltage_V, r.temperature_C
    before = CoulombState(state.soc, state.variance, state.previous_A)
    counted, bits = coulomb_step(tables.cell, rules.counting, before, current_A, r.dt_s, r.gap)
    soc, variance, current = counted.soc, counted.variance, counted.previous_A
    resting = (
        math.isfinite(current_A) and abs(current_A) * 3600.0 < REST_RATE * tables.cell.charge_As
    )
    rest = state.rest_s + r.dt_s if resting else 0.0
    rested = False
    if resting and rest >= rules.rest_after_s and math.isfinite(voltage_V):
        here = soc_at(tables, voltage_V, temperature_C)
        point = look_up(tables, here, temperature_C)
        left = SHORT_REST_V * math.exp(-min(rest, 1e9) / RELAXED_S)
        off = math.sqrt(point.error_V**2 + point.m_V**2 + left * left)
        # Over a flat OCV every SOC of that voltage is as good.
        wide = soc_at(tables, voltage_V + off, temperature_C)
        spread = max(0.5 * (wide - soc_at(tables, voltage_V - off, temperature_C)), SMALLEST_STD)
        if spread * spread < variance or math.isinf(rest):
            soc = here
            variance = spread * spread
            rested = True
    if math.isinf(rest):
        rest = 0.0
    return RestOcvState(soc, variance, current, rest), rested, bits


@rows
def rest_ocv_rows(
    tables: CellTables,
    start: RestOcvState,
    log: LogArrays,
    default_C: float,
    rules: RestRules,
    out: FloatArray,
    status: IntArray,
) -> None:
    """Every row of a log through one step; ``out`` holds SOC and its deviation, shape (2, rows)."""
    state = start
    warm = default_C
    for k in range(log.dt_s.size):
        if math.isfinite(log.temperature_C[k]):
            warm = log.temperature_C[k]
        reading = Reading(log.current_A[k], log.voltage_V[k], warm, log.dt_s[k], log.gap[k])
        state, _, bits = rest_ocv_step(tables, state, reading, rules)
        out[0, k] = state.soc
        out[1, k] = math.sqrt(state.variance)
        status[k] = bits


class RestOcv:
    """SOC by the open-circuit voltage wherever the cell rests, by counting in between.

    Parameters
    ----------
    model : CellModel
    noise : Noise or None     for the drift of the count; None: from the model
    rest_s : float            how long the current has to be below C/100 [s]
    """

    name = "rest-ocv"

    def __init__(
        self, model: CellModel, noise: Noise | None = None, rest_s: float = REST_S
    ) -> None:
        if not (np.isfinite(rest_s) and rest_s >= 0.0):
            raise InputError(f"rest_s = {rest_s}", "seconds, at least 0", "Give e.g. 600.")
        check_is_model(model)
        self.model = model
        self.noise = noise_for(model, noise)
        self.rest_s = float(rest_s)
        self._tables = model.parameters()
        self._default_C = model.usual_temperature_C
        self._count = Coulomb(model, self.noise)
        self._rules = RestRules(self._count.rules, self.rest_s)

    def init(self, soc0: float, soc0_std: float = 0.15) -> RestOcvState:
        """State at ``soc0``; raises InputError outside 0..1."""
        begun = self._count.init(soc0, soc0_std)
        return RestOcvState(begun.soc, begun.variance, begun.previous_A, math.inf)

    def step(
        self,
        state: RestOcvState,
        current_A: float,
        voltage_V: float,
        temperature_C: float | None = None,
        *,
        dt_s: float,
        gap: bool = False,
    ) -> tuple[RestOcvState, RestOcvInfo]:
        """Take the sample that ends an interval of ``dt_s`` seconds.

        Raises
        ------
        InputError        dt_s negative or not finite; a state or a reading of another type
        """
        check_state(state, RestOcvState, self.name)
        reading = reading_from(current_A, voltage_V, temperature_C, dt_s, gap)
        if temperature_C is None:
            reading = reading._replace(temperature_C=self._default_C)
        new, rested, bits = rest_ocv_step(self._tables, state, reading, self._rules)
        return new, RestOcvInfo(new.soc, math.sqrt(new.variance), rested, Status(bits))

    def run(self, log: CellLog, soc0: float, soc0_std: float = 0.15) -> Trace:
        """Replay a whole log; it predicts no voltage, so those figures are missing (NaN)."""
        rows_, n = log_arrays(log), len(log)
        out, status = np.empty((2, n)), np.empty(n, dtype=np.int32)
        start = self.init(soc0, soc0_std)
        rest_ocv_rows(self._tables, start, rows_, self._default_C, self._rules, out, status)
        missing = np.full(n, np.nan)
        return Trace(log.time_s, out[0], out[1], missing, missing, missing, missing, status)
