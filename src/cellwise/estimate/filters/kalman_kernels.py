"""EKF and UKF, compiled: one step for online use, one loop for the rows of a log."""

from __future__ import annotations

from cellwise.cell.compiled import inline, kernel, rows
from cellwise.cell.equations import CellTables
from cellwise.cell.packed import put_record, record_at, size_of
from cellwise.cell.point_kernels import CellScalars
from cellwise.estimate.filters.filter_state import (
    OUT_INNOVATION,
    OUT_RATIO,
    OUT_SOC,
    OUT_STD,
    OUT_VARIANCE,
    OUT_VOLTAGE,
    OUTPUTS,
    EkfInfo,
    EkfStart,
    EkfState,
    LogArrays,
    TraceArrays,
    ekf_start,
)
from cellwise.estimate.filters.sigma_kernels import SigmaScalars
from cellwise.estimate.filters.step_kernels import filter_step
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import Reading
from cellwise.typing import FloatArray

# Where the constants of a filter begin in their row: the cell, its noise, the start of the unknown.
NOISE_AT = size_of(CellScalars)
UNKNOWN_AT = NOISE_AT + size_of(NoiseScalars)


@kernel
def kalman_step(
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars | None,
    start: EkfStart,
    state: EkfState,
    reading: Reading,
) -> tuple[EkfState, EkfInfo]:
    """One step for other kernels; ``start`` re-initialises a state gone wrong."""
    after, _, info = filter_step(tables, noise, sigma, None, start, state, None, reading)
    return after, info


@kernel
def kalman_step_of_rows(
    table: FloatArray,
    grid_C: FloatArray,
    constants: FloatArray,
    sigma: SigmaScalars | None,
    state: FloatArray,
    current_A: float,
    voltage_V: float,
    temperature_C: float,
    dt_s: float,
    gap: bool,
    out: FloatArray,
) -> int:
    """The same for online use, on rows of numbers: ``state`` goes on, ``out`` is the info.

    Returns
    -------
    int       the status
    """
    tables = CellTables(table, grid_C, record_at(CellScalars, constants, 0))
    noise = record_at(NoiseScalars, constants, NOISE_AT)
    unknown = record_at(EkfStart, constants, UNKNOWN_AT)
    reading = Reading(current_A, voltage_V, temperature_C, dt_s, gap)
    old = record_at(EkfState, state, 0)
    after, info = kalman_step(tables, noise, sigma, unknown, old, reading)
    put_record(state, 0, after)
    put_info(out.reshape((OUTPUTS, 1)), 0, info)
    return info.status


@inline
def put_info(values: FloatArray, k: int, info: EkfInfo) -> None:
    """One row of a trace, but its status."""
    values[OUT_SOC, k] = info.soc
    values[OUT_STD, k] = info.soc_std
    values[OUT_VOLTAGE, k] = info.voltage_V
    values[OUT_INNOVATION, k] = info.innovation_V
    values[OUT_VARIANCE, k] = info.innovation_variance_V2
    values[OUT_RATIO, k] = info.test_ratio


@inline
def reading_of(log: LogArrays, k: int) -> Reading:
    """What the sensors say in one row."""
    return Reading(
        log.current_A[k], log.voltage_V[k], log.temperature_C[k], log.dt_s[k], log.gap[k]
    )


@rows
def kalman_rows(
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars | None,
    first: EkfStart,
    start: EkfStart,
    log: LogArrays,
    out: TraceArrays,
) -> EkfState:
    """Every row of a log through one step each, from ``first``."""
    state = ekf_start(first, log.current_A[0])
    for k in range(log.dt_s.size):
        reading = reading_of(log, k)
        state, _, info = filter_step(tables, noise, sigma, None, start, state, None, reading)
        put_info(out.values, k, info)
        out.status[k] = info.status
    return state
