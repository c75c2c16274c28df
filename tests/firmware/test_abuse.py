"""Fuzzing, a long run, and the rules that the C keeps."""

from __future__ import annotations

import os
import re
import shutil
import subprocess

import numpy as np
import pytest

from cellwise.data import load_dataset
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.export.c_tables import PUBLIC_HEADERS, STRICT_FLAGS, firmware_folder, write_sources
from example_cells import curved_cell
from firmware_cases import tables_of
from virtual_tester import logged

pytestmark = pytest.mark.slow
ANALYSIS = firmware_folder() / "analysis"
# Reasons: firmware_ref/analysis/README.md.
DEVIATIONS = {"2.3", "2.4", "2.5", "8.7", "10.8", "15.5", "19.2", "20.7", "21.15"}


def write(tables, folder):
    for name, text in write_sources(tables, "0" * 64):
        (folder / name).write_text(text)


def build(folder, command, program, *libraries):
    sources = ["cellwise_ekf.c", "cell_table.c", str(ANALYSIS / program)]
    done = subprocess.run(
        [*command, *STRICT_FLAGS, "-I.", *sources, "-o", "program", *libraries],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[:2000]


@pytest.mark.skipif(shutil.which("clang") is None, reason="no clang: make firmware")
@pytest.mark.parametrize("case", ["lean", "full"])
def test_fuzzing_finds_nothing(case, tmp_path):
    write(tables_of(case), tmp_path)
    checks = "-fsanitize=fuzzer,address,undefined,float-cast-overflow"
    build(tmp_path, ["clang", "-O1", "-g", checks, "-fno-sanitize-recover=all"], "fuzz.c")
    seconds = os.environ.get("CELLWISE_FUZZ_SECONDS", "10")
    done = subprocess.run(
        ["./program", f"-max_total_time={seconds}", "-max_len=2000", "-seed=1"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(re.findall(r"Done (\d+) runs", done.stderr)[0]) > 1000


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
@pytest.mark.parametrize("wide", [False, True])
def test_a_long_run_stays_sound(wide, tmp_path):
    model = curved_cell(capacity_Ah=5.1)
    drive = load_dataset("nmc_drive_b")
    drive = logged(model, drive, 0.95)
    there = samples_of(model, drive, 0.1).records
    back = there[::-1].copy()
    back["current_A"] *= -1.0  # so that it can be repeated
    np.concatenate([there, back]).tofile(tmp_path / "drive.bin")
    write(fixed_step_tables(model, 0.1, wide=wide), tmp_path)
    build(tmp_path, ["gcc", "-O2"], "long_run.c", "-lm")
    steps = os.environ.get("CELLWISE_LONG_STEPS", "2000000")
    done = subprocess.run(
        ["./program", "drive.bin", steps], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout


UNSAFE = ("-ffast-math", "-funsafe-math-optimizations", "-ffinite-math-only", "-freciprocal-math")


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
@pytest.mark.parametrize("option", UNSAFE)
def test_what_breaks_the_arithmetic_does_not_compile(option, tmp_path):
    """CW-017."""
    write(tables_of("lean"), tmp_path)
    done = subprocess.run(["gcc", "-c", option, "cellwise_ekf.c"], cwd=tmp_path,
                          capture_output=True, text=True, check=False)  # fmt: skip
    assert done.returncode != 0
    assert "build without -ffast-math" in done.stderr


CPP = """#include "cellwise_cell.h"
#include "cellwise_clock.h"
#include "cellwise_store.h"
int main() {
    cellwise_state x;
    cellwise_stored slot[2] = {};
    cellwise_clock clock;
    cellwise_output out;
    cellwise_init(&cellwise_cell, &x, 0.5f, 0.01f);
    cellwise_clock_begin(&clock, 0u, 1000u);
    while (cellwise_clock_steps(&clock, 1000u) == 0u) {
    }
    const cellwise_input in = {1.0f, 3.7f, 25.0f, clock.sequence};
    const bool stepped = cellwise_step(&cellwise_cell, &x, &in, &out) == 0u;
    cellwise_keep(&slot[1], &x, &slot[0]);
    const bool kept = cellwise_newest_slot(&slot[0], &slot[1]) == 1u;
    return stepped && kept && cellwise_restore(&cellwise_cell, &x, &slot[1], 0u) == 0u ? 0 : 1;
}
"""


def test_every_header_of_an_application_is_for_cpp_too(tmp_path):
    write(tables_of("lean"), tmp_path)
    for name in PUBLIC_HEADERS:
        text = (tmp_path / name).read_text()
        declares = re.search(r"^(extern|static inline|void|uint32_t|float) ", text, re.M)
        assert ('extern "C" {' in text) >= bool(declares), name


CXX = shutil.which("g++") or shutil.which("clang++")


@pytest.mark.skipif(CXX is None, reason="no g++, no clang++: apt-get install g++")
def test_a_program_in_cpp_links_the_c(tmp_path):
    write(tables_of("lean"), tmp_path)
    (tmp_path / "main.cpp").write_text(CPP)
    sources = ("cellwise_ekf.c", "cellwise_store.c", "cell_table.c")
    for command in (
        ["gcc", "-c", *STRICT_FLAGS, *sources],
        [CXX, "-Wall", "-Wextra", "-Werror", "main.cpp",
         *(name.replace(".c", ".o") for name in sources), "-o", "program"],
        ["./program"],
    ):  # fmt: skip
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[:2000]


@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="no cppcheck: make firmware")
@pytest.mark.parametrize("case", ["lean", "full", "full pack"])
def test_rules_are_kept_but_for_the_written_deviations(case, tmp_path):
    write(tables_of(case), tmp_path)
    done = subprocess.run(
        ["cppcheck", "--addon=misra", "--std=c99", "-q", "cellwise_ekf.c", "cellwise_store.c"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    found = set(re.findall(r"misra-c2012-([\d.]+)", done.stderr))
    assert found
    assert found <= DEVIATIONS, done.stderr
    page = (ANALYSIS / "README.md").read_text()
    assert all(f"| {rule} " in page for rule in found)
