"""Compiled row loops allocate nothing per row: 100 rows and 100,000 leave the same count."""

from __future__ import annotations

import gc

import numpy as np
import pytest
from numba import njit
from numba.core.runtime import _nrt_python, rtsys

from cellwise.cell.equations import empty_state
from cellwise.cell.protocol import supply_kernels as protocol_kernels
from cellwise.cell.simulate import simulate_rows
from cellwise.estimate.adaptive import AdaptiveSettings
from cellwise.estimate.filters.bank_kernels import empty_bank
from cellwise.estimate.filters.coulomb import CoulombState, CountRules, gauge_rows
from cellwise.estimate.filters.filter_state import ADAPTIVE_OUTPUTS, OUTPUTS, LogArrays, TraceArrays
from cellwise.estimate.filters.kalman import Ekf, SigmaPoints
from cellwise.estimate.filters.kalman_kernels import adaptive_rows, kalman_rows
from example_cells import EFFECTS, curved_cell

MODEL = curved_cell(effects=EFFECTS)
EKF = Ekf(MODEL)


@pytest.fixture
def allocations():
    """Count of allocations that a call makes in numba's runtime."""
    enabled = _nrt_python.memsys_stats_enabled()
    _nrt_python.memsys_enable_stats()

    def count(call, rows):
        arguments = call(rows)
        arguments[0](*arguments[1:])  # compiled before the clock starts
        gc.disable()  # what others left behind stays out of the count
        try:
            before = rtsys.get_allocation_stats()
            arguments[0](*arguments[1:])
            after = rtsys.get_allocation_stats()
        finally:
            gc.enable()
        return after.alloc - before.alloc, after.mi_alloc - before.mi_alloc

    yield count
    if not enabled:
        _nrt_python.memsys_disable_stats()


def ekf_call(rows):
    rng = np.random.default_rng(1)
    current, voltage = rng.normal(0, 3, rows), rng.normal(3.7, 0.1, rows)
    voltage[::7] = np.nan
    dt, warm = np.full(rows, 0.1), np.full(rows, 25.0)
    gap = np.zeros(rows, dtype=np.bool_)
    start = EKF.start(0.5)
    out = TraceArrays(np.empty((OUTPUTS, rows)), np.empty(rows, dtype=np.int32))
    log = LogArrays(current, voltage, warm, dt, gap)
    return (
        kalman_rows,
        MODEL.parameters(),
        EKF.noise.scalars(),
        None,
        start,
        start,
        empty_bank(),
        log,
        out,
    )


def ukf_call(rows):
    call, tables, noise, _, *rest = ekf_call(rows)
    return call, tables, noise, SigmaPoints().scalars(), *rest


def adaptive_call(rows):
    _, tables, noise, _, first, start, bank, log, _ = ekf_call(rows)
    out = np.empty((ADAPTIVE_OUTPUTS, rows)), np.empty(rows, dtype=np.int32)
    rules = AdaptiveSettings().rules()
    return adaptive_rows, tables, noise, rules, first, start, bank, log, TraceArrays(*out)


def simulate_call(rows):
    current = np.random.default_rng(1).normal(0, 3, rows)
    dt, warm = np.full(rows, 0.1), np.full(rows, 25.0)
    return (simulate_rows, MODEL.parameters(), empty_state(0.5), dt, current, warm,
            np.empty(rows), np.empty(rows))  # fmt: skip


def coulomb_call(rows):
    _, tables, _, _, _, _, _, log, _ = ekf_call(rows)
    begin = CountRules(1e-5, 0.05, 600.0), CoulombState(0.5, 0.01, 0.0, np.inf), 25.0
    return gauge_rows, tables, *begin, log, np.empty((2, rows)), np.empty(rows, dtype=np.int32)


def profile_call(rows):
    current = np.random.default_rng(1).normal(0, 9, rows)
    supply = protocol_kernels.Supply(3.4, 3.8, np.nan, 25.0)
    return (protocol_kernels.supply_rows, MODEL.parameters(), empty_state(0.5), supply, 0.0,
            0.1 * np.arange(1.0, rows + 1), np.minimum(current, 0.0), np.maximum(current, 0.0),
            np.empty((protocol_kernels.ROW, rows)))  # fmt: skip


@njit
def leaky_rows(values, out):
    for k in range(values.size):
        pair = np.full(2 + k % 3, values[k])
        out[k] = pair.sum()


def leaky_call(rows):
    return leaky_rows, np.ones(rows), np.empty(rows)


@pytest.mark.parametrize(
    "call", [ekf_call, ukf_call, adaptive_call, simulate_call, coulomb_call, profile_call]
)
def test_nothing_is_allocated_per_row(allocations, call):
    assert allocations(call, 100) == allocations(call, 100_000)


def test_the_count_would_see_an_allocation(allocations):
    few, many = allocations(leaky_call, 100), allocations(leaky_call, 100_000)
    assert many[0] - few[0] >= 99_900
