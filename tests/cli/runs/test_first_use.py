"""The first command: what the next ones need is compiled beside it, and waited for."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import pytest

from cellwise import first_use
from cellwise.cell import compiled
from cellwise.cell.compiled import announce, others_compile


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """Marks of processes that compile lie in a folder of the test."""
    monkeypatch.setattr(compiled.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.delenv(compiled.QUIET, raising=False)
    return tmp_path


@pytest.fixture
def never_compiled():
    """What numba would hand out of a kernel that its cache does not hold."""
    file = SimpleNamespace(_load_index=dict)
    return SimpleNamespace(__name__="rows", overloads={}, _cache=SimpleNamespace(_cache_file=file))


def test_a_kernel_that_another_process_compiles_is_waited_for(elsewhere, never_compiled, capsys):
    mark = others_compile()
    mark.write_text("other rows")
    threading.Timer(0.4, mark.unlink).start()
    began = time.monotonic()
    announce(never_compiled, "a test")
    assert time.monotonic() - began > 0.3
    assert "compiling a test" in capsys.readouterr().err


def test_what_nobody_makes_is_not_waited_for(elsewhere, never_compiled):
    others_compile().write_text("other")
    began = time.monotonic()
    announce(never_compiled, "a test")
    assert time.monotonic() - began < 1.0


def test_the_mark_of_a_process_that_was_killed_stops_nobody(elsewhere, never_compiled):
    mark = others_compile()
    mark.write_text("other rows")
    long_ago = time.time() - 2.0 * compiled.LONGEST_S
    os.utime(mark, (long_ago, long_ago))
    began = time.monotonic()
    announce(never_compiled, "a test")
    assert time.monotonic() - began < 1.0


def test_it_is_started_once_and_only_where_nothing_is_compiled(elsewhere, monkeypatch):
    started = []
    monkeypatch.setattr(first_use.subprocess, "Popen", lambda *a, **k: started.append(a))
    monkeypatch.setattr(first_use, "is_compiled", lambda _: False)
    assert first_use.begin()
    assert not first_use.begin()  # it runs
    others_compile().unlink()
    monkeypatch.setattr(first_use, "is_compiled", lambda _: True)
    assert not first_use.begin()
    assert len(started) == 1


@pytest.mark.slow
def test_after_it_the_usual_kernels_are_compiled(tmp_path):
    """In a place of its own; the mark goes when it is done."""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "TMPDIR": str(tmp_path)}
    subprocess.run([sys.executable, "-m", "cellwise.first_use"], env=env, check=True)
    seen = (
        "from cellwise.cell.compiled import is_compiled, others_compile\n"
        "from cellwise.estimate.filters.kalman_kernels import adaptive_rows\n"
        "from cellwise.estimate.filters.kalman_kernels import kalman_rows\n"
        "from cellwise.forecast.log_kernels import forecast_rows\n"
        "kernels = adaptive_rows, kalman_rows, forecast_rows\n"
        "print(*(is_compiled(k) for k in kernels), others_compile().exists())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", seen], env=env, check=True, capture_output=True, text=True
    )
    assert done.stdout.split() == ["True"] * 3 + ["False"]
