"""The present state of every row of a log, as the power is computed from it, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline, kernel, rows
from cellwise.cell.equations import CellState, CellTables, advance, seen_current, with_soc
from cellwise.estimate.filters.covariance_kernels import Covariance
from cellwise.estimate.filters.filter_state import (
    EkfInfo,
    EkfStart,
    EkfState,
    LogArrays,
    ekf_start,
)
from cellwise.estimate.filters.kalman_kernels import kalman_step, reading_of
from cellwise.estimate.filters.sigma_kernels import SigmaScalars
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.power.limit_kernels import SUSTAINED_SIGMAS, LimitScalars, largest_load
from cellwise.estimate.power.load_kernels import AS_MODEL, Correction, Present, moment_of
from cellwise.estimate.sensing_kernels import Reading
from cellwise.estimate.status import INNOVATION_REJECTED, VOLTAGE_FROZEN, VOLTAGE_INVALID
from cellwise.typing import FloatArray, IntArray

# What the model has been off by over the longest usual horizon is taken to stay over the next.
BIAS_S = 30.0
# Rows of the present: cell, covariance, then what else is known.
CELL, COVARIANCE, REST = 0, 7, 22
SOC_VARIANCE, MISMATCH, FAST, TAIL, BIAS, SCALE_VARIANCE = range(REST, REST + 6)
PRESENT = REST + 6
UNUSED = INNOVATION_REJECTED | VOLTAGE_INVALID | VOLTAGE_FROZEN
# What is written for each horizon.
DISCHARGE_W, DISCHARGE_LOW_W, CHARGE_W, CHARGE_LOW_W = range(4)
POWERS = 4


class Bias(NamedTuple):
    """Running mean of measured less modelled voltage, over which time it goes by now.

    ``known`` is whether any voltage has been seen, ``current_A`` the last current.
    """

    voltage_V: float
    seen_s: float
    known: bool
    current_A: float


@kernel
def no_bias() -> Bias:
    """Before any sample."""
    return Bias(0.0, 0.0, False, math.nan)


@kernel
def bias_step(
    tables: CellTables,
    bias: Bias,
    x: CellState,
    but: Correction,
    reading: Reading,
    temperature_C: float,
    status: int,
) -> Bias:
    """Mean over ``BIAS_S`` of measured less modelled voltage; a plain mean until it is full.

    The voltage is that of the state ``x`` after the sample was used; one that was rejected, or is
    the sensor's fault, is left out.
    """
    before = bias.current_A if math.isfinite(bias.current_A) else reading.current_A
    seen_A = seen_current(tables.cell, reading.current_A, before, reading.dt_s)
    now = moment_of(tables, x, seen_A, False, temperature_C + x.heat_K, but)
    off = reading.voltage_V - (now.voltage_V - but.bias_V)
    if not math.isfinite(off) or status & UNUSED:
        return Bias(bias.voltage_V, bias.seen_s, bias.known, reading.current_A)
    seen = min(bias.seen_s + reading.dt_s, BIAS_S)
    share = min(reading.dt_s / seen, 1.0) if seen > 0.0 else 1.0
    mean = bias.voltage_V + share * (off - bias.voltage_V)
    return Bias(mean, seen, True, reading.current_A)


@inline
def put_cell(out: FloatArray, k: int, x: CellState) -> None:
    """The cell of one row."""
    i = CELL
    for value in (x.soc, x.v1_V, x.v2_V, x.v3_V, x.h, x.heat_K, x.slow_A):
        out[i, k] = value
        i += 1


@inline
def put_state(out: FloatArray, k: int, state: EkfState, info: EkfInfo, bias: Bias) -> None:
    """A filter's state in one row."""
    put_cell(out, k, state.cell)
    p = state.p
    i = COVARIANCE
    for value in (
        p.ss, p.s1, p.s2, p.s3, p.sh, p.p11, p.p12, p.p13, p.p1h, p.p22, p.p23, p.p2h, p.p33,
        p.p3h, p.phh,
    ):  # fmt: skip
        out[i, k] = value
        i += 1
    out[SOC_VARIANCE, k] = info.soc_std * info.soc_std
    out[MISMATCH, k] = state.mismatch
    out[FAST, k] = 1.0
    out[TAIL, k] = 1.0
    out[BIAS, k] = bias.voltage_V
    out[SCALE_VARIANCE, k] = 0.0


@inline
def bias_after(
    tables: CellTables, bias: Bias, state: EkfState, start: EkfStart, reading: Reading, status: int
) -> Bias:
    """The bias after a filter's step, at the temperature it has last known."""
    warm_C = state.watch.temperature_C
    if not math.isfinite(warm_C):
        warm_C = start.temperature_C
    return bias_step(tables, bias, state.cell, AS_MODEL, reading, warm_C, status)


@rows
def kalman_states(
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars | None,
    first: EkfStart,
    start: EkfStart,
    log: LogArrays,
    out: FloatArray,
) -> None:
    """States of EKF or UKF after every row, shape (PRESENT, rows)."""
    state = ekf_start(first, log.current_A[0])
    bias = no_bias()
    for k in range(log.dt_s.size):
        state, info = kalman_step(tables, noise, sigma, start, state, reading_of(log, k))
        bias = bias_after(tables, bias, state, start, reading_of(log, k), info.status)
        put_state(out, k, state, info, bias)


@rows
def carried_states(
    tables: CellTables,
    start: CellState,
    dt_s: FloatArray,
    current_A: FloatArray,
    temperature_C: FloatArray,
    soc: FloatArray,
    soc_std: FloatArray,
    voltage_V: FloatArray,
    status: IntArray,
    out: FloatArray,
) -> None:
    """The cell carried through a log by its current with an estimator's SOC, for every other one.

    Rows ``FAST``, ``TAIL`` and ``SCALE_VARIANCE`` of ``out`` belong to the caller.
    """
    state = start
    previous = current_A[0]
    bias = no_bias()
    for k in range(dt_s.size):
        seen = seen_current(tables.cell, current_A[k], previous, dt_s[k])
        previous = current_A[k]
        state, _ = advance(tables, state, seen, dt_s[k], temperature_C[k])
        state = with_soc(state, soc[k])
        reading = Reading(seen, voltage_V[k], temperature_C[k], dt_s[k], False)
        but = Correction(out[FAST, k], out[TAIL, k], 0.0)
        bias = bias_step(tables, bias, state, but, reading, temperature_C[k], status[k])
        put_cell(out, k, state)
        variance = soc_std[k] * soc_std[k]
        for i in range(COVARIANCE, REST):
            out[i, k] = 0.0
        out[COVARIANCE, k] = variance
        out[SOC_VARIANCE, k] = variance
        out[MISMATCH, k] = 1.0
        out[BIAS, k] = bias.voltage_V


@inline
def present_at(values: FloatArray, k: int, temperature_C: float) -> Present:
    """One row as it was put."""
    v = values[:, k]
    cell = CellState(v[0], v[1], v[2], v[3], v[4], v[5], v[6])
    # fmt: off
    p = Covariance(
        v[7], v[8], v[9], v[10], v[11], v[12], v[13], v[14], v[15], v[16], v[17], v[18], v[19],
        v[20], v[21],
    )
    # fmt: on
    but = Correction(v[FAST], v[TAIL], v[BIAS])
    return Present(cell, p, v[SOC_VARIANCE], v[MISMATCH], temperature_C, but, v[SCALE_VARIANCE])


@rows
def power_rows(
    tables: CellTables,
    noise: NoiseScalars,
    limits: LimitScalars,
    power: bool,
    horizons_s: FloatArray,
    present: FloatArray,
    temperature_C: FloatArray,
    guess: FloatArray,
    out: FloatArray,
) -> None:
    """Power of every row, shape (POWERS, horizons, rows), from presents of shape (PRESENT, rows).

    ``guess``, shape (POWERS, horizons), are loads to begin at; it is written.
    """
    for k in range(temperature_C.size):
        now = present_at(present, k, temperature_C[k])
        for j in range(horizons_s.size):
            for side in (1.0, -1.0):
                for low in (False, True):
                    i = (DISCHARGE_W if side > 0.0 else CHARGE_W) + (1 if low else 0)
                    found = largest_load(
                        tables, noise, limits, now, power, horizons_s[j], side,
                        SUSTAINED_SIGMAS if low else 0.0, guess[i, j],
                    )  # fmt: skip
                    guess[i, j] = abs(found.load)
                    out[i, j, k] = found.power_W
