"""numba and C: the same layout, the same bytes in the model, the same bits out of every step."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from cellwise.data import load_dataset
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.layout import (
    CAPABILITY,
    INPUT,
    OUTPUT,
    constant_type,
    row_type,
    state_type,
)
from cellwise.estimate.fixed.stepper import numba_stepper
from example_cells import curved_cell
from firmware_cases import compile_and_run, stress_samples, tables_of

pytest.importorskip("cffi")
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
CASES = ["lean", "plain", "slow", "transfer", "surface", "validity", "full", "full power"]


@needs_gcc
@pytest.mark.parametrize("case", CASES)
def test_layouts_are_the_compilers(case, tmp_path):
    tables = tables_of(case)
    o = tables.options
    records = {
        "state": state_type(o), "constants": constant_type(o), "row": row_type(o),
        "input": INPUT, "output": OUTPUT, "capability": CAPABILITY,
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
    program = '#include <stddef.h>\n#include <stdio.h>\n#include "cellwise_cell.h"\n'
    program += "int main(void)\n{\n" + "\n".join(lines) + "\nreturn 0;\n}\n"
    assert compile_and_run(tables, tmp_path, program).split("\n")[:-1] == expected


@needs_gcc
@pytest.mark.slow
@pytest.mark.parametrize("case", ["lean", "full"])
def test_the_same_bits(case):
    from cellwise.export.firmware import HostLibrary

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
            assert ours.tobytes() == theirs.tobytes()
            expected = stepper.rows(ours, samples)
            assert library.rows(theirs, samples).tobytes() == expected.tobytes(), flags
            assert ours.tobytes() == theirs.tobytes()


def compilers():
    for name in ("gcc", "clang"):
        if shutil.which(name):
            yield from ([name, level] for level in ("-O0", "-O1", "-O2", "-O3"))


@needs_gcc
def test_one_buffer_is_stepped_by_either():
    from cellwise.export.firmware import HostLibrary

    tables = tables_of("lean")
    stepper, library = numba_stepper(tables), HostLibrary(tables)
    samples = stress_samples(2000)
    alone, shared = library.state(), library.state()
    library.begin(alone, 0.5, 0.02)
    library.begin(shared, 0.5, 0.02)
    expected = library.rows(alone, samples)
    parts = np.array_split(samples, 40)
    found = [(stepper if k % 2 else library).rows(shared, p) for k, p in enumerate(parts)]
    assert np.concatenate(found).tobytes() == expected.tobytes()


@needs_gcc
def test_subnormals_survive():
    """A library built with -Ofast anywhere in the process would flush them to zero."""
    tiny = np.float32(1e-42)
    assert tiny * np.float32(0.5) > 0
    tables = tables_of("lean")
    stepper = numba_stepper(tables)
    state = np.zeros(1, state_type(tables.options))
    stepper.begin(state, 0.5, 0.02)
    state["p12"] = tiny
    state["evidence"] = 2
    sample = np.zeros(1, INPUT)
    sample["voltage_V"] = np.nan
    sample["sequence"] = 1
    stepper.rows(state, sample)
    assert 0 < state["p12"][0] < 1e-40
