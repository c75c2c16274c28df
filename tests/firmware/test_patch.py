"""A patch for one cell in the field: what the C refuses, and the same steps in Python."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import TemperatureDependence
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.layout import INPUT
from cellwise.estimate.fixed.stepper import numba_stepper
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.estimate.status import VOLTAGE_FROZEN
from cellwise.export.firmware import HostLibrary
from cellwise.export.patch import BLOCK, Patch, patch_between, patch_of, patched_rows, taken
from cellwise.logs import CellLog
from example_cells import curved_cell
from firmware_cases import compile_and_run
from random_loads import random_load

HEAD = """
#include <math.h>
#include <stdio.h>
#include <string.h>
#include "cellwise_cell.h"
#include "cellwise_store.c"
#define CHECK(c) do { if (!(c)) { printf("line %d: %s\\n", __LINE__, #c); return 1; } } while (0)
static uint32_t take(cellwise_patch *taken, const cellwise_patch *from)
{
    return cellwise_take_patch(&cellwise_cell, taken, from);
}
static void step(cellwise_state *x, const cellwise_patch *taken, float soc_of)
{
    cellwise_input in = {soc_of, 3.7f, 12.0f, x->sequence + 1u};
    cellwise_output out;
    cellwise_patch_sample(taken, x, 1u, &in);
    (void)cellwise_step(&cellwise_cell, x, &in, &out);
}
int main(int argc, char **argv)
{
    cellwise_patch block[4], taken, before, other;
    cellwise_state x, y;
    FILE *const file = fopen(argv[argc - 1], "rb");
    CHECK(fread(block, sizeof block[0], 4u, file) == 4u);
    (void)fclose(file);
    (void)cellwise_init(&cellwise_cell, &x, 0.6f, 0.0025f);
    memcpy(&y, &x, sizeof x);
    cellwise_no_patch(&taken);
    before = taken;
    other = taken;
    step(&x, &taken, 1.0f);
    step(&y, &taken, 1.0f);
"""
TAIL = "    return (before.magic == other.magic) ? 0 : 1;\n}\n"
# First and second generation, of other tables, and the third, intact but for what it says.
REFUSED = """
    unsigned char *const at = (unsigned char *)&other;
    memcpy(&before, &taken, sizeof taken);
    for (uint32_t k = 0u; k < 8u * sizeof other; k++) {
        other = block[0];
        at[k / 8u] = (unsigned char)(at[k / 8u] ^ (1u << (k % 8u)));
        CHECK(take(&taken, &other) != 0u);
    }
    CHECK(take(&taken, &block[2]) == CELLWISE_OTHER_MODEL);
    const float bad[4] = {NAN, INFINITY, -1e9f, 1e9f};
    for (uint32_t k = 0u; k < 4u; k++) {
        for (uint32_t at_byte = 16u; at_byte < sizeof other - 4u; at_byte += 4u) {
            other = block[3];
            (void)memcpy(&at[at_byte], &bad[k], 4u);
            other.crc = crc_of_patch(&other);
            CHECK(take(&taken, &other) == CELLWISE_BEYOND_BOUNDS);
        }
    }
    CHECK(memcmp(&taken, &before, sizeof taken) == 0);
    other = block[0];
    other.layout = 1u;
    CHECK(take(&taken, &other) == CELLWISE_OTHER_LAYOUT);
    step(&x, &taken, 2.0f);
    step(&y, &taken, 2.0f);
    CHECK(memcmp(&x, &y, sizeof x) == 0);
"""
UNDONE = """
    CHECK(take(&taken, &block[1]) == 0u);
    CHECK(take(&taken, &block[1]) == 0u);
    CHECK(take(&taken, &block[0]) == CELLWISE_OLD_PATCH);
    cellwise_state patched = x;
    step(&patched, &taken, 2.0f);
    CHECK((patched.per_capacity > 1.2f) && (patched.resistance_scale > 1.4f));
    /* One that was reset, or restored as it was before the patch, has it with its next sample. */
    cellwise_state again = x;
    step(&again, &taken, 2.0f);
    CHECK(memcmp(&again, &patched, sizeof x) == 0);
    cellwise_undo_patch(&taken);
    CHECK(taken.generation == 2u);
    step(&x, &taken, 2.0f);
    step(&y, &before, 2.0f);
    CHECK(memcmp(&x, &y, sizeof x) == 0);
    step(&patched, &taken, 2.0f);
    CHECK(!(patched.per_capacity > 1.0f) && !(patched.resistance_scale > 1.0f));
    CHECK(take(&taken, &block[1]) == CELLWISE_OLD_PATCH);
    CHECK(take(&taken, &block[3]) == 0u);
    /* New tables in flash: what was taken of the old ones does nothing. */
    taken.model_crc = taken.model_crc + 1u;
    step(&x, &taken, 2.0f);
    step(&y, &before, 2.0f);
    CHECK(memcmp(&x, &y, sizeof x) == 0);
    /* Memory that lost its content leaves a sound state. */
    (void)memset(&taken, 0xFF, sizeof taken);
    taken.model_crc = before.model_crc;
    step(&x, &taken, 2.0f);
    CHECK((x.resistance_scale >= 0.1f) && (x.per_capacity <= 10.0f) && (x.soc >= 0.0f));
"""
RISING = np.linspace(0.9, 1.6, 5)
PATCHES = (
    Patch(1, 0.9, (RISING[::-1], RISING), (5.0, 30.0), np.linspace(-0.02, 0.03, 9), 0.05, 1.04),
    Patch(2, 0.8, ((1.5,) * 5,) * 2, offset_A=-0.1, gain=0.97),
    Patch(3, 0.8, ((1.5,) * 5,) * 2),
)


def warm_cell():
    return curved_cell().with_effect(TemperatureDependence(2000.0))


@pytest.fixture(scope="module")
def tables():
    return fixed_step_tables(warm_cell(), 1.0, wide=False, health=True)


def ran(tables, folder, program):
    """What a program prints that has read four blocks."""
    other = fixed_step_tables(warm_cell(), 2.0, wide=False, health=True)
    first, second, third = (p.block(tables) for p in PATCHES)
    path = folder / "blocks"
    path.write_bytes(first + second + PATCHES[0].block(other) + third)
    run = (str(path),)
    return compile_and_run(tables, folder, HEAD + program + TAIL, flags=("-O1",), run=run)


needs_c = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")


@needs_c
@pytest.mark.parametrize("program", [REFUSED, UNDONE], ids=["refused", "undone"])
def test_a_patch_is_whole_newer_possible_and_of_these_tables_or_changes_nothing(
    tables, tmp_path, program
):
    """CW-020."""
    ran(tables, tmp_path, program)


def samples(count):
    """A load over all of the SOC at temperatures beyond both rows, a gap, a voltage missing."""
    rng = np.random.default_rng(4)
    found = np.zeros(count, dtype=INPUT)
    found["current_A"] = 3.0 + rng.normal(0.0, 2.0, count)
    found["voltage_V"] = 3.6 + rng.normal(0.0, 0.05, count)
    found["voltage_V"][::97] = np.nan
    found["temperature_C"] = np.linspace(-10.0, 45.0, count)
    found["sequence"] = np.arange(count) + 200 * (np.arange(count) > count // 2)
    return found


@needs_c
@pytest.mark.parametrize("wide", [False, True], ids=["lean", "a bank that is open"])
@pytest.mark.parametrize("cell", [curved_cell, warm_cell], ids=["one temperature", "all"])
def test_python_steps_with_a_patch_as_the_c_does(cell, wide):
    made = fixed_step_tables(cell(), 1.0, wide=wide, health=True)
    block, seen = PATCHES[0].block(made), samples(1500)
    found = []
    for stepper in (numba_stepper(made), HostLibrary(made)):
        memory = stepper.start_filter(9, 0.6, 0.3)
        out = patched_rows(stepper, taken(block, made), memory, seen)
        found.append((out.tobytes(), memory.states.tobytes()))
    assert found[0] == found[1]
    plain = numba_stepper(made)
    unpatched = plain.filter_rows(plain.start_filter(9, 0.6, 0.3), seen)
    assert unpatched.tobytes() != found[0][0]


def test_a_patch_takes_at_most_128_bytes_and_what_it_cannot_hold_is_said(tables):
    assert BLOCK.itemsize <= 128
    with pytest.raises(InputError, match="capacity_share"):
        Patch(1, capacity_share=float("nan"))
    with pytest.raises(InputError, match="shift_V"):
        Patch(1, shift_V=(0.3,) * 9)
    with pytest.raises(InputError, match="resistance"):
        Patch(1, resistance=(1.0, 1.2))
    with pytest.raises(InputError, match="1 K apart"):
        Patch(1, temperature_C=(20.0, 20.0))
    with pytest.raises(InputError, match="offset_A"):
        Patch(1, offset_A=1e3).block(tables)


def test_a_block_is_read_as_a_target_takes_it_and_another_version_is_said(tables):
    block = PATCHES[0].block(tables)
    assert taken(block, tables)["per_capacity"][0] == np.float32(1.0 / 0.9)
    version_1 = block[:4] + (1).to_bytes(4, "little") + block[8:36]
    with pytest.raises(InputError, match="version 1"):
        taken(version_1, tables)
    for damaged in (block[:-1], block[:60] + b"\1" + block[61:]):
        with pytest.raises(InputError, match="damaged"):
            taken(damaged, tables)
    with pytest.raises(InputError, match="no patch"):
        taken(b"", tables)
    with pytest.raises(InputError, match="other tables"):
        taken(block, fixed_step_tables(warm_cell(), 2.0, wide=False, health=True))


def aged_cell():
    """A tenth of the capacity less, half as much more resistance towards empty, another OCV."""
    cell = curved_cell()
    grown = 1.5 - 0.5 * cell.soc
    tables = {n: getattr(cell, n) * grown for n in ("r0_ohm", "r1_ohm", "r2_ohm")}
    ocv_V = cell.ocv_V + 0.02 * np.sin(np.pi * cell.soc)
    return replace(cell, capacity_Ah=0.9 * cell.capacity_Ah, ocv_V=ocv_V, **tables)


def test_what_a_new_model_says_becomes_a_patch_of_the_old_one():
    """Against the shares that the cell was made with, and a target with the cell's own tables."""
    old, new = curved_cell(), aged_cell()
    patch = patch_between(old, new, 3, (25.0, 25.0), offset_A=0.05, gain=1.04, offset_V=0.005)
    assert patch.capacity_share == pytest.approx(0.9)
    np.testing.assert_allclose(patch.resistance[0], 1.5 - 0.5 * np.linspace(0.0, 1.0, 5), rtol=1e-3)
    expected_V = 0.005 + 0.02 * np.sin(np.pi * np.linspace(0.0, 1.0, 9))
    np.testing.assert_allclose(patch.shift_V, expected_V, atol=2e-4)

    rng = np.random.default_rng(2)
    load = random_load(
        rng, 3.0, 0.95, rows=4000, rate_hz=1.0, charge=True, temperature_C=(24.0, 26.0)
    )
    log = CellLog(load.time_s, load.current_A, np.full(load.time_s.size, 3.7), load.temperature_C)
    truth = simulate(new, log, 0.95)
    records = samples_of(new, replace(log, voltage_V=truth.voltage_V), 1.0).records
    read = records.copy()
    read["current_A"] = 1.04 * records["current_A"] + 0.05
    read["voltage_V"] += 0.005
    error = {}
    for name, cell, seen in (("old", old, read), ("patched", old, read), ("new", new, records)):
        made = fixed_step_tables(cell, 1.0, health=True)
        stepper = numba_stepper(made)
        memory = stepper.start_filter(9, 0.9, 0.1)
        if name == "patched":
            out = patched_rows(stepper, taken(patch.block(made), made), memory, seen)
        else:
            out = stepper.filter_rows(memory, seen)
        error[name] = float(np.sqrt(np.mean((out["soc"] - truth.soc)[600:] ** 2)))
    assert error["patched"] < error["new"] + 0.003 < error["old"]


def test_causes_of_a_diagnosis_become_a_patch_and_what_it_cannot_hold_is_said():
    old, new = curved_cell(), aged_cell()
    causes = {"capacity": {}, "ocv_shift": {}, "current_gain": {"gain": 1.04}}
    patch = patch_of(causes, old, 7, new, (10.0, 30.0))
    assert (patch.generation, patch.gain, patch.temperature_C) == (7, 1.04, (10.0, 30.0))
    assert patch.capacity_share == pytest.approx(0.9)
    for causes in ({"hysteresis": {"m_V": 0.03}}, {"initial_soc": {"soc0": 0.4}}, {}):
        with pytest.raises(InputError, match=next(iter(causes), "no cause")):
            patch_of(causes, old, 1, new, (10.0, 30.0))


def test_parameters_alone_become_a_patch_too():
    """What a diagnosis by a few hundred bytes has: no model, only numbers."""
    cell = curved_cell()
    shift_V = np.linspace(-0.01, 0.02, 9)
    causes = {
        "capacity": {"capacity_Ah": 0.8 * cell.capacity_Ah},
        "resistance_scale": {"scale": 1.3},
        "ocv_shift": {f"shift_{125 * k:04d}_V": v for k, v in enumerate(shift_V)},
        "voltage_offset": {"offset_V": 0.004},
    }
    patch = patch_of(causes, cell, 2)
    assert patch.capacity_share == pytest.approx(0.8)
    np.testing.assert_array_equal(patch.resistance, 1.3)
    np.testing.assert_allclose(patch.shift_V, shift_V + 0.004)
    with pytest.raises(InputError, match="lithium_inventory"):
        patch_of({"lithium_inventory": {"lithium_loss": 0.1}}, cell, 2)


def test_a_frozen_voltage_is_found_beside_a_shift_that_moves_with_the_soc():
    """What is taken off a voltage that stands still moves with the SOC: less than last digits."""
    cell = curved_cell()
    made = fixed_step_tables(cell, 1.0, health=True)
    seen = samples(1500)
    seen["sequence"] = np.arange(seen.size)
    seen["voltage_V"] = 3.7 - 0.03 * seen["current_A"]
    seen["voltage_V"][700:1200] = seen["voltage_V"][700]
    steep = Patch(1, shift_V=np.linspace(-0.1, 0.1, 9))
    stepper = numba_stepper(made)
    plain = stepper.filter_rows(stepper.start_filter(9, 0.6, 0.1), seen)
    memory = stepper.start_filter(9, 0.6, 0.1)
    patched = patched_rows(stepper, taken(steep.block(made), made), memory, seen)
    found = [(out["status"] & VOLTAGE_FROZEN != 0)[700:1200].mean() for out in (plain, patched)]
    assert found[0] > 0.9
    assert found[1] > 0.9 * found[0]
