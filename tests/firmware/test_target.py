"""The C on emulated processors: the bytes that numba gives, within the room there is."""

from __future__ import annotations

import os

import numpy as np
import pytest

from cellwise.data import load_dataset
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.layout import CELL, state_type
from cellwise.estimate.fixed.stepper import numba_stepper
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.export.accuracy import worst_case
from cellwise.export.cross import CORES, has_tools, run_on_target
from cellwise.logs.cell_log import resample
from example_cells import curved_cell
from firmware_cases import stress_samples, tables_of
from virtual_tester import logged

pytestmark = pytest.mark.skipif(not has_tools("cortex-m4f"), reason="no cross tools: make firmware")
# CELLWISE_FIRMWARE_STEPS=1000000 for the long comparison.
ROWS = int(os.environ.get("CELLWISE_FIRMWARE_STEPS", "20000"))


def drive_samples(rows=ROWS):
    records = samples_of(curved_cell(), load_dataset("nmc_drive_b"), 1.0).records
    records = np.tile(records, -(-rows // records.size))[:rows].copy()
    records["sequence"] = np.arange(rows)
    return records


def expected(tables, samples):
    stepper = numba_stepper(tables)
    state = np.zeros(1, dtype=state_type(tables.options))
    stepper.begin(state, 0.9, 0.01)
    return stepper.rows(state, samples), state


@pytest.mark.slow
@pytest.mark.parametrize("core", CORES)
@pytest.mark.parametrize("case", ["lean", "full"])
def test_the_same_bytes_on_a_drive_and_under_stress(core, case):
    if not has_tools(core):
        pytest.skip(f"no compiler or emulator for {core}: make firmware")
    tables = tables_of(case)
    for samples in (drive_samples(), stress_samples(10_000)):
        outputs, state = expected(tables, samples)
        run = run_on_target(tables, core, samples, 0.9, 0.01)
        assert run.outputs.tobytes() == outputs.tobytes()
        assert run.state.tobytes() == state.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("core", "instructions", "text", "stack"),
    [("cortex-m4f", 520, 2200, 96), ("cortex-m0plus", 15_500, 2800, 224)],
)
def test_three_states_stay_within_the_room_there_is(core, instructions, text, stack):
    run = run_on_target(tables_of("lean"), core, drive_samples(5000), 0.9, 1e-4, measure_every=10)
    assert run.cost.measured == 500
    assert 100 < run.cost.instructions_mean <= run.cost.instructions_most <= instructions
    assert 1000 < run.cost.text_bytes <= text
    assert 0 < run.cost.stack_bytes <= stack
    assert run.cost.state_bytes <= 64
    assert run.cost.ram_bytes == 0


@pytest.mark.slow
@pytest.mark.parametrize(("core", "instructions"), [("cortex-m0plus", 100_000)])
def test_an_open_bank_stays_within_the_bound_of_instructions(core, instructions):
    """One of its components follows with a sample, never all of them."""
    run = run_on_target(
        tables_of("plain"), core, drive_samples(300), 0.6, 0.0225, measure_every=1, of="bank"
    ).cost
    assert run.measured == 300
    assert 5_000 < run.instructions_mean <= run.instructions_most <= instructions


@pytest.mark.slow
@pytest.mark.parametrize(
    ("core", "instructions"),
    [
        ("cortex-m4f", 520),
        pytest.param(
            "cortex-m0plus", 17_000,
            marks=pytest.mark.xfail(strict=True, reason="17,073: what the capacity leaves open"),
        ),
    ],
)  # fmt: skip
def test_stress_samples_stay_within_the_bound_of_instructions(core, instructions):
    run = run_on_target(
        tables_of("lean"), core, stress_samples(4000), 0.9, 1e-2, measure_every=1
    ).cost
    assert run.measured == 4000
    assert run.instructions_most <= instructions
    assert worst_case(curved_cell(), tables_of("lean"), core).stress <= instructions


@pytest.mark.slow
@pytest.mark.parametrize("wide", [False, True], ids=["lean", "plain"])
def test_capacity_and_resistance_cost_at_most_15_percent_of_a_step(wide):
    tables = fixed_step_tables(curved_cell(), 1.0, wide=wide, soh=True)
    step, beside = (
        run_on_target(
            tables, "cortex-m4f", drive_samples(5000), 0.9, 1e-4, measure_every=10, of=of
        ).cost
        for of in ("step", "soh")
    )
    assert 20 < beside.instructions_mean <= 0.15 * step.instructions_mean


def pack_voltages(samples, cells):
    """What the program on the target makes of a sample: offsets of -6..6 times 2**-10 V."""
    steps = (7 * np.arange(cells)) % 13 - 6
    off = steps.astype(np.float32) * np.float32(2.0**-10)
    return samples["voltage_V"][:, None] + off


@pytest.mark.slow
@pytest.mark.parametrize("core", CORES)
def test_a_pack_gives_the_same_bytes_within_the_room_there_is(core):
    """96 cells at 1 Hz: at most 12,000 instructions a sample in the mean on a Cortex-M4F."""
    if not has_tools(core):
        pytest.skip(f"no compiler or emulator for {core}: make firmware")
    model = curved_cell()
    log = resample(load_dataset("nmc_drive_b"), 1.0)
    log = logged(model, log, 0.95)
    samples = samples_of(model, log, 1.0).records[2000:3200].copy()
    tables = tables_of("lean pack")
    run = run_on_target(tables, core, samples, 0.8, 0.09, cells=96)
    stepper = numba_stepper(tables)
    state, cells = np.zeros(1, dtype=state_type(tables.options)), np.zeros(96, dtype=CELL)
    stepper.begin(state, 0.8, 0.09)
    stepper.call("start_cells", cells, cells.size)
    outputs = stepper.pack_rows(state, cells, samples.copy(), pack_voltages(samples, 96))
    assert state["cells_at"][0] == samples["sequence"][-1]
    assert run.outputs.tobytes() == outputs.tobytes()
    assert run.state.tobytes() == state.tobytes()
    assert run.cells.tobytes() == cells.tobytes()
    assert run.cost.ram_bytes == 0
    # What is measured is repeated, and the cells use each repetition: not for the bytes.
    cost = run_on_target(tables, core, samples, 0.8, 0.09, cells=96, measure_every=25).cost
    assert cost.measured == 48
    if core == "cortex-m4f":
        assert 1000 < cost.instructions_mean <= 12_000
        assert cost.instructions_most <= 12_000


@pytest.mark.slow
def test_a_lock_out_costs_no_more_than_another_step():
    """No step searches over the SOC: that is left to a bank's components."""
    lean, full = (
        worst_case(curved_cell(), tables_of(case), "cortex-m4f") for case in ("lean", "plain")
    )
    assert lean.reset is not None
    assert full.reset is not None
    assert full.reset <= full.stress
    assert lean.reset <= lean.stress
