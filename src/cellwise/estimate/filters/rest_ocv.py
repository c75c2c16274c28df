"""Open-circuit voltage of rests, counting between them: what a simple gauge does."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import kernel, rows
from cellwise.cell.equations import CellTables, look_up
from cellwise.cell.initial_soc.rest import RELAXED_S, REST_RATE, SHORT_REST_V
from cellwise.cell.model import CellModel, check_is_model
from cellwise.cell.simulate import model_temperature_C
from cellwise.errors import InputError
from cellwise.estimate.filters.coulomb import Coulomb, coulomb_step
from cellwise.estimate.filters.kalman import (
    check_state,
    measured_temperature_C,
    reading_from,
)
from cellwise.estimate.noise import Noise, noise_for
from cellwise.estimate.sensing_kernels import Reading
from cellwise.estimate.status import Status
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog, check_is_log
from cellwise.typing import BoolArray, FloatArray, IntArray

REST_S = 600.0
HALVINGS = 24
SMALLEST_STD = 1e-3


class RestOcvState(NamedTuple):
    """What must be carried: SOC, its variance, the last valid current, how long it has rested.

    ``rest_s`` is infinite before the first sample: a cell that is switched on at rest has rested.
    """

    soc: float
    variance: float
    previous_A: float
    rest_s: float


class RestRules(NamedTuple):
    """How fast a count drifts [1/sqrt(s)], what a gap may hide, when a cell has rested [s]."""

    walk: float
    gap_soc: float
    rest_after_s: float


class RestOcvInfo(NamedTuple):
    """What may be looked at after a step; ``rested`` says that the voltage was used."""

    soc: float
    soc_std: float
    rested: bool
    status: Status


@kernel
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
    soc, variance, current, bits = coulomb_step(
        tables.cell,
        state.soc,
        state.variance,
        state.previous_A,
        current_A,
        r.dt_s,
        rules.walk,
        rules.gap_soc,
        r.gap,
    )
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
    current_A: FloatArray,
    voltage_V: FloatArray,
    temperature_C: FloatArray,
    default_C: float,
    dt_s: FloatArray,
    gap: BoolArray,
    rules: RestRules,
    out: FloatArray,
    status: IntArray,
) -> None:
    """Every row of a log through :func:`rest_ocv_step`; ``out`` holds SOC and its deviation."""
    state = start
    warm = default_C
    for k in range(dt_s.size):
        if math.isfinite(temperature_C[k]):
            warm = temperature_C[k]
        reading = Reading(current_A[k], voltage_V[k], warm, dt_s[k], gap[k])
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
        self._default_C = model_temperature_C(model)
        noise_now = self.noise.scalars()
        self._rules = RestRules(noise_now.soc_per_sqrt_s, noise_now.gap_soc, self.rest_s)
        self._count = Coulomb(model, self.noise)

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
        check_is_log(log)
        n = len(log)
        out = np.empty((2, n))
        status = np.empty(n, dtype=np.int32)
        rest_ocv_rows(
            self._tables,
            self.init(soc0, soc0_std),
            np.array(log.interval_current_A),
            log.voltage_V,
            measured_temperature_C(log),
            self._default_C,
            log.interval_s,
            log.gap_rows,
            self._rules,
            out,
            status,
        )
        missing = np.full(n, np.nan)
        return Trace(log.time_s, out[0], out[1], missing, missing, missing, missing, status)
