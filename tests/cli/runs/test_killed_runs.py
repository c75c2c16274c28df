"""A run that is killed at any stage leaves its outputs whole or not at all, and those of before."""

from __future__ import annotations

import csv
import subprocess
import sys
import time

import pytest

from cellwise import load_dataset, write_log, write_model
from example_cells import curved_cell

ROWS = 7000
STEPS = 4  # stages at which it is killed, evenly over a whole run


def started(folder, *arguments):
    command = [sys.executable, "-m", "cellwise", *arguments]
    return subprocess.Popen(
        command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
def test_a_killed_run_leaves_nothing_half_written(tmp_path):
    write_model(curved_cell(), tmp_path / "model.json")
    write_log(load_dataset("nmc_drive_b").part(0, ROWS), tmp_path / "drive.parquet")
    arguments = (
        "replay",
        "--model",
        "model.json",
        "drive.parquet",
        "--soc0",
        "0.9",
        "-o",
        "out.csv",
    )
    began = time.perf_counter()
    assert started(tmp_path, *arguments).wait() == 0
    whole_s = time.perf_counter() - began
    expected = outputs(tmp_path)
    assert expected
    clear(tmp_path)
    for k in range(STEPS):
        run = started(tmp_path, *arguments)
        time.sleep(whole_s * (k + 1) / (STEPS + 1))
        run.kill()
        run.wait()
        for name, size in outputs(tmp_path).items():
            assert name in expected, (k, name)
            assert size == pytest.approx(expected[name], rel=0.02), (k, name)
    assert started(tmp_path, *arguments).wait() == 0  # what the killed left behind is in no way
    assert set(outputs(tmp_path)) == set(expected)
    with (tmp_path / "out.csv").open(encoding="utf-8", newline="") as file:
        assert sum(1 for _ in csv.DictReader(file)) == ROWS


def outputs(folder):
    """Size of every output that has its own name; what is still being written is hidden."""
    found = [p for p in folder.rglob("*") if p.is_file() and p.name not in GIVEN]
    shown = [p for p in found if not any(q.startswith(".") for q in p.relative_to(folder).parts)]
    return {p.relative_to(folder).as_posix(): p.stat().st_size for p in shown}


GIVEN = ("model.json", "drive.parquet")


def clear(folder):
    for path in sorted(folder.rglob("*"), reverse=True):
        if path.name not in GIVEN:
            path.rmdir() if path.is_dir() else path.unlink()
