"""cellwise export: what it writes compiles without a warning, and says which model it is."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess

import numpy as np
import pytest

from cellwise.cell.model_file import write_model
from cellwise.cli import main
from cellwise.errors import InputError
from cellwise.estimate.fixed.layout import INPUT
from cellwise.estimate.fixed.stepper import numba_stepper, start_state
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.estimate.noise import Noise
from cellwise.estimate.status import SEQUENCE_GAP
from cellwise.export.c_tables import STRICT_FLAGS, WARNING_FLAGS
from cellwise.export.package import describe, write_package
from example_cells import curved_cell
from firmware_cases import tables_of


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.json"
    write_model(curved_cell(), path)
    return path


def export(capsys, *arguments):
    code = main(["export", *map(str, arguments), "--json"])
    captured = capsys.readouterr()
    return code, (json.loads(captured.out) if code == 0 else captured.err)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
def test_what_is_written_compiles_and_is_described(model, tmp_path, capsys):
    code, told = export(capsys, "--model", model, "--dt", 1, "--lean", "-o", tmp_path / "out")
    assert code == 0
    assert told["model_sha256"] == hashlib.sha256(model.read_bytes()).hexdigest()
    assert told["state_bytes"] <= 64
    assert told["dt_s"] == 1.0
    for name in told["files"]:
        assert (tmp_path / "out" / name).is_file()
    assert told["model_sha256"] in (tmp_path / "out" / "cell_table.h").read_text()
    command = ["gcc", "-O2", *STRICT_FLAGS, *WARNING_FLAGS, "-c"]
    for source in ("cellwise_ekf.c", "cell_table.c"):
        done = subprocess.run(
            [*command, source], cwd=tmp_path / "out", capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--dt", 0], "time step"),
        (["--dt", 1e-5], "time constant"),
        (["--dt", 61], "at most 60 s"),
        (["--dt", 1, "--noise", "voltage=0.005"], "voltage_V"),
        (["--dt", 1, "--noise", "voltage_V"], "NAME=X"),
        (["--dt", 1, "--noise", "voltage_V=0"], "above zero"),
        (["--dt", 1, "--points", 2], "at least 3"),
        (["--dt", 1, "--points", 100_000], "SOC points"),
    ],
)
def test_what_a_target_cannot_hold_is_refused(model, tmp_path, capsys, arguments, said):
    code, message = export(capsys, "--model", model, *arguments, "-o", tmp_path / "out")
    assert code == 2
    assert said in message
    assert not (tmp_path / "out").exists()


def test_flash_counts_what_the_compiler_lays_out():
    tables = tables_of("full")
    assert describe(curved_cell(), tables)["model_bytes"] == len(tables.to_bytes())


FLAGS = ["-O2", *STRICT_FLAGS, *WARNING_FLAGS]
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")


def made(folder, cell=None, prefix="", **options):
    """The package of a cell, without counting instructions: the names of its files."""
    cell = cell or curved_cell()
    tables = fixed_step_tables(cell, 1.0, **options)
    return write_package(cell, tables, folder, describe(cell, tables), prefix)


def built(folder, sources, program, *options):
    done = subprocess.run(
        ["gcc", *FLAGS, *options, *sources, "-o", str(program)],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return subprocess.run([str(program)], capture_output=True, text=True, check=False)


@needs_gcc
@pytest.mark.parametrize("case", ["plain", "lean", "remaining"])
def test_the_example_compiles_and_prints_what_is_expected(tmp_path, case):
    """With the remaining time its vector holds a plan of loads, too."""
    out = tmp_path / "out"
    lean = case == "lean"
    more = {"remaining_V": 3.2} if case == "remaining" else {}
    files = made(out, wide=not lean, **more)
    assert {"README.md", "example.c", "test_vector.h", "expected_output.txt"} <= set(files)
    sources = ("example.c", "cellwise_ekf.c", "cellwise_store.c", "cell_table.c")
    done = built(out, sources, tmp_path / "example")
    assert done.returncode == 0, done.stdout
    assert done.stdout == (out / "expected_output.txt").read_text()
    # One number of the vector, one of the tables: each is noticed.
    for name, found in (("test_vector.h", 1), ("cell_table.c", 2)):
        text = (out / name).read_text()
        place = text.rindex("0x1.")
        (out / name).write_text(text[:place] + "0x1.8" + text[place + 4 :])
        assert built(out, sources, tmp_path / "wrong").returncode == found
        (out / name).write_text(text)


STORE = """
#include <stdio.h>
#include <string.h>
#include "cellwise_cell.h"
#include "cellwise_store.h"
int main(void) {
    cellwise_state x, y;
    cellwise_stored kept;
    unsigned char *at = (unsigned char *)&kept;
    unsigned k, missed = 0u;
    cellwise_init(&cellwise_cell, &x, 0.4f, 0.01f);
    cellwise_keep(&kept, &x);
    memset(&y, 0, sizeof y);
    if (cellwise_restore(&y, &kept) != 0u || memcmp(&x, &y, sizeof x) != 0) return 1;
    for (k = 0u; k < 8u * sizeof kept; k++) {
        cellwise_state before = y;
        at[k / 8u] = (unsigned char)(at[k / 8u] ^ (1u << (k % 8u)));
        if (cellwise_restore(&y, &kept) == 0u || memcmp(&before, &y, sizeof y) != 0) missed++;
        at[k / 8u] = (unsigned char)(at[k / 8u] ^ (1u << (k % 8u)));
    }
    return missed == 0u ? 0 : 3;
}
"""


@needs_gcc
def test_a_stored_state_with_one_flipped_bit_is_not_taken(tmp_path):
    out = tmp_path / "out"
    made(out)
    (out / "store.c").write_text(STORE)
    sources = ("store.c", "cellwise_ekf.c", "cellwise_store.c", "cell_table.c")
    assert built(out, sources, tmp_path / "store").returncode == 0


STORED_CELLS = """
#include <string.h>
#include "cellwise_cell.h"
#include "cellwise_store.h"
int main(void) {
    cellwise_pack_cell cells[5];
    cellwise_stored_cells kept;
    unsigned char *at[2];
    unsigned size[2];
    unsigned part, k, missed = 0u;
    cellwise_cells_init(&cellwise_cell, cells, 5u);
    cells[3].capacity = -0.04f;
    cellwise_keep_cells(&kept, cells, 5u);
    if (cellwise_restore_cells(&kept, cells, 5u) != 0u) return 1;
    if (cellwise_restore_cells(&kept, cells, 4u) != CELLWISE_OTHER_LAYOUT) return 2;
    at[0] = (unsigned char *)&kept;
    at[1] = (unsigned char *)cells;
    size[0] = sizeof kept;
    size[1] = sizeof cells;
    for (part = 0u; part < 2u; part++) {
        for (k = 0u; k < 8u * size[part]; k++) {
            at[part][k / 8u] = (unsigned char)(at[part][k / 8u] ^ (1u << (k % 8u)));
            missed += cellwise_restore_cells(&kept, cells, 5u) == 0u;
            at[part][k / 8u] = (unsigned char)(at[part][k / 8u] ^ (1u << (k % 8u)));
        }
    }
    return missed == 0u ? 0 : 3;
}
"""


@pytest.mark.slow
@needs_gcc
def test_a_pack_is_exported_and_its_stored_cells_are_checked(model, tmp_path, capsys):
    out = tmp_path / "out"
    code, report = export(
        capsys, "--model", model, "--dt", 1, "--lean", "--cells", 96, "--health", "-o", out
    )
    assert code == 0
    assert report["cells"] == 96
    assert report["options"]["health"] == report["options"]["cells"] == 1
    assert report["pack_bytes"] == report["state_bytes"] + 96 * 48
    (out / "cells.c").write_text(STORED_CELLS)
    sources = ("cells.c", "cellwise_ekf.c", "cellwise_store.c", "cell_table.c")
    assert built(out, sources, tmp_path / "cells").returncode == 0


@pytest.mark.parametrize("cells", [1, -4, 1001])
def test_a_number_of_cells_that_no_pack_has_is_refused(model, tmp_path, capsys, cells):
    code, message = export(
        capsys, "--model", model, "--dt", 1, "--cells", cells, "-o", tmp_path / "out"
    )
    assert code == 2
    assert "2 to 1000 in series" in message


BOTH = """
#include <stdio.h>
#include "nmc_cell.h"
#include "lfp_cell.h"
int main(void) {
    nmc_state a;
    lfp_state b[96];
    unsigned k;
    nmc_init(&nmc_cell, &a, 0.5f, 0.01f);
    for (k = 0u; k < 96u; k++) lfp_init(&lfp_cell, &b[k], 0.5f, 0.01f);
    return sizeof a == sizeof b[0];
}
"""


@needs_gcc
def test_two_chemistries_in_one_image(tmp_path):
    for name, lean in (("nmc", False), ("lfp", True)):
        out = tmp_path / name
        made(out, prefix=name, wide=not lean)
        assert (out / f"{name}_ekf.c").is_file()
    (tmp_path / "both.c").write_text(BOTH)
    parts = [f"{n}/{n}_{part}.c" for n in ("nmc", "lfp") for part in ("ekf", "cell_table")]
    sources = ["both.c", *parts]
    done = built(tmp_path, sources, tmp_path / "both", "-Inmc", "-Ilfp")
    assert done.returncode == 0


@pytest.mark.parametrize("prefix", ["1a", "a-b", "cellwise", "CELLWISE", "ä", "a" * 40])
def test_a_prefix_that_is_no_name_is_refused(model, tmp_path, capsys, prefix):
    code, message = export(
        capsys, "--model", model, "--dt", 1, "--prefix", prefix, "-o", tmp_path / "out"
    )
    assert code == 2
    assert "prefix" in message
    assert not (tmp_path / "out").exists()


@needs_gcc
@pytest.mark.parametrize("name", ["a */ b tail\\", "what??/", "line\nbreak"])
def test_a_cell_of_any_name_compiles(tmp_path, name):
    out = tmp_path / "out"
    made(out, curved_cell(name=name))
    sources = ("example.c", "cellwise_ekf.c", "cellwise_store.c", "cell_table.c")
    assert built(out, sources, tmp_path / "example").returncode == 0


def test_an_effect_can_be_left_out():
    from cellwise.cell.effects import TimeSkew
    from cellwise.cli.exporting import without

    plain = curved_cell()
    skewed = curved_cell(effects=(*plain.effects, TimeSkew(0.3)))
    assert fixed_step_tables(skewed, 1.0).options.skew
    assert without(skewed, ["time_skew"]).effects == plain.effects
    with pytest.raises(InputError, match="time_skew"):
        without(skewed, ["magic"])


def test_the_target_s_noise_is_compiled_in():
    from cellwise.cli.exporting import noise_of

    model = curved_cell()
    noise = noise_of(model, ["voltage_V=0.02", "current_A=0.5", "recovery_after=7"])
    own = noise_of(model, [])
    assert (noise.voltage_V, noise.current_A, noise.recovery_after) == (0.02, 0.5, 7)
    assert noise.slow_s == own.slow_s
    quiet, loud = (fixed_step_tables(model, 1.0, n) for n in (own, noise))
    assert loud.constants["current_variance_A2"][0] == np.float32(0.25)
    assert loud.to_bytes() != quiet.to_bytes()
    assert describe(model, loud, noise)["noise"]["voltage_V"] == 0.02


@pytest.mark.parametrize("lean", [False, True])
def test_the_readme_says_limits_noise_parking_interrupts_and_shared_tables(tmp_path, lean):
    """And each of them as it is of this build."""
    cell = curved_cell()
    tables = fixed_step_tables(cell, 1.0, wide=not lean)
    description = describe(cell, tables)
    write_package(cell, tables, tmp_path / "out", description)
    text = " ".join((tmp_path / "out" / "README.md").read_text().split())
    assert "$" not in text
    shortest, longest = description["dt_limits_s"]
    assert f"Between {shortest:.2g} s" in text
    assert f"and {longest:g} s" in text
    fixed_step_tables(cell, 1.01 * shortest)
    with pytest.raises(InputError, match="time constant"):
        fixed_step_tables(cell, 0.99 * shortest)
    assert f"{description['noise']['voltage_V']:.3g} V of the voltage sensor" in text
    assert "nobody may touch its own state or sample" in text
    assert "96 states of" in text
    assert ("the branches decay" in text.casefold()) is not lean
    assert ("leaves the branches where they are" in text) is lean


@pytest.mark.slow
@pytest.mark.parametrize("lean", [False, True])
def test_eight_hours_off_are_one_step_as_the_readme_says(lean):
    tables = fixed_step_tables(curved_cell(), 1.0, wide=not lean)
    stepper = numba_stepper(tables)
    state = start_state(stepper, 0.6, 0.02)
    samples = np.zeros(120, dtype=INPUT)
    samples["current_A"], samples["voltage_V"], samples["temperature_C"] = 3.0, 3.6, 25.0
    samples["sequence"] = np.arange(120)
    stepper.rows(state, samples)
    before = state[0].copy()
    assert before["v1_V"] > 1e-3
    back = samples[-1:].copy()
    back["sequence"] += 8 * 3600
    back["current_A"], back["voltage_V"] = 0.0, np.nan
    out = stepper.rows(state, back)[0]
    assert out["status"] & SEQUENCE_GAP
    assert out["soc"] == before["soc"]
    grown = out["soc_variance"] - before["ss"]
    assert grown == pytest.approx(Noise.of_model(curved_cell()).gap_soc ** 2, rel=0.02)
    left = state[0]["v1_V"] / before["v1_V"]
    assert (left < 1e-6) is not lean


CELLS = """
#include <string.h>
#include "cellwise_cell.h"
#include "test_vector.h"
static cellwise_state together[96], alone;
int main(void) {
    cellwise_output out, single;
    unsigned c, k, wrong = 0u;
    for (c = 0u; c < 96u; c++) {
        cellwise_init(&cellwise_cell, &together[c], 0.2f + 0.005f * (float)c, 0.01f);
    }
    for (k = 0u; k < CELLWISE_VECTOR_SAMPLES; k++) {
        for (c = 0u; c < 96u; c++) { /* another order in every step */
            cellwise_step(&cellwise_cell, &together[(c * 7u + k) % 96u],
                          &cellwise_vector_inputs[k], &out);
        }
    }
    for (c = 0u; c < 96u; c++) {
        cellwise_init(&cellwise_cell, &alone, 0.2f + 0.005f * (float)c, 0.01f);
        for (k = 0u; k < CELLWISE_VECTOR_SAMPLES; k++) {
            cellwise_step(&cellwise_cell, &alone, &cellwise_vector_inputs[k], &single);
        }
        wrong += memcmp(&alone, &together[c], sizeof alone) != 0;
    }
    return wrong != 0u;
}
"""


@needs_gcc
@pytest.mark.slow
def test_96_cells_share_one_table_and_nothing_else(tmp_path):
    """In any order each is as if it were alone; the filter has no memory of its own."""
    out = tmp_path / "out"
    made(out)
    (out / "cells.c").write_text(CELLS)
    done = built(out, ("cells.c", "cellwise_ekf.c", "cell_table.c"), tmp_path / "cells")
    assert done.returncode == 0
    command = ["gcc", *FLAGS, "-c", "cellwise_ekf.c", "-o", str(tmp_path / "ekf.o")]
    subprocess.run(command, cwd=out, check=True)
    size = subprocess.run(
        ["size", str(tmp_path / "ekf.o")], capture_output=True, text=True, check=True
    )
    _, data, bss, *_ = size.stdout.splitlines()[1].split()
    assert (data, bss) == ("0", "0")
