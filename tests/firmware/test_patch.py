"""A patch for one cell in the field: what the C refuses, and the same steps in Python."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.export.patch import BLOCK, Patch, patch_of
from example_cells import curved_cell
from firmware_cases import compile_and_run

HEAD = """
#include <math.h>
#include <stdio.h>
#include <string.h>
#include "cellwise_cell.h"
#include "cellwise_store.c"
#define CHECK(c) do { if (!(c)) { printf("line %d: %s\\n", __LINE__, #c); return 1; } } while (0)
static uint32_t take(cellwise_state *x, cellwise_patch *taken, const cellwise_patch *from)
{
    return cellwise_take_patch(&cellwise_cell, x, taken, from);
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
"""
TAIL = "    return (before.magic == other.magic) ? 0 : 1;\n}\n"
# First and second generation, of other tables, and the third, intact but for what it says.
REFUSED = """
    unsigned char *const at = (unsigned char *)&other;
    memcpy(&before, &taken, sizeof taken);
    for (uint32_t k = 0u; k < 8u * sizeof other; k++) {
        other = block[0];
        at[k / 8u] = (unsigned char)(at[k / 8u] ^ (1u << (k % 8u)));
        CHECK(take(&x, &taken, &other) != 0u);
    }
    CHECK(take(&x, &taken, &block[2]) == CELLWISE_OTHER_MODEL);
    const float bad[4] = {NAN, INFINITY, -1e9f, 1e9f};
    for (uint32_t k = 0u; k < 4u; k++) {
        for (uint32_t field = 0u; field < 4u; field++) {
            other = block[3];
            (void)memcpy(&at[16u + 4u * field], &bad[k], 4u);
            other.crc = crc_of_patch(&other);
            CHECK(take(&x, &taken, &other) == CELLWISE_BEYOND_BOUNDS);
        }
    }
    CHECK((memcmp(&x, &y, sizeof x) == 0) && (memcmp(&taken, &before, sizeof taken) == 0));
"""
UNDONE = """
    CHECK(take(&x, &taken, &block[1]) == 0u);
    CHECK(take(&x, &taken, &block[0]) == CELLWISE_OLD_PATCH);
    const cellwise_state patched = x;
    (void)cellwise_init(&cellwise_cell, &x, 0.6f, 0.0025f);
    CHECK(take(&x, &taken, &taken) == 0u);
    CHECK((memcmp(&x, &patched, sizeof x) == 0) && (memcmp(&x, &y, sizeof x) != 0));
    CHECK(cellwise_undo_patch(&cellwise_cell, &x, &taken) == 0u);
    CHECK((memcmp(&x, &y, sizeof x) == 0) && (taken.generation == 2u));
    const float same_A = cellwise_patched_current(&taken, 1.3f);
    CHECK(!(same_A < 1.3f) && !(same_A > 1.3f));
    CHECK(take(&x, &taken, &block[1]) == CELLWISE_OLD_PATCH);
    CHECK(take(&x, &taken, &block[3]) == 0u);
"""
STEPPED = """
    CHECK(take(&x, &taken, &block[0]) == 0u);
    for (uint32_t k = 0u; k < 200u; k++) {
        cellwise_input in = {0.0f, 3.7f, 25.0f, 0u};
        cellwise_output out;
        in.current_A = cellwise_patched_current(&taken, (float)k * 0.03f);
        in.sequence = k;
        (void)cellwise_step(&cellwise_cell, &x, &in, &out);
        printf("%a %a\\n", (double)out.soc, (double)out.soc_variance);
    }
"""
PATCHES = (
    Patch(1, 0.9, 1.3, 0.05, 1.04),
    Patch(2, 0.8, 1.5, -0.1, 0.97),
    Patch(3, 0.8, 1.5),
)


@pytest.fixture(scope="module")
def tables():
    return fixed_step_tables(curved_cell(), 1.0, wide=False, health=True)


def ran(tables, folder, program):
    """What a program prints that has read four blocks."""
    other = fixed_step_tables(curved_cell(), 2.0, wide=False, health=True)
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


@needs_c
def test_python_steps_with_a_patch_as_the_c_does(tables, tmp_path):
    printed = [line.split() for line in ran(tables, tmp_path, STEPPED).splitlines()]
    fixed = FixedStep(curved_cell(), dt_s=1.0, wide=False, health=True)
    state = fixed.init(0.6, 0.05)
    PATCHES[0].take(fixed, state)
    current_A = PATCHES[0].corrected_A(np.arange(200, dtype=np.float32) * np.float32(0.03))
    for k, (soc, variance) in enumerate(printed):
        fixed.step(state, current_A[k], 3.7, 25.0, sequence=k)
        ours = float(state["soc"][0]), float(state["ss"][0])
        assert ours == (float.fromhex(soc), float.fromhex(variance)), k


def test_a_patch_takes_at_most_128_bytes_and_what_it_cannot_hold_is_said(tables):
    assert BLOCK.itemsize <= 128
    with pytest.raises(InputError, match="capacity_share"):
        Patch(1, capacity_share=float("nan"))
    with pytest.raises(InputError, match="offset_A"):
        Patch(1, offset_A=1e3).block(tables)
    with pytest.raises(InputError, match="hysteresis"):
        patch_of({"hysteresis": {"m_V": 0.03}}, curved_cell(), 1)


def test_causes_of_a_diagnosis_become_a_patch_that_takes_them_out():
    cell = curved_cell()
    causes = {"capacity": {"capacity_Ah": 0.9 * cell.capacity_Ah}, "current_gain": {"gain": 1.04}}
    patch = patch_of({**causes, "current_offset": {"offset_A": 0.05}}, cell, 7)
    flowing = np.linspace(-3.0, 5.0, 9)
    assert patch.capacity_share == pytest.approx(0.9)
    assert patch.corrected_A(1.04 * flowing + 0.05) == pytest.approx(flowing, abs=1e-5)
