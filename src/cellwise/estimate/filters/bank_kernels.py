"""A start that nobody knows, in float64: a bank's memory, where it begins, one step of it.

The bank itself is :mod:`cellwise.estimate.equations.bank`, for float64 and for C.
"""

from __future__ import annotations

import math

import numpy as np

from cellwise.cell.compiled import inline, part
from cellwise.cell.description import BRANCHES, CELL
from cellwise.cell.equations import CellTables, loaded
from cellwise.cell.packed import changed, put_record, record_at, records_in
from cellwise.cell.unrolled import ByState, unrolled
from cellwise.estimate.equations.bank import begin_bank, spread_again, step_spread
from cellwise.estimate.equations.constants import (
    LOAD_LIMIT_V,
    RECOVERY_RATE,
    RECOVERY_VARIANCE,
    SPREAD_VARIANCE,
)
from cellwise.estimate.equations.start import held_variance
from cellwise.estimate.evidence_kernels import stated_deviation, step_constants
from cellwise.estimate.filters.component_kernels import STATE, BankModel
from cellwise.estimate.filters.covariance_kernels import Branches, uncorrelated
from cellwise.estimate.filters.filter_state import EkfInfo, EkfStart, EkfState
from cellwise.estimate.filters.offset_kernels import drift_variance, no_drift
from cellwise.estimate.filters.predict_kernels import RESTED_V2
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import MeasuredSample, read_sample
from cellwise.estimate.status import CURRENT_LOST, GATE_RECOVERY, SEQUENCE_GAP
from cellwise.typing import FloatArray

COMPONENTS = 11  # with 7 to 31 of them errors differ by less than their scatter

# A bank in memory: the estimate, the components, the record of the bank, one in each row. That
# record has the fields of the fixed step's, and behind them what a step has predicted.
BANK_FIELDS = (
    *("spread", "likeliest", "mismatch", "since", "mean_A", "looked_A", "looks", "next_look"),
    *(s.name for s in CELL),
    *("ss", "steps", "samples", "readings"),
    *("off_V", "block_A", "unknown_A2", "first_V2", "known", "turn", "look", "moved", "grown"),
    *(f"gain{s.letter}" for s in BRANCHES),
    *(f"current{s.letter}" for s in BRANCHES),
    *("square_A2", "keep_h", "rise_h", "said_V", "said_A", "error_V2", "weight_V2", "below"),
    *("share", "lately", "mean_off_V", "square_V2", "own_V2", "left_V", "left_V2"),
    *("voltage_V", "innovation_V", "innovation_variance_V2"),
)
BANK = np.dtype([(name, np.float64) for name in BANK_FIELDS])
RECORD = -1  # the last row


def empty_bank(components: int = COMPONENTS) -> FloatArray:
    """Memory of a bank, shape (components and 2, numbers of a state)."""
    return np.zeros((components + 2, STATE.itemsize // 8))


@inline
def count_of(bank: FloatArray) -> int:
    """How many components there is room for."""
    return int(bank.shape[0]) - 2


@inline
def state_in(bank: FloatArray, k: int) -> EkfState:
    """The estimate (0) or a component (1 on)."""
    state: EkfState = record_at(EkfState, bank[k], 0, 1)
    return state


@inline
def is_spread(bank: FloatArray) -> bool:
    """Whether components are stepped."""
    return bool(bank[RECORD, 0] > 0.0)


@part
def open_bank(bank: FloatArray, state: EkfState) -> None:
    """A cell that nobody has seen yet, or the estimate alone where its start is known."""
    put_record(bank[0], 0, 1, state, True)
    room = count_of(bank) if math.isfinite(state.cell.soc) else 0
    begin_bank(records_in(BANK, bank)[RECORD], records_in(STATE, bank), room)


@part
@unrolled
def loosened(tables: CellTables, start: EkfStart, state: EkfState) -> EkfState:
    """After voltages that contradicted it for long the SOC is open, branches may hold anything."""
    x: ByState = state.cell
    p = state.p
    held_A = RECOVERY_RATE * tables.cell.charge_As / 3600.0
    temperature_C = state.watch.temperature_C
    if not math.isfinite(temperature_C):
        temperature_C = start.temperature_C
    point: ByState = loaded(tables, x.soc, temperature_C, state.watch.current_A, x.slow_A)
    v = Branches(
        *(
            held_variance(RESTED_V2, point.r[i], held_A, LOAD_LIMIT_V) + x.state[i] * x.state[i]
            for i in BRANCHES
        )
    )
    state = changed(changed(state, "persistent", 0.0), "contradicted", 0.0)
    state = changed(state, "drift", no_drift())
    return changed(state, "p", uncorrelated(max(p.ss, RECOVERY_VARIANCE), v, p.phh))


@part
def spread_about(bank: FloatArray, state: EkfState) -> None:
    """Components over all of the SOC about a state that has been stepped alone."""
    put_record(bank[0], 0, 1, state, True)
    spread_again(records_in(BANK, bank)[RECORD], records_in(STATE, bank), count_of(bank))


@inline
def begin_again(
    tables: CellTables, start: EkfStart, bank: FloatArray, state: EkfState, status: int
) -> EkfState:
    """After a step alone: the state, with components around it where they have to begin again."""
    if status & GATE_RECOVERY:
        state = loosened(tables, start, state)
        spread_about(bank, state)
        return state
    has_voltage_now = state.watch.evidence_s >= 0.0 and state.watch.no_voltage_s == 0.0
    uncounted = status & (SEQUENCE_GAP | CURRENT_LOST) != 0
    if has_voltage_now and uncounted and state.p.ss > SPREAD_VARIANCE:
        spread_about(bank, state)
    return state


@part
def step_bank(
    tables: CellTables,
    noise: NoiseScalars,
    start: EkfStart,
    bank: FloatArray,
    sample: MeasuredSample,
) -> EkfInfo:
    """Every component over one interval; the estimate is in the first row."""
    b, of = records_in(BANK, bank)[RECORD], records_in(STATE, bank)
    watch = state_in(bank, 0).watch
    reading = read_sample(tables, noise, watch, start.temperature_C, sample)
    m = BankModel(step_constants(tables.cell, noise, reading.dt_s), tables, noise, start)
    status = step_spread(m, b, of, count_of(bank), reading, b, reading.dt_s, reading.gap)
    now = state_in(bank, 0)
    known = now.p.ss + drift_variance(now.drift)
    std = stated_deviation(known, now.mismatch, now.persistent, now.contradicted)
    off, variance = reading.voltage_V - b.voltage_V, b.innovation_variance_V2
    ratio = off * off / variance * noise.per_gate2
    return EkfInfo(now.cell.soc, std, b.voltage_V, off, variance, ratio, status)
