"""What a log has shown of a cell: resistances that differ from the model's, by the current."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.equations import advance, empty_state
from cellwise.cell.simulate import simulate
from cellwise.estimate.power.load_kernels import (
    AS_MODEL,
    correction_variance,
    fast_factor,
)
from cellwise.estimate.power.power_along_log import CorrectionMemory, no_memory, remembered
from cellwise.estimate.sensing_kernels import MeasuredSample
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell

MODEL = curved_cell()
TABLES = MODEL.parameters()


def load(seed: int = 2, rows: int = 3000) -> np.ndarray:
    """Loads of random size, 20 seconds each."""
    return np.repeat(np.random.default_rng(seed).uniform(-2.0, 6.0, rows // 20), 20)


def followed(current_A: np.ndarray, voltage_V: np.ndarray) -> CorrectionMemory:
    """The memory after a log, beside the model's own states."""
    state, memory = empty_state(0.8), no_memory()
    for k, (current, voltage) in enumerate(zip(current_A, voltage_V, strict=True)):
        dt_s = 1.0 if k else 0.0
        state, _ = advance(TABLES, state, current, dt_s, 25.0)
        reading = MeasuredSample(current, voltage, 25.0, dt_s, False)
        memory = remembered(TABLES, memory, state, reading, current, 0)
    return memory


@pytest.mark.parametrize("factor", [1.0, 1.2, 0.9])
def test_a_cell_of_other_resistances_is_found(factor):
    current = load()
    cell = replace(
        MODEL, r0_ohm=factor * MODEL.r0_ohm, r1_ohm=factor * MODEL.r1_ohm,
        r2_ohm=factor * MODEL.r2_ohm,
    )  # fmt: skip
    log = CellLog(np.arange(float(current.size)), current, np.full(current.size, 3.7))
    noise = np.random.default_rng(3).normal(0.0, 0.001, current.size)
    but = followed(current, simulate(cell, log, 0.8).voltage_V + noise).but
    for current_A in (1.0, 3.0, 6.0):
        assert fast_factor(TABLES.cell, but, current_A) == pytest.approx(factor, abs=0.02)
    assert but.tail == pytest.approx(factor - 1.0, abs=0.05)


def test_what_was_never_seen_corrects_nothing_and_widens_nothing():
    """A rest, and voltages that a sensor did not give, show no resistance."""
    rest = followed(np.zeros(400), np.full(400, 3.9))
    blind = followed(load(), np.full(load().size, np.nan))
    for but in (rest.but, blind.but):
        assert but.spread == AS_MODEL.spread
        assert (but.common, but.falling, but.tail) == (0.0, 0.0, 0.0)


def test_a_size_of_current_that_was_not_seen_is_less_sure():
    """Learned at C/4, asked at 6C: nobody knows how much of it falls with the current."""
    small = 0.25 * MODEL.capacity_Ah * np.sign(load())
    state, point = advance(TABLES, empty_state(0.8), 1.0, 10.0, 25.0)
    log = CellLog(np.arange(float(small.size)), small, np.full(small.size, 3.7))
    but = followed(small, simulate(MODEL, log, 0.8).voltage_V).but

    def share(current_A: float) -> float:
        drop_V = point.r0_ohm * current_A
        at = state._replace(v1_V=0.0, v2_V=0.0)
        return float(np.sqrt(correction_variance(TABLES.cell, but, point, at, current_A))) / drop_V

    assert share(6.0 * MODEL.capacity_Ah) > 2.0 * share(0.25 * MODEL.capacity_Ah)
