"""EKF, UKF and adaptive filter, compiled: a step for online use, a loop for the rows of a log."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from cellwise.cell.compiled import inline, kernel, part, rows
from cellwise.cell.equations import CellTables
from cellwise.cell.packed import put_record, record_at, size_of
from cellwise.cell.point_kernels import CellScalars
from cellwise.estimate.filters.bank_kernels import (
    begin_again,
    is_spread,
    open_bank,
    state_in,
    step_bank,
)
from cellwise.estimate.filters.capacity_kernels import Free, FreeRules, nothing_known, waiting
from cellwise.estimate.filters.filter_state import (
    OUT_CHARGE,
    OUT_CHARGE_FREE,
    OUT_CHARGE_STD,
    OUT_INNOVATION,
    OUT_MOVES,
    OUT_OFFSET,
    OUT_OFFSET_FREE,
    OUT_OFFSET_STD,
    OUT_RATIO,
    OUT_RESISTANCE,
    OUT_RESISTANCE_STD,
    OUT_SOC,
    OUT_SOC_VARIANCE,
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
from cellwise.estimate.sensing_kernels import NOT_BEGUN_S, MeasuredSample
from cellwise.typing import FloatArray

# Where the constants of a filter begin in their row: the cell, its noise, the start of the unknown.
NOISE_AT = size_of(CellScalars)
UNKNOWN_AT = NOISE_AT + size_of(NoiseScalars)


@part
def bank_or_alone(
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars | None,
    rules: FreeRules | None,
    start: EkfStart,
    bank: FloatArray,
    free: Free | None,
    sample: MeasuredSample,
) -> tuple[EkfState, Free | None, EkfInfo]:
    """One step of a bank in memory: of its components, or of the estimate alone."""
    state = state_in(bank, 0)
    if not is_spread(bank) and state.watch.evidence_s == NOT_BEGUN_S:
        open_bank(bank, state)
    if is_spread(bank):
        info = step_bank(tables, noise, start, bank, sample)
        state = state_in(bank, 0)
        return state, waiting(rules, free, state.drift), info
    state, free, info = filter_step(tables, noise, sigma, rules, start, state, free, sample)
    state = begin_again(tables, start, bank, state, info.status)
    put_record(bank[0], 0, 1, state, True)
    return state, free, info


@kernel
def kalman_step_of_rows(
    table: FloatArray,
    grid_C: FloatArray,
    constants: FloatArray,
    sigma: SigmaScalars | None,
    bank: FloatArray,
    current_A: float,
    voltage_V: float,
    temperature_C: float,
    dt_s: float,
    gap: bool,
    out: FloatArray,
) -> int:
    """The same for online use, on rows of numbers: ``bank`` goes on, ``out`` is the info.

    Returns
    -------
    int       the status
    """
    tables = CellTables(table, grid_C, record_at(CellScalars, constants, 0, 1))
    noise = record_at(NoiseScalars, constants, NOISE_AT, 1)
    unknown = record_at(EkfStart, constants, UNKNOWN_AT, 1)
    sample = MeasuredSample(current_A, voltage_V, temperature_C, dt_s, gap)
    _, _, info = bank_or_alone(tables, noise, sigma, None, unknown, bank, None, sample)
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
def sample_of(log: LogArrays, k: int) -> MeasuredSample:
    """What the sensors say in one row."""
    return MeasuredSample(
        log.current_A[k], log.voltage_V[k], log.temperature_C[k], log.dt_s[k], log.gap[k]
    )


@inline
def put_free(
    rules: FreeRules | None,
    offset_A: float,
    values: FloatArray,
    k: int,
    state: EkfState,
    free: Free | None,
) -> None:
    """What is known of offset, capacity and resistances in one row.

    ``offset_A`` is one deviation of the offset before any data.
    """
    if rules is None or free is None:
        return
    c, r = free.capacity, free.resistances
    values[OUT_OFFSET, k] = state.drift.believed * offset_A
    values[OUT_OFFSET_STD, k] = math.sqrt(max(state.drift.unsure, 0.0)) * offset_A
    values[OUT_OFFSET_FREE, k] = c.offset_chance
    values[OUT_CHARGE, k] = c.believed * rules.capacity
    values[OUT_CHARGE_STD, k] = math.sqrt(max(c.unsure, 0.0)) * rules.capacity
    values[OUT_CHARGE_FREE, k] = c.chance
    values[OUT_RESISTANCE, k] = r.factor
    values[OUT_RESISTANCE_STD, k] = math.sqrt(r.variance)
    values[OUT_MOVES, k] = 1.0 if r.drop_V2 >= rules.resistances.swing_V2 else 0.0
    values[OUT_SOC_VARIANCE, k] = state.p.ss


@inline
def filter_rows(
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars | None,
    rules: FreeRules | None,
    first: EkfStart,
    start: EkfStart,
    bank: FloatArray,
    log: LogArrays,
    out: TraceArrays,
) -> None:
    """Every row of a log through one step each; ``bank`` is their memory.

    The log begins at ``first``; ``start`` is where a state begins again that is no longer finite.
    Each row is :func:`bank_or_alone`, but the state of a filter alone stays in registers.
    """
    state, free = ekf_start(first, log.current_A[0]), nothing_known(rules)
    open_bank(bank, state)
    spread = is_spread(bank)
    offset_A = noise.offset_soc_per_s * tables.cell.charge_As
    for k in range(log.dt_s.size):
        sample = sample_of(log, k)
        if spread:
            info = step_bank(tables, noise, start, bank, sample)
            state = state_in(bank, 0)
            free = waiting(rules, free, state.drift)
            spread = is_spread(bank)
        else:
            # fmt: off
            state, free, info = filter_step(
                tables, noise, sigma, rules, start, state, free, sample
            )
            # fmt: on
            state = begin_again(tables, start, bank, state, info.status)
            spread = is_spread(bank)
        put_info(out.values, k, info)
        put_free(rules, offset_A, out.values, k, state, free)
        out.status[k] = info.status


@rows
def kalman_rows(
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars | None,
    first: EkfStart,
    start: EkfStart,
    bank: FloatArray,
    log: LogArrays,
    out: TraceArrays,
) -> None:
    """EKF or UKF over a log."""
    filter_rows(tables, noise, sigma, None, first, start, bank, log, out)


class AdaptiveState(NamedTuple):
    """What must be carried: the EKF's state, and what is known of capacity and resistances.

    The offset of the current is one of the EKF's hypotheses.
    """

    filter: EkfState
    free: Free

    def __getattr__(self, name: str) -> Any:
        """What its two parts have: the EKF's SOC, offset and capacity as they are believed."""
        return getattr(self.free if name in Free._fields else self.filter, name)


@kernel
def adaptive_start(start: EkfStart, rules: FreeRules, current_A: float) -> AdaptiveState:
    """A cell known as ``start`` says; the model's own values."""
    return AdaptiveState(ekf_start(start, current_A), nothing_known(rules))  # type: ignore[arg-type]


@kernel
def adaptive_step(
    tables: CellTables,
    noise: NoiseScalars,
    rules: FreeRules,
    start: EkfStart,
    bank: FloatArray,
    free: Free,
    sample: MeasuredSample,
    out: TraceArrays,
) -> Free:
    """One step for online use; ``bank`` goes on, ``out`` is its one row."""
    state, after, info = bank_or_alone(tables, noise, None, rules, start, bank, free, sample)
    put_info(out.values, 0, info)
    put_free(rules, noise.offset_soc_per_s * tables.cell.charge_As, out.values, 0, state, after)
    out.status[0] = info.status
    return after  # type: ignore[return-value]  # rules given, so not None


@rows
def adaptive_rows(
    tables: CellTables,
    noise: NoiseScalars,
    rules: FreeRules,
    first: EkfStart,
    start: EkfStart,
    bank: FloatArray,
    log: LogArrays,
    out: TraceArrays,
) -> None:
    """The adaptive filter over a log; ``out.values`` (ADAPTIVE_OUTPUTS, rows)."""
    filter_rows(tables, noise, None, rules, first, start, bank, log, out)
