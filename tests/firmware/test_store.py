"""What is kept over a switch-off, and tables that are checked in pieces: the exported C."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from cellwise.estimate.fixed.options import CellSettings
from cellwise.estimate.fixed.stepper import numba_stepper
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.estimate.noise import noise_for
from cellwise.export.firmware import HostLibrary
from example_cells import curved_cell
from firmware_cases import compile_and_run, noisy_samples, tables_of

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")

OTHER_MODEL = 4  # CELLWISE_OTHER_MODEL
# With the static functions of the store in reach.
HEAD = """
#include <stdio.h>
#include <string.h>
#include "cellwise_cell.h"
#include "cellwise_store.c"
#define CHECK(c) do { if (!(c)) { printf("line %d: %s\\n", __LINE__, #c); return 1; } } while (0)
static cellwise_input sample(uint32_t k, float current_A)
{
    cellwise_input in = {0.0f, 3.7f, 25.0f, 0u};
    in.current_A = current_A;
    in.sequence = k;
    return in;
}
static void drive(cellwise_state *x, uint32_t steps)
{
    cellwise_output out;
    (void)cellwise_init(&cellwise_cell, x, 0.6f, 0.0025f);
    for (uint32_t k = 0u; k < steps; k++) {
        const cellwise_input in = sample(k, 2.0f);
        (void)cellwise_step(&cellwise_cell, x, &in, &out);
    }
}
int main(int argc, char **argv)
{
    (void)argc;
    (void)argv;
    cellwise_state x;
    drive(&x, 50u);
"""
TAIL = "    return 0;\n}\n"


def ran(tables, folder, program, run=()):
    """Compile and run a program on the store of these tables: what it prints."""
    return compile_and_run(tables, folder, HEAD + program + TAIL, flags=("-O1",), run=run)


FLIPPED = """
    cellwise_stored kept, none;
    cellwise_state y, before;
    unsigned char *const at = (unsigned char *)&kept;
    memset(&none, 0xFF, sizeof none);
    memset(&y, 0, sizeof y);
    CHECK(cellwise_restore(&cellwise_cell, &y, &none, 0u) == CELLWISE_NOT_STORED);
    cellwise_keep(&kept, &x, &none);
    for (uint32_t k = 0u; k < 8u * sizeof kept; k++) {
        before = y;
        at[k / 8u] = (unsigned char)(at[k / 8u] ^ (1u << (k % 8u)));
        CHECK(cellwise_restore(&cellwise_cell, &y, &kept, 0u) != 0u);
        CHECK(!is_usable(&kept) && (memcmp(&before, &y, sizeof y) == 0));
        at[k / 8u] = (unsigned char)(at[k / 8u] ^ (1u << (k % 8u)));
    }
    CHECK(cellwise_restore(&cellwise_cell, &y, &kept, 0u) == 0u);
    x.sequence = y.sequence;
    CHECK(memcmp(&x, &y, sizeof x) == 0);
"""


@pytest.mark.parametrize("case", ["lean", "full"])
def test_a_flipped_bit_of_what_is_kept_is_noticed(case, tmp_path):
    """CW-011."""
    ran(tables_of(case), tmp_path, FLIPPED)


CUT = """
    static const unsigned char erased[2] = {0x00u, 0xFFu};
    cellwise_stored slot[2], old, next;
    cellwise_state y;
    cellwise_state later = x;
    later.soc = 0.25f;
    for (uint32_t way = 0u; way < 3u; way++) { /* over what was there, zeros, erased flash */
        for (uint32_t turn = 0u; turn < 2u; turn++) {
            memset(slot, 0xFF, sizeof slot);
            for (uint32_t k = 0u; k < 2u + turn; k++) { /* the newest one in either slot */
                const uint32_t to = 1u - cellwise_newest_slot(&slot[0], &slot[1]);
                x.soc = 0.5f + 0.01f * (float)k;
                cellwise_keep(&slot[to], &x, &slot[1u - to]);
            }
            const uint32_t newest = cellwise_newest_slot(&slot[0], &slot[1]);
            CHECK(newest == (turn == 0u ? 0u : 1u));
            old = slot[1u - newest];
            CHECK(old.head.generation + 1u == slot[newest].head.generation);
            cellwise_keep(&next, &later, &slot[newest]);
            for (uint32_t cut = 0u; cut <= sizeof next; cut++) {
                cellwise_stored *const into = &slot[1u - newest];
                *into = old;
                if (way != 0u) {
                    memset(into, erased[way - 1u], sizeof *into);
                }
                memcpy(into, &next, cut);
                const bool whole = memcmp(into, &next, sizeof next) == 0;
                const uint32_t found = cellwise_newest_slot(&slot[0], &slot[1]);
                CHECK(whole == (cut == sizeof next) || cut + 4u > sizeof next);
                CHECK(found == (whole ? 1u - newest : newest));
                CHECK(cellwise_restore(&cellwise_cell, &y, &slot[found], 0u) == 0u);
                const float soc = whole ? later.soc : x.soc;
                CHECK(!(y.soc < soc) && !(y.soc > soc));
            }
        }
    }
"""


@pytest.mark.parametrize("case", ["lean", "full"])
def test_a_loss_of_power_at_any_byte_leaves_the_older_slot(case, tmp_path):
    """CW-012."""
    ran(tables_of(case), tmp_path, CUT)


WRAP = """
    cellwise_stored slot[2];
    memset(slot, 0, sizeof slot);
    cellwise_keep(&slot[0], &x, &slot[1]);
    slot[0].head.generation = 0xFFFFFFFFu;
    slot[0].head.crc = crc_of_head(&slot[0].head);
    slot[0].crc = crc_of_state(&slot[0]);
    cellwise_keep(&slot[1], &x, &slot[0]);
    CHECK(slot[1].head.generation == 0u);
    CHECK(cellwise_newest_slot(&slot[0], &slot[1]) == 1u);
    CHECK(cellwise_newest_slot(&slot[1], &slot[0]) == 0u);
"""


def test_the_newest_slot_is_found_where_generations_wrap(tmp_path):
    """CW-012."""
    ran(tables_of("lean"), tmp_path, WRAP)


AGE = """
    static const uint32_t ages[] = {0u, 1u, 4u, 3600u, 86400u, CELLWISE_AGE_UNKNOWN};
    cellwise_stored kept, none;
    memset(&none, 0, sizeof none);
    cellwise_keep(&kept, &x, &none);
    for (uint32_t k = 0u; k < sizeof ages / sizeof ages[0]; k++) {
        cellwise_state on = x;
        cellwise_state y;
        cellwise_output out, expected;
        const uint32_t steps = steps_of(ages[k]);
        const cellwise_input in = sample(on.sequence + 1u + steps, 0.5f);
        const cellwise_input again = sample(0u, 0.5f);
        const uint32_t status = cellwise_step(&cellwise_cell, &on, &in, &expected);
        CHECK(cellwise_restore(&cellwise_cell, &y, &kept, ages[k]) == 0u);
        (void)cellwise_step(&cellwise_cell, &y, &again, &out);
        if (CELLWISE_WIDE != 0 || steps <= cellwise_cell.constant.gap_steps) {
            CHECK(((status & CELLWISE_SEQUENCE_GAP) != 0u) == (steps != 0u));
            y.sequence = on.sequence;
            CHECK(memcmp(&on, &y, sizeof y) == 0 && memcmp(&expected, &out, sizeof out) == 0);
        } else { /* at rest: no branch is carried over a long time by this build */
            CHECK(out.soc_variance > x.ss);
            CHECK(!(magnitude_of(y.v1_V) > 0.5f * magnitude_of(x.v1_V)));
        }
    }
"""


@pytest.mark.parametrize("case", ["lean", "full"])
def test_the_time_off_is_a_gap_of_the_first_step(case, tmp_path):
    """CW-014: to the bit as where the filter had gone on and seen no sample for as long."""
    size = "static float magnitude_of(float x) { return (x < 0.0f) ? -x : x; }\n"
    program = (HEAD + AGE + TAIL).replace("int main", size + "int main")
    compile_and_run(tables_of(case), tmp_path, program, flags=("-O1",))


WRITES = """
    cellwise_stored kept, none;
    FILE *const file = fopen(argv[1], "wb");
    memset(&none, 0, sizeof none);
    cellwise_keep(&kept, &x, &none);
    CHECK((file != NULL) && (fwrite(&kept, sizeof kept, 1u, file) == 1u));
    CHECK(fclose(file) == 0);
    printf("%.9g %.9g\\n", (double)x.soc, (double)x.ss);
"""
READS = """
    union { cellwise_stored stored; unsigned char bytes[4096]; } slot, other;
    cellwise_state y;
    FILE *const file = fopen(argv[1], "rb");
    memset(&slot, 0xFF, sizeof slot);
    memset(&other, 0xFF, sizeof other);
    CHECK((file != NULL) && (fread(slot.bytes, 1u, sizeof slot.bytes, file) > 64u));
    CHECK(cellwise_newest_slot(&other.stored, &slot.stored) == 1u);
    CHECK(cellwise_restore(&cellwise_cell, &y, &slot.stored, 0u) == CELLWISE_OTHER_MODEL);
    printf("%.9g %.9g\\n", (double)y.soc, (double)y.ss);
    CHECK(cellwise_restore(&cellwise_cell, &y, &slot.stored, 86400u) == CELLWISE_OTHER_MODEL);
    printf("%.9g %.9g\\n", (double)y.soc, (double)y.ss);
    cellwise_keep(&other.stored, &y, &slot.stored);
    CHECK(cellwise_newest_slot(&other.stored, &slot.stored) == 0u);
    slot.bytes[20] = (unsigned char)(slot.bytes[20] ^ 1u); /* the SOC itself */
    CHECK(cellwise_restore(&cellwise_cell, &y, &slot.stored, 0u) == CELLWISE_BITS_DAMAGED);
    (void)fclose(file);
"""


@pytest.mark.parametrize("wide", [False, True])
def test_a_state_goes_on_with_new_tables_to_the_bit_of_the_twin(wide):
    """CW-013: charge under way, branches and the current's offset are the cell's, not the tables'.

    The twin is handed its own state, known less well.
    """
    asked = {"wide": wide, "offset": wide}
    old, new = (fixed_step_tables(curved_cell(capacity_Ah=c), 1.0, **asked) for c in (5.0, 4.4))
    before, after = (numba_stepper(tables) for tables in (old, new))
    records = noisy_samples(900)
    state = before.state()
    before.begin(state, 0.6, 0.05)
    before.rows(state, records[:500])
    slots = np.zeros((2, 32 + state.nbytes + 4), np.uint8)
    with_C = [HostLibrary(tables) for tables in (old, new)]
    with_C[0].loaded.call("keep", slots[0], state, slots[1])
    restored = after.state()
    missing = 7 * wide  # without it a gap begins at rest
    assert with_C[1].call("restore", restored, slots[0], missing) == OTHER_MODEL
    state["ss"] += np.float32(0.0025)
    state["sequence"] = 2**32 - 1 - missing
    assert restored.tobytes() == state.tobytes()
    rest = records[500:].copy()
    rest["sequence"] -= 500
    twin, found = after.rows(state, rest), with_C[1].rows(restored, rest)
    assert found.tobytes() == twin.tobytes()
    assert restored.tobytes() == state.tobytes()


ANOTHER_KIND = """
    cellwise_stored kept, none;
    cellwise_state y;
    memset(&none, 0, sizeof none);
    x.per_capacity = 1.25f; /* a patch of the other tables */
    cellwise_keep(&kept, &x, &none);
    for (uint32_t part = 0x10000u; part != 0u; part *= 2u) { /* as large, and other fields in it */
        kept.head.kind ^= part;
        kept.head.crc = crc_of_head(&kept.head);
        kept.crc = crc_of_state(&kept);
        CHECK(cellwise_restore(&cellwise_cell, &y, &kept, 0u) == CELLWISE_OTHER_MODEL);
        CHECK(memcmp(&y.soc, &x.soc, sizeof x.soc) == 0 && y.evidence == 0u);
        kept.head.kind ^= part;
    }
    kept.head.model_crc ^= 1u;
    kept.head.crc = crc_of_head(&kept.head);
    kept.crc = crc_of_state(&kept);
    CHECK(cellwise_restore(&cellwise_cell, &y, &kept, 0u) == CELLWISE_OTHER_MODEL);
    CHECK((y.evidence == x.evidence) && !(y.per_capacity > 1.0f));
"""


def test_a_state_with_other_fields_gives_its_soc_alone(tmp_path):
    """CW-013."""
    ran(fixed_step_tables(curved_cell(), 1.0, wide=False, health=True), tmp_path, ANOTHER_KIND)


@pytest.mark.parametrize("after", ["lean", "full"])
def test_new_tables_take_the_soc_and_know_it_less_well(after, tmp_path):
    """CW-013: tables of another size, or of another state, read the head that all builds share."""
    place = str(tmp_path / "slot.bin")
    (tmp_path / "old").mkdir()
    (tmp_path / "new").mkdir()
    old = fixed_step_tables(curved_cell(capacity_Ah=4.6), 1.0, wide=False)
    soc, variance = map(float, ran(old, tmp_path / "old", WRITES, [place]).split())
    new = tables_of(after)
    told = ran(new, tmp_path / "new", READS, [place]).split()
    carried, wider, later, widest = map(float, told)
    assert carried == later == soc
    assert wider == pytest.approx(variance + 0.05**2, rel=1e-5)
    gap = float(new.constants["gap_variance"][0])
    assert widest == pytest.approx(wider + gap, rel=1e-5)


PIECES = """
    static cellwise_model copy; /* writable, to be damaged */
    static const uint32_t sizes[] = {1u, 7u, sizeof(cellwise_row) / 4u, 100u, 100000u};
    const uint32_t all = sizeof copy / 4u;
    unsigned char *const at = (unsigned char *)&copy;
    for (uint32_t k = 0u; k < sizeof sizes / sizeof sizes[0]; k++) {
        cellwise_check check = {0u, 0u};
        for (uint32_t bit = 0u; bit < 8u * sizeof copy; bit += (bit < 64u) ? 1u : 4099u) {
            memcpy(&copy, &cellwise_cell, sizeof copy);
            if (bit != 0u) {
                at[bit / 8u] = (unsigned char)(at[bit / 8u] ^ (1u << (bit % 8u)));
            }
            const uint32_t whole = cellwise_check_model(&copy);
            uint32_t calls = 1u;
            uint32_t found = cellwise_check_model_part(&copy, &check, sizes[k]);
            while (found == CELLWISE_CHECK_GOES_ON) {
                found = cellwise_check_model_part(&copy, &check, sizes[k]);
                calls++;
            }
            CHECK(whole == ((bit == 0u) ? 0u : CELLWISE_BITS_DAMAGED));
            CHECK(found == whole);
            CHECK(calls == (all + sizes[k] - 1u) / sizes[k]);
        }
    }
    cellwise_check odd = {0xFFFFFFF0u, 5u}; /* memory that lost its content: from the beginning */
    CHECK(cellwise_check_model_part(&cellwise_cell, &odd, all) == 0u);
"""


@pytest.mark.parametrize("case", ["lean", "full"])
def test_tables_checked_in_pieces_are_checked_as_a_whole(case, tmp_path):
    """CW-015."""
    ran(tables_of(case), tmp_path, PIECES)


OF_CELLS = """
    cellwise_pack_cell cells[5];
    cellwise_stored kept, none;
    cellwise_stored_cells beside;
    unsigned char *at[2];
    size_t size[2];
    memset(&none, 0, sizeof none);
    cellwise_cells_init(&cellwise_cell, cells, 5u);
    cells[3].capacity = -0.04f;
    cellwise_keep(&kept, &x, &none);
    cellwise_keep_cells(&beside, &kept, cells, 5u);
    CHECK(cellwise_restore_cells(&beside, &kept, cells, 5u) == 0u);
    CHECK(cellwise_restore_cells(&beside, &kept, cells, 4u) == CELLWISE_OTHER_LAYOUT);
    none = kept;
    cellwise_keep(&kept, &x, &none); /* a loss of power between the state and its cells */
    CHECK(cellwise_restore_cells(&beside, &kept, cells, 5u) == CELLWISE_BITS_DAMAGED);
    kept = none;
    at[0] = (unsigned char *)&beside;
    at[1] = (unsigned char *)cells;
    size[0] = sizeof beside;
    size[1] = sizeof cells;
    for (uint32_t part = 0u; part < 2u; part++) {
        for (uint32_t k = 0u; k < 8u * size[part]; k++) {
            at[part][k / 8u] = (unsigned char)(at[part][k / 8u] ^ (1u << (k % 8u)));
            CHECK(cellwise_restore_cells(&beside, &kept, cells, 5u) != 0u);
            at[part][k / 8u] = (unsigned char)(at[part][k / 8u] ^ (1u << (k % 8u)));
        }
    }
"""


def test_the_cells_of_a_pack_belong_to_one_state(tmp_path):
    """CW-011."""
    model = curved_cell()
    tables = fixed_step_tables(model, 1.0, wide=False, health=True, cells=CellSettings())
    ran(tables, tmp_path, OF_CELLS)


OF_BANK = """
    cellwise_stored kept, none;
    cellwise_bank bank;
    cellwise_state of[4];
    memset(&none, 0, sizeof none);
    memset(&bank, 0x55, sizeof bank);
    memset(of, 0x55, sizeof of);
    CHECK(cellwise_bank_restore(&cellwise_cell, &bank, of, 3u, &none, 0u) == CELLWISE_NOT_STORED);
    x.ss = 1e-4f;
    cellwise_keep(&kept, &x, &none);
    CHECK(cellwise_bank_restore(&cellwise_cell, &bank, of, 3u, &kept, 0u) == 0u);
    x.sequence = of[0].sequence;
    CHECK((bank.spread == 0u) && (memcmp(&of[0], &x, sizeof x) == 0));
    x.ss = 0.04f; /* 20 %: components are needed */
    cellwise_keep(&kept, &x, &none);
    CHECK(cellwise_bank_restore(&cellwise_cell, &bank, of, 3u, &kept, 0u) == 0u);
    CHECK(bank.spread == 1u);
    CHECK(!(of[0].soc < x.soc) && !(of[0].soc > x.soc));
    x.evidence = 1u; /* no voltage seen: a start, however long ago it was kept */
    cellwise_keep(&kept, &x, &none);
    CHECK(cellwise_bank_restore(&cellwise_cell, &bank, of, 3u, &kept, CELLWISE_AGE_UNKNOWN) == 0u);
    CHECK(bank.spread == 1u);
"""


def test_a_bank_goes_on_or_begins_again(tmp_path):
    """CW-014."""
    ran(tables_of("full"), tmp_path, OF_BANK)


@pytest.mark.parametrize(
    ("std", "gap_soc", "moved_V", "begins_again"),
    [(0.01, 0.05, 0.0, 0), (0.01, 0.01, 0.2, 0), (0.01, 0.05, 0.2, 1), (0.15, 0.01, 0.2, 1)],
)
def test_a_restored_bank_goes_on_as_one_that_saw_the_gap(std, gap_soc, moved_V, begins_again):
    """CW-014: to the bit, whether the SOC is known well enough for one filter or not."""
    model = curved_cell()
    noise = replace(noise_for(model, None), gap_soc=gap_soc)
    library = HostLibrary(fixed_step_tables(model, 1.0, noise))
    records = noisy_samples(900)
    before, rest = records[:500], records[500:].copy()
    rest["voltage_V"] += moved_V
    ran_on = library.start_filter(5, 0.4, 0.01)
    library.filter_rows(ran_on, before)
    assert not ran_on.bank["spread"][0]
    ran_on.states["ss"][0] = std**2
    slots = np.zeros((2, 32 + ran_on.states.itemsize + 4), np.uint8)
    library.loaded.call("keep", slots[0], ran_on.states, slots[1])
    restored = library.start_filter(5, 0.5, 0.3)
    age_unknown, longest = 2**32 - 1, 2**20
    assert library.call("bank_restore", *restored, 5, slots[0], age_unknown) == 0
    rest["sequence"] -= rest["sequence"][0]
    found = library.filter_rows(restored, rest[:1])
    spread = restored.bank["spread"][0]
    found = np.append(found, library.filter_rows(restored, rest[1:]))
    rest["sequence"] += before["sequence"][-1] + np.uint32(longest + 1)
    assert found.tobytes() == library.filter_rows(ran_on, rest).tobytes()
    assert spread == begins_again
