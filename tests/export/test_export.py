"""cellwise export: what it writes compiles without a warning, and says which model it is."""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess

import numpy as np
import pytest

from cellwise.cell.effects import TimeSkew
from cellwise.errors import InputError
from cellwise.estimate.fixed.layout import INPUT, hex_float
from cellwise.estimate.fixed.stepper import numba_stepper, start_state
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.estimate.noise import Noise
from cellwise.estimate.status import SEQUENCE_GAP
from cellwise.export.package import DESCRIPTION, export_firmware
from example_cells import curved_cell

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
pytestmark = pytest.mark.usefixtures("no_cross_compiler")
SOURCES = ("cellwise_ekf.c", "cellwise_store.c", "cell_table.c")


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
        (["--dt", 1, "--without", "magic"], "--without magic"),
        *((["--dt", 1, "--cells", cells], "2 to 1000 in series") for cells in (1, -4, 1001)),
        *((["--dt", 1, "--prefix", prefix], "prefix")
          for prefix in ("1a", "a-b", "cellwise", "CELLWISE", "ä", "a" * 40)),
    ],
)  # fmt: skip
def test_what_a_target_cannot_hold_is_refused(refused, tmp_path, arguments, said):
    assert said in refused(*arguments, "-o", tmp_path / "out")


def test_python_writes_what_the_command_writes(export, tmp_path):
    told = export("--dt", 1, "-o", tmp_path / "command")
    paths = export_firmware(curved_cell(), tmp_path / "python", 1.0)
    assert [str(p.relative_to(tmp_path / "python")) for p in paths] == told["files"]
    for path in paths:
        other = tmp_path / "command" / path.relative_to(tmp_path / "python")
        assert path.name == DESCRIPTION or path.read_bytes() == other.read_bytes(), path.name


def test_what_is_written_is_described(export, tmp_path):
    told = export("--dt", 1, "--lean", "-o", tmp_path / "out")
    digest = hashlib.sha256((tmp_path / "model.json").read_bytes()).hexdigest()
    assert told["model_sha256"] == digest
    assert told["state_bytes"] <= 64
    assert told["dt_s"] == 1.0
    assert all((tmp_path / "out" / name).is_file() for name in told["files"])
    assert digest in (tmp_path / "out" / "cell_table.h").read_text()
    tables = fixed_step_tables(curved_cell(), 1.0, wide=False)
    assert told["model_bytes"] == len(tables.to_bytes())


@pytest.mark.parametrize(("more", "points"), [((), 101), (("--points", 21), 21)])
def test_the_number_of_soc_points_and_why_are_said(export, tmp_path, more, points):
    told = export("--dt", 1, "--lean", *more, "-o", tmp_path / "out")["soc_grid"]
    assert told["points"] == points
    assert told["model_points"] == curved_cell().points
    assert told["by_default"] == (not more)
    assert (told["missed"] <= told["most_missed"]) == (not more)
    assert told["text"] in (tmp_path / "out" / "README.md").read_text()
    header = (tmp_path / "out" / "cell_table.h").read_text()
    assert re.search(rf"CELLWISE_POINTS \(?{points}u?\b", header)


@needs_gcc
@pytest.mark.parametrize(
    "more",
    [
        ("--lean",),
        *(pytest.param(m, marks=pytest.mark.slow) for m in ((), ("--remaining", 3.2))),
    ],
    ids=str,
)
def test_the_example_compiles_and_prints_what_is_expected(export, built, tmp_path, more):
    """With the remaining time its vector holds a plan of loads, too."""
    out = tmp_path / "out"
    told = export("--dt", 1, "-o", out, *more)
    assert {"README.md", "example.c", "test_vector.h", "expected_output.txt"} <= set(told["files"])
    done = built(out, ("example.c", *SOURCES))
    assert done.returncode == 0, done.stdout
    assert done.stdout == (out / "expected_output.txt").read_text()
    # One number of the vector, one of the tables: each is noticed.
    for name, found in (("test_vector.h", 1), ("cell_table.c", 2)):
        text = (out / name).read_text()
        place = text.rindex("0x1.", 0, text.rfind("#if CELLWISE_REMAINING") if not more else None)
        (out / name).write_text(text[:place] + "0x1.8" + text[place + 4 :])
        assert built(out, ("example.c", *SOURCES)).returncode == found
        (out / name).write_text(text)


@needs_gcc
@pytest.mark.parametrize("name", ["a */ b tail\\", "what??/", "line\nbreak"])
def test_a_cell_of_any_name_compiles(export, built, tmp_path, name):
    export("--dt", 1, "-o", tmp_path / "out", model=curved_cell(name=name))
    assert built(tmp_path / "out", ("example.c", *SOURCES)).returncode == 0


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


@pytest.mark.slow
@needs_gcc
def test_96_cells_in_any_order_on_one_table(export, built, tmp_path):
    export("--dt", 1, "-o", tmp_path / "out")
    (tmp_path / "out" / "main.c").write_text(CELLS)
    assert built(tmp_path / "out", ("main.c", *SOURCES)).returncode == 0


@pytest.mark.slow
def test_the_export_of_a_pack_says_what_its_cells_take(export, tmp_path):
    told = export("--dt", 1, "-o", tmp_path / "out", "--lean", "--cells", 96, "--health")
    assert told["options"]["health"] == told["options"]["cells"] == 1
    assert told["pack_bytes"] == told["state_bytes"] + 96 * 48


@needs_gcc
def test_the_filter_has_no_memory_of_its_own(export, tmp_path):
    export("--dt", 1, "-o", tmp_path / "out")
    command = ["gcc", "-O2", "-c", "cellwise_ekf.c", "-o", "ekf.o"]
    subprocess.run(command, cwd=tmp_path / "out", check=True)
    size = ["size", str(tmp_path / "out" / "ekf.o")]
    done = subprocess.run(size, capture_output=True, text=True, check=True)
    _, data, bss, *_ = done.stdout.splitlines()[1].split()
    assert (data, bss) == ("0", "0")


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
def test_two_chemistries_in_one_image(export, built, tmp_path):
    for name, more in (("nmc", ()), ("lfp", ("--lean",))):
        export("--dt", 1, "-o", tmp_path / name, "--prefix", name, *more)
        assert (tmp_path / name / f"{name}_ekf.c").is_file()
    (tmp_path / "both.c").write_text(BOTH)
    parts = [f"{n}/{n}_{part}.c" for n in ("nmc", "lfp") for part in ("ekf", "cell_table")]
    assert built(tmp_path, ["both.c", *parts], "-Inmc", "-Ilfp").returncode == 0


def test_an_effect_is_left_out_and_the_target_s_noise_is_compiled_in(export, tmp_path):
    plain = curved_cell()
    skewed = curved_cell(effects=(*plain.effects, TimeSkew(0.3)))
    out = ("--dt", 1, "-o", tmp_path / "out")
    assert export(*out, model=skewed)["options"]["skew"] == 1
    own = (tmp_path / "out" / "cell_table.c").read_text()
    said = ("voltage_V=0.02", "current_A=0.5", "recovery_after=7")
    noise = [word for one in said for word in ("--noise", one)]
    found = export(*out, "--without", "time_skew", *noise, model=skewed)
    assert found["options"]["skew"] == 0
    names = ("voltage_V", "current_A", "recovery_after", "slow_s")
    assert [found["noise"][n] for n in names] == [0.02, 0.5, 7, Noise.of_model(plain).slow_s]
    loud = (tmp_path / "out" / "cell_table.c").read_text()
    assert hex_float(0.5**2) in loud.split("/* current_variance_A2 */")[0].splitlines()[-1]
    assert loud != own


@pytest.mark.parametrize("lean", [False, True])
def test_the_readme_says_limits_noise_parking_interrupts_and_shared_tables(export, tmp_path, lean):
    """And each of them as it is of this build."""
    told = export("--dt", 1, "-o", tmp_path / "out", *(["--lean"] if lean else []))
    text = " ".join((tmp_path / "out" / "README.md").read_text().split())
    assert "$" not in text
    shortest, longest = told["dt_limits_s"]
    assert f"Between {shortest:.2g} s" in text
    assert f"and {longest:g} s" in text
    fixed_step_tables(curved_cell(), 1.01 * shortest)
    with pytest.raises(InputError, match="time constant"):
        fixed_step_tables(curved_cell(), 0.99 * shortest)
    assert f"{told['noise']['voltage_V']:.3g} V of the voltage sensor" in text
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
    grown = state[0]["ss"] - before["ss"]
    assert grown == pytest.approx(Noise.of_model(curved_cell()).gap_soc ** 2, rel=0.02)
    left = state[0]["v1_V"] / before["v1_V"]
    assert (left < 1e-6) is not lean
