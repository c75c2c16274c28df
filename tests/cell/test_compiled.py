"""How kernels are compiled: inlined ones can be called, the first call is not silent."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

from cellwise.cell.compiled import is_compiled, kernel

PROGRAM = """
import numpy as np, cellwise as cw
soc = np.linspace(0.0, 1.0, 11)
flat = np.full(11, 0.02)
model = cw.CellModel(3.0, 3.2 + 0.9 * soc, flat, flat, 5.0 + flat, flat, 60.0 + flat)
log = cw.CellLog(time_s=np.arange(9.0), current_A=np.ones(9), voltage_V=np.full(9, 3.7))
cw.simulate(model, log, soc0=0.5)
cw.simulate(model, log, soc0=0.5)
"""


@pytest.mark.slow
def test_the_first_call_says_that_it_compiles_and_the_next_is_silent(tmp_path):
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    env.pop("CELLWISE_QUIET", None)
    said = [
        subprocess.run(
            [sys.executable, "-c", PROGRAM], env=env, capture_output=True, text=True, check=True
        ).stderr
        for _ in range(2)
    ]
    assert said[0].count("compiling the simulation") == 1
    assert said[1] == ""


NO_PLACE = """
import sys
from numba.core.caching import CacheImpl
CacheImpl._locator_classes = []  # a read-only installation without a home: no locator available
from cellwise.cell.compiled import inline, kernel, rows
plus = inline(lambda x: x + 1.0)
twice = kernel(lambda x: 2.0 * x)
assert twice(3.0) == 6.0
assert rows(lambda x: x * x)(3.0) == 9.0
"""


@pytest.mark.slow
def test_without_a_place_for_a_cache_it_compiles_and_says_so_once():
    env = {k: v for k, v in os.environ.items() if k != "CELLWISE_QUIET"}
    done = subprocess.run(
        [sys.executable, "-c", NO_PLACE], env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("no place to keep compiled kernels") == 1


USE = """
import sys
sys.path.insert(0, {folder!r})
from equations import equation
from kernels import whole
from cellwise.cell.kernel_compiler import KernelPart
assert whole(3.0) == 7.0
for compiled in equation.overloads.values():
    assert isinstance(compiled.library, KernelPart)
    assert not compiled.library._codegen._engine.is_symbol_defined(compiled.fndesc.llvm_func_name)
print(*(sum(f.stats.cache_hits.values()) for f in (equation, whole)), len(equation.overloads))
"""
EQUATION = """
from cellwise.cell.compiled import inline

@inline
def equation(x):
    return 2.0 * x
"""
WHOLE = """
from cellwise.cell.compiled import kernel
from equations import equation

@kernel
def whole(x):
    return equation(x) + {added}
"""


@pytest.mark.slow
def test_a_part_has_no_machine_code_of_its_own_and_is_kept_for_the_next_kernel(tmp_path):
    """A process compiles both, one finds the kernel, one another kernel's part alone."""
    (tmp_path / "equations.py").write_text(EQUATION)
    said = []
    for added in ("1.0", "1.0", "0.5 + 0.5"):
        (tmp_path / "kernels.py").write_text(WHOLE.format(added=added))
        program = USE.format(folder=str(tmp_path))
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        said.append(done.stdout.split())
    assert said == [["0", "0", "1"], ["0", "1", "0"], ["1", "0", "1"]]


VERSION_TO_COME = """
import numba
numba.__version__ = "99.0.0"
from cellwise.cell import compiled
assert "cellwise.cell.kernel_compiler" not in __import__("sys").modules
"""
VOLTAGES = """
print(cw.simulate(model, log, soc0=0.5).voltage_V.tobytes().hex())
"""


@pytest.mark.slow
def test_an_untried_numba_compiles_by_itself_to_the_same_bits(tmp_path):
    bits = set()
    for before in ("", VERSION_TO_COME):
        env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / str(len(before)))}
        program = before + PROGRAM + VOLTAGES
        done = subprocess.run(
            [sys.executable, "-c", program], env=env, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        bits.add(done.stdout)
    assert len(bits) == 1


@pytest.mark.parametrize(
    "kept", [b"cno_such_module\nGone\n.", b"", b"\x80\x04K\x01."], ids=["moved", "cut", "other"]
)
def test_what_another_version_kept_is_made_again(tmp_path, kept):
    function = kernel(_twice)
    file = function._cache._cache_file
    file._index_path = str(tmp_path / "kept.nbi")
    Path(file._index_path).write_bytes(pickle.dumps(file._version) + kept)
    assert not is_compiled(function)
    assert function(2.0) == 4.0


def _twice(x: float) -> float:
    return 2.0 * x
