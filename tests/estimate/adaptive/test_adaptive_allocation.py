"""The adaptive row loop allocates nothing: 100 rows and 50,000 leave the same count."""

from __future__ import annotations

import gc

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from cellwise.estimate.adaptive import step_kernels as kernel
from cellwise.estimate.adaptive.adaptive import Adaptive
from cellwise.estimate.filters.filter_state import LogArrays
from example_cells import EFFECTS, curved_cell

ADAPTIVE = Adaptive(curved_cell(effects=EFFECTS))


def call(rows):
    rng = np.random.default_rng(1)
    voltage = rng.normal(3.7, 0.1, rows)
    voltage[::7] = np.nan
    held, status = np.empty((3, rows), np.int32), np.empty(rows, np.int32)
    log = LogArrays(
        rng.normal(0, 3, rows), voltage, np.full(rows, 25.0), np.full(rows, 0.1),
        np.zeros(rows, np.bool_),
    )  # fmt: skip
    kernel_arguments = (
        ADAPTIVE.model.parameters(), ADAPTIVE._noise, ADAPTIVE._rules, ADAPTIVE._unknown,
        ADAPTIVE.init(0.5), log, np.empty((kernel.OUTPUTS, rows)), status, held,
    )  # fmt: skip
    gc.disable()  # what others left behind stays out of the count
    try:
        before = rtsys.get_allocation_stats()
        kernel.adaptive_rows(*kernel_arguments)
        after = rtsys.get_allocation_stats()
    finally:
        gc.enable()
    return after.alloc - before.alloc, after.mi_alloc - before.mi_alloc


@pytest.fixture
def counted():
    enabled = _nrt_python.memsys_stats_enabled()
    _nrt_python.memsys_enable_stats()
    yield
    if not enabled:
        _nrt_python.memsys_disable_stats()


def test_nothing_is_allocated_per_row(counted):
    call(100)  # compiled before anybody counts
    assert call(100) == call(50_000)
