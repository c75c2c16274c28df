"""The adaptive filter, compiled: the EKF's step with capacity and resistances free."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from cellwise.cell.compiled import inline, kernel, rows
from cellwise.cell.equations import CellTables
from cellwise.estimate.filters.filter_state import (
    OUTPUTS,
    EkfInfo,
    EkfStart,
    EkfState,
    LogArrays,
    TraceArrays,
    ekf_start,
)
from cellwise.estimate.filters.free_kernels import (
    Free,
    FreeRules,
    no_capacity,
    no_resistances,
)
from cellwise.estimate.filters.kalman_kernels import put_info, reading_of
from cellwise.estimate.filters.step_kernels import filter_step
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import Reading

# Rows of ``values`` behind the EKF's: mean and deviation of each number, probabilities, whether the
# load moves enough to show a resistance, variance of the SOC.
OUT_OFFSET, OUT_FAST, OUT_TAIL, OUT_CHARGE = range(OUTPUTS, OUTPUTS + 4)
OUT_OFFSET_STD, OUT_FAST_STD, OUT_TAIL_STD, OUT_CHARGE_STD = range(OUTPUTS + 4, OUTPUTS + 8)
OUT_OFFSET_FREE, OUT_CHARGE_FREE, OUT_MOVES, OUT_SOC_VARIANCE = range(OUTPUTS + 8, OUTPUTS + 12)
ADAPTIVE_OUTPUTS = OUTPUTS + 12


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
    free = Free(no_capacity(), no_resistances(rules.resistances.variance))
    return AdaptiveState(ekf_start(start, current_A), free)


@kernel
def adaptive_step(
    tables: CellTables,
    noise: NoiseScalars,
    rules: FreeRules,
    start: EkfStart,
    state: AdaptiveState,
    reading: Reading,
) -> tuple[AdaptiveState, EkfInfo]:
    """One step for online use."""
    after, free, info = filter_step(
        tables, noise, None, rules, start, state.filter, state.free, reading
    )
    return AdaptiveState(after, free), info  # type: ignore[arg-type]  # given, so not None


@inline
def put_free(
    rules: FreeRules, offset_A: float, out: TraceArrays, k: int, state: EkfState, free: Free
) -> None:
    """What is known of offset, capacity and resistances in one row.

    ``offset_A`` is one deviation of the offset before any data.
    """
    c, r, v = free.capacity, free.resistances, out.values
    v[OUT_OFFSET, k] = state.drift.believed * offset_A
    v[OUT_OFFSET_STD, k] = math.sqrt(max(state.drift.unsure, 0.0)) * offset_A
    v[OUT_OFFSET_FREE, k] = c.offset_chance
    v[OUT_CHARGE, k] = c.believed * rules.capacity
    v[OUT_CHARGE_STD, k] = math.sqrt(max(c.unsure, 0.0)) * rules.capacity
    v[OUT_CHARGE_FREE, k] = c.chance
    v[OUT_FAST, k] = r.fast
    v[OUT_FAST_STD, k] = math.sqrt(r.fast_variance)
    v[OUT_TAIL, k] = r.tail
    v[OUT_TAIL_STD, k] = math.sqrt(r.tail_variance)
    v[OUT_MOVES, k] = 1.0 if r.drop_V2 >= rules.resistances.swing_V2 else 0.0
    v[OUT_SOC_VARIANCE, k] = state.p.ss


@rows
def adaptive_rows(
    tables: CellTables,
    noise: NoiseScalars,
    rules: FreeRules,
    first: EkfStart,
    start: EkfStart,
    log: LogArrays,
    out: TraceArrays,
) -> None:
    """Every row of a log through one step each; ``out.values`` (ADAPTIVE_OUTPUTS, rows)."""
    state = ekf_start(first, log.current_A[0])
    free = Free(no_capacity(), no_resistances(rules.resistances.variance))
    offset_A = noise.offset_soc_per_s * tables.cell.charge_As
    for k in range(log.dt_s.size):
        reading = reading_of(log, k)
        state, free, info = filter_step(  # type: ignore[assignment]  # given, so not None
            tables, noise, None, rules, start, state, free, reading
        )
        put_info(out.values, k, info)
        put_free(rules, offset_A, out, k, state, free)
        out.status[k] = info.status
