"""The present state of every row of a log, as the power is computed from it, compiled."""

from __future__ import annotations

import math

from cellwise.cell.compiled import inline, kernel, rows
from cellwise.cell.equations import CellState, CellTables, advance, seen_current, with_soc
from cellwise.cell.packed import place_of, put_record, record_at, size_of
from cellwise.estimate.filters.covariance_kernels import uncorrelated
from cellwise.estimate.filters.filter_state import EkfStart, EkfState, LogArrays, ekf_start
from cellwise.estimate.filters.kalman_kernels import kalman_step, reading_of
from cellwise.estimate.filters.sigma_kernels import SigmaScalars
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.power.limit_kernels import SUSTAINED_SIGMAS, LimitScalars, largest_load
from cellwise.estimate.power.load_kernels import Present
from cellwise.estimate.power.memory_kernels import Memory, no_memory, remembered
from cellwise.estimate.sensing_kernels import Reading
from cellwise.typing import FloatArray, IntArray

PRESENT = size_of(Present)
TEMPERATURE_AT = place_of(Present, "temperature_C")


@inline
def remembered_after(
    tables: CellTables, was: Memory, state: EkfState, start: EkfStart, reading: Reading, status: int
) -> Memory:
    """The memory after a filter's step, at the temperature it has last known."""
    warm_C = state.watch.temperature_C
    if not math.isfinite(warm_C):
        warm_C = start.temperature_C
    return remembered(tables, was, state.cell, reading, warm_C, status)


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
    """What is known after every row of EKF or UKF, shape (rows, PRESENT); no temperatures."""
    state = ekf_start(first, log.current_A[0])
    memory = no_memory()
    for k in range(log.dt_s.size):
        state, info = kalman_step(tables, noise, sigma, start, state, reading_of(log, k))
        memory = remembered_after(tables, memory, state, start, reading_of(log, k), info.status)
        variance = info.soc_std * info.soc_std
        now = Present(state.cell, state.p, variance, state.mismatch, math.nan, memory.but)
        put_record(out[k], 0, now)


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
    """The cell carried through a log by its current with the SOC of any other estimator."""
    state = start
    previous = current_A[0]
    memory = no_memory()
    for k in range(dt_s.size):
        seen = seen_current(tables.cell, current_A[k], previous, dt_s[k])
        previous = current_A[k]
        state, _ = advance(tables, state, seen, dt_s[k], temperature_C[k])
        state = with_soc(state, soc[k])
        reading = Reading(seen, voltage_V[k], temperature_C[k], dt_s[k], False)
        memory = remembered(tables, memory, state, reading, temperature_C[k], status[k])
        variance = soc_std[k] * soc_std[k]
        known = uncorrelated(variance, 0.0, 0.0, 0.0, 0.0)
        put_record(out[k], 0, Present(state, known, variance, 1.0, temperature_C[k], memory.but))


@kernel
def present_at(values: FloatArray, k: int) -> Present:
    """One row as it was put."""
    now: Present = record_at(Present, values[k], 0)
    return now


@rows
def power_rows(
    tables: CellTables,
    noise: NoiseScalars,
    limits: LimitScalars,
    power: bool,
    horizons_s: FloatArray,
    present: FloatArray,
    guess: FloatArray,
    out: FloatArray,
) -> None:
    """Power of every row, shape (rows, horizons, ways, 5), from presents (rows, PRESENT).

    On discharge and on charge the power, its lower bound, current and voltage at the horizon's end
    and what limits it. ``guess``, of the shape of a row, holds loads to begin at; it is written.
    """
    for k in range(present.shape[0]):
        now = present_at(present, k)
        for j in range(horizons_s.size):
            for way in range(2):
                side = 1.0 - 2.0 * way
                found = largest_load(
                    tables, noise, limits, now, power, horizons_s[j], side, 0.0, guess[j, way, 0]
                )
                low = largest_load(
                    tables, noise, limits, now, power, horizons_s[j], side, SUSTAINED_SIGMAS,
                    guess[j, way, 1],
                )  # fmt: skip
                guess[j, way, 0], guess[j, way, 1] = abs(found.load), abs(low.load)
                out[k, j, way, 0] = found.power_W
                out[k, j, way, 1] = min(low.power_W, found.power_W)
                out[k, j, way, 2] = found.current_A
                out[k, j, way, 3] = found.voltage_V
                out[k, j, way, 4] = found.reason
