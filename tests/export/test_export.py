"""cellwise export: what it writes compiles without a warning, and says which model it is."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from dataclasses import replace

import pytest

from cellwise.cell.model_file import write_model
from cellwise.cell.simulate import simulate
from cellwise.cli import main
from cellwise.data import load_dataset
from cellwise.errors import InputError
from cellwise.export.accuracy import accuracy_by_grid
from cellwise.export.c_tables import STRICT_FLAGS, WARNING_FLAGS
from cellwise.export.package import check_flash, describe, model_sha256
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
        (["--dt", 1, "--points", 2], "at least 3"),
        (["--dt", 1, "--points", 100_000], "SOC points"),
        (["--dt", 1, "--flash", 100], "at most 100"),
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
    check_flash(tables, len(tables.to_bytes()))
    with pytest.raises(InputError):
        check_flash(tables, len(tables.to_bytes()) - 1)


def test_the_hash_is_that_of_the_model():
    assert model_sha256(curved_cell()) == model_sha256(curved_cell())
    assert model_sha256(curved_cell()) != model_sha256(curved_cell(capacity_Ah=3.1))


@pytest.mark.slow
def test_finer_tables_lose_less():
    model = curved_cell(201, capacity_Ah=5.1)
    log = load_dataset("nmc_drive_b").part(0, 3000)
    log = replace(log, voltage_V=simulate(model, log, 0.9).voltage_V)
    found = accuracy_by_grid(model, log, 1.0, soc0=0.9, grids=(6, 26))
    error = [row.soc_rmse for row in found]
    assert error[0] > 2 * error[1]
    assert error[2] <= 1.1 * error[1]  # nothing left to lose but rounding
    assert error[2] < 5e-4
    assert [row.flash_bytes for row in found] == sorted(row.flash_bytes for row in found)
