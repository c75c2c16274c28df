"""EKF and UKF, compiled: one step for online use, one loop for the rows of a log."""

from __future__ import annotations

from cellwise.cell.compiled import inline, kernel, rows
from cellwise.cell.equations import CellTables
from cellwise.estimate.filters.filter_state import (
    OUT_INNOVATION,
    OUT_RATIO,
    OUT_SOC,
    OUT_STD,
    OUT_VARIANCE,
    OUT_VOLTAGE,
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


@kernel
def kalman_step(
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars | None,
    start: EkfStart,
    state: EkfState,
    reading: Reading,
) -> tuple[EkfState, EkfInfo]:
    """One step for online use; ``start`` re-initialises a state gone wrong."""
    after, _, info = filter_step(tables, noise, sigma, None, start, state, None, reading)
    return after, info


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
