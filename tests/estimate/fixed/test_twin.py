"""numba and C: the same layout, the same bits of every function, whatever stands in the memory."""

from __future__ import annotations

import math
import shutil

import numpy as np
import pytest

from cellwise.data import load_dataset
from cellwise.estimate.fixed import layout
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.stepper import numba_stepper
from cellwise.estimate.status import Status
from cellwise.export.firmware import HostLibrary
from example_cells import curved_cell
from firmware_cases import compile_and_run, stress_samples, tables_of

pytest.importorskip("cffi")
pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
CELLS = 9


@pytest.mark.parametrize(
    "case", ["lean", "plain", "slow", "transfer", "surface", "validity", "full", "full beside"]
)
def test_layouts_are_the_compilers(case, tmp_path):
    tables = tables_of(case)
    o = tables.options
    records = {
        "state": layout.state_type(o), "constants": layout.constant_type(o),
        "row": layout.row_type(o), "input": layout.INPUT, "output": layout.OUTPUT,
        "capability": layout.CAPABILITY, "outlook": layout.OUTLOOK,
        "plan_result": layout.PLAN_RESULT,
        "pack_cell": layout.CELL, "cell_output": layout.CELL_OUTPUT,
        "soh": layout.SOH,
        **({"bank": layout.bank_type(o)} if o.bank else {}),
    }  # fmt: skip
    lines, expected = [], []
    for name, kind in records.items():
        lines.append(f'printf("{name} %u\\n", (unsigned)sizeof(cellwise_{name}));')
        expected.append(f"{name} {kind.itemsize}")
        for field in kind.names:
            lines.append(
                f'printf("{name}.{field} %u\\n", (unsigned)offsetof(cellwise_{name}, {field}));'
            )
            expected.append(f"{name}.{field} {kind.fields[field][1]}")
    headers = ("<stddef.h>", "<stdio.h>", '"cellwise_cell.h"', '"cellwise_soh.h"')
    program = "".join(f"#include {name}\n" for name in headers)
    program += "int main(void)\n{\n" + "\n".join(lines) + "\nreturn 0;\n}\n"
    assert compile_and_run(tables, tmp_path, program).split("\n")[:-1] == expected


def compilers():
    for name in ("gcc", "clang"):
        if shutil.which(name):
            yield from ([name, level] for level in ("-O0", "-O1", "-O2", "-O3"))


@pytest.mark.slow
@pytest.mark.parametrize("case", ["lean", "full"])
def test_every_compiler_gives_the_bits_of_numba(case):
    tables = tables_of(case)
    drive = samples_of(curved_cell(), load_dataset("nmc_drive_b"), 1.0).records
    stepper = numba_stepper(tables)
    for flags in compilers():
        library = HostLibrary(tables, flags)
        assert library.model_bytes() == tables.to_bytes()
        for samples in (drive, stress_samples(30_000)):
            ours, theirs = library.state(), library.state()
            stepper.begin(ours, 0.9, 0.02)
            library.begin(theirs, 0.9, 0.02)
            expected = stepper.rows(ours, samples)
            assert library.rows(theirs, samples).tobytes() == expected.tobytes(), flags
            assert ours.tobytes() == theirs.tobytes()


def said(twins, state, cells, load_A, rng):
    """What every function says of a state: alike in both, finite, and nothing is changed."""
    kept = state.tobytes(), cells.tobytes()
    holds_power = bool(rng.integers(2))
    phases = np.zeros(int(rng.integers(0, 6)), layout.PHASE)
    phases["seconds"] = rng.exponential(300.0, phases.size)
    phases["load"] = load_A * rng.normal(1.0, 1.0, phases.size)
    found = {}
    for name, kind, handed, count in (
        ("power", layout.CAPABILITY, (state,), 1),
        ("remaining", layout.OUTLOOK, (state, load_A, holds_power), 1),
        ("plan", layout.PLAN_RESULT, (state, phases, phases.size, holds_power, 0.4), 1),
        ("pack_power", layout.CAPABILITY, (state, cells, CELLS), 1),
        ("cells_of", layout.CELL_OUTPUT, (state, cells, CELLS), CELLS),
    ):
        ours, theirs = (x.answer(name, kind, *handed, count=count) for x in twins)
        assert ours.tobytes() == theirs.tobytes(), name
        found[name] = np.array(ours.tolist())
        assert np.all(np.isfinite(found[name])), name
    assert (state.tobytes(), cells.tobytes()) == kept
    return found


@pytest.mark.slow
@pytest.mark.parametrize("case", ["lean beside", "full beside"])
def test_every_function_gives_the_same_finite_bits(case):
    """A pack with a history under stress: its power, what is ahead of it, its cells."""
    tables = tables_of(case)
    twins = numba_stepper(tables), HostLibrary(tables, ["gcc", "-O2"])
    rng = np.random.default_rng(11)
    pairs = [(twin.state(), np.zeros(CELLS, layout.CELL)) for twin in twins]
    for twin, (state, cells) in zip(twins, pairs, strict=True):
        twin.begin(state, 0.8, 0.02)
        assert not twin.call("set_health", state, 0.93, 1.2)
        twin.call("start_cells", cells, CELLS)
    state, cells = pairs[0]
    samples = stress_samples(4000)
    cell_V = samples["voltage_V"][:, None] + rng.normal(0.0, 0.01, (4000, CELLS))
    bad = rng.random(cell_V.shape) < 0.02
    cell_V[bad] = rng.choice([np.nan, np.inf, -1.0, 3.9], np.count_nonzero(bad))
    seen = []
    for rows in np.array_split(np.arange(4000), 400):
        if rows[0] % 1000 == 990:  # a bit flips
            state["ss"], pairs[1][0]["ss"] = np.nan, np.nan
            cells["soc"][2], pairs[1][1]["soc"][2] = np.nan, np.nan
        outputs = [
            twin.pack_rows(*pair, samples[rows].copy(), cell_V[rows]).tobytes()
            for twin, pair in zip(twins, pairs, strict=True)
        ]
        assert outputs[0] == outputs[1]
        assert [x.tobytes() for x in pairs[0]] == [x.tobytes() for x in pairs[1]]
        load_A = float(rng.choice([-1.0, 0.0, 0.5, 3.0, 12.0, 40.0]))
        seen.append(said(twins, state, cells, load_A, rng))
    of = {name: np.concatenate([one[name] for one in seen]) for name in seen[0]}
    for name in ("power", "pack_power"):
        assert np.all(of[name][:, 1::2] <= of[name][:, ::2])
        assert np.all(of[name] >= 0.0)
        assert np.ptp(of[name][:, 0]) > 0.0
    low, high = of["remaining"][:, 1], of["remaining"][:, 2]
    assert np.all((low <= of["remaining"][:, 0]) & (of["remaining"][:, 0] <= high))
    assert np.all(low >= 0.0)
    assert np.ptp(high) > 0.0
    soc, chance = of["plan"][:, 0], of["plan"][:, 7]
    assert np.all((of["plan"][:, 1] <= soc) & (soc <= of["plan"][:, 2]))
    assert np.all((chance >= 0.0) & (chance <= 1.0))
    assert np.ptp(chance) > 0.9
    assert np.all((of["cells_of"][:, 0] >= 0.0) & (of["cells_of"][:, 0] <= 1.0))
    for load_A in (math.nan, math.inf, -math.inf, 1e30):
        assert np.all(said(twins, state, cells, load_A, rng)["remaining"] == 0.0)
    for _ in range(300):  # memory that lost its content
        for record in (state, cells):
            record.view(np.uint8)[:] = rng.integers(0, 256, record.nbytes)
        found = said(twins, state, cells, 3.0, rng)
        assert all(np.all(found[n] == 0.0) for n in found if n != "cells_of")


def flipped(state):
    """The state with each of its bits flipped, and with three bits of different words."""
    words = state.view(np.uint32)
    rng = np.random.default_rng(16)
    some = [rng.choice(words.size, 3, replace=False) for _ in range(500)]
    bits = [([w], [b]) for w in range(words.size) for b in range(32)]
    for at, bit in [*bits, *((w, rng.integers(0, 32, 3)) for w in some)]:
        changed = words.copy()
        changed[at] ^= np.left_shift(np.uint32(1), np.array(bit, dtype=np.uint32))
        yield changed.view(state.dtype)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["lean", "full"])
@pytest.mark.parametrize("ran", [7, 400], ids=["early", "settled"])
def test_soc_variance_is_never_negative_after_flipped_bits(case, ran):
    """Whatever bit a stored state has lost; a load with rests goes on."""
    tables = tables_of(case)
    python, c = numba_stepper(tables), HostLibrary(tables)
    state = python.state()
    python.begin(state, 0.6, 0.01)
    k = np.arange(ran + 6)
    samples = np.zeros(k.size, dtype=layout.INPUT)
    samples["current_A"] = np.where(k % 20 < 12, 3.0, 0.0)
    samples["voltage_V"] = 3.7 - samples["current_A"] / 60.0 + 0.001 * (k % 3)
    samples["temperature_C"] = 25.0
    samples["sequence"] = k
    python.rows(state, samples[:ran])
    for one in flipped(state):
        twin = one.copy()
        out = python.rows(one, samples[ran:])
        assert np.all(np.isfinite(out["soc_variance"]))
        assert np.all(out["soc_variance"] >= 0.0)
        assert np.all((out["soc"] >= 0.0) & (out["soc"] <= 1.0))
        assert c.rows(twin, samples[ran:]).tobytes() == out.tobytes()
        assert twin.tobytes() == one.tobytes()


def test_subnormals_survive():
    """A library built with -Ofast anywhere in the process would flush them to zero."""
    tiny = np.float32(1e-42)
    assert tiny * np.float32(0.5) > 0
    stepper = numba_stepper(tables_of("lean"))
    state = stepper.state()
    stepper.begin(state, 0.5, 0.02)
    state["p12"], state["evidence"] = tiny, 2
    sample = np.zeros(1, layout.INPUT)
    sample["voltage_V"], sample["sequence"] = np.nan, 1
    stepper.rows(state, sample)
    assert 0 < state["p12"][0] < 1e-40


@pytest.mark.parametrize("case", ["plain", pytest.param("full", marks=pytest.mark.slow)])
def test_a_bank_has_the_same_bits_and_whatever_stands_in_its_memory_is_finite(case):
    """Bytes at random in the record of the bank and in its states; 5 components."""
    tables = tables_of(case)
    twins = numba_stepper(tables), HostLibrary(tables)
    samples = samples_of(curved_cell(), load_dataset("nmc_drive_b"), 1.0).records[:200]
    rng = np.random.default_rng(3)
    resets = 0
    for trial in range(150):
        banks = [twin.start_bank(5, 0.4, 0.0225) for twin in twins]
        first = int(rng.integers(0, 100))
        for twin, bank in zip(twins, banks, strict=True):
            twin.bank_rows(*bank, samples[:first])
        for part in range(2):
            bytes_of = [bank[part].view(np.uint8).reshape(-1) for bank in banks]
            for _ in range(int(rng.integers(0, 6)) if trial else 0):
                place, value = rng.integers(bytes_of[0].size), rng.integers(256)
                for memory in bytes_of:
                    memory[place] = value
        numba, c = (
            twin.bank_rows(*bank, samples[first : first + 40])
            for twin, bank in zip(twins, banks, strict=True)
        )
        assert numba.tobytes() == c.tobytes()
        assert banks[0][1].tobytes() == banks[1][1].tobytes()
        for name in ("soc", "soc_variance", "voltage_V", "innovation_V", "innovation_variance_V2"):
            assert np.all(np.isfinite(c[name])), name
        assert np.all((c["soc"] >= 0.0) & (c["soc"] <= 1.0))
        assert np.all(c["soc_variance"] >= 0.0)
        resets += bool(np.any(c["status"] & Status.STATE_RESET))
    assert resets > 0
