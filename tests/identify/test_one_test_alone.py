"""One test of a cell and no other, through the command: a model, its range, and what it misses.

Judged on logs that took no part. A made cell has four branches, which no model holds.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model import CellModel
from cellwise.cell.model_file import read_model
from cellwise.cell.simulate import simulate
from cellwise.cli import main
from cellwise.logs import read_log, write_log
from rich_cell import Logger, drive, rich_nmc, run

pytestmark = pytest.mark.slow

CELL = rich_nmc(3.0)
PANASONIC = "panasonic_18650pf"
JUDGED = ("us06", "hwfta", "nn")


def identified(given, folder, capsys) -> tuple[CellModel, dict]:
    """What the command makes of its arguments."""
    model = folder / "model.json"
    assert main(["identify", *given, "-o", str(model), "--json"]) == 0
    return read_model(model), json.loads(capsys.readouterr().out)


def missed_V(model: CellModel, logs) -> float:
    errors = [simulate(model, log, 1.0).rmse_above_10pct_V for log in logs]
    return float(np.sqrt(np.mean(np.square(errors))))


def check_range(said: dict, log, capacity_Ah: float) -> None:
    """The range is that of the log: no wider, and hardly narrower."""
    low, high = said["validity"]["current_A"]
    assert log.current_A.min() - 0.01 <= low <= high <= log.current_A.max() + 0.01
    assert high - low > 0.8 * np.ptp(log.current_A)
    reached = np.ptp(log.counted_charge_Ah()) / capacity_Ah
    assert np.ptp(said["validity"]["soc"]) == pytest.approx(reached, abs=0.03)


def test_one_drive_of_a_made_cell(tmp_path, capsys):
    """Drives that it has not seen within 15 mV; valid where it went."""
    log = run(CELL, drive(CELL, seed=5), 1.0, Logger(1.0), seed=3, name="test").log
    file = tmp_path / "test.csv.gz"
    write_log(replace(log, soc0=None), file)
    given = ["--drive", f"{file}@soc0=1", "--nominal-ah", "3"]
    model, said = identified(given, tmp_path, capsys)
    check_range(said, log, model.capacity_Ah)
    drives = [run(CELL, drive(CELL, seed=s), 1.0, Logger(1.0), seed=s).log for s in (7, 11)]
    assert missed_V(model, drives) < 0.015


@pytest.mark.parametrize(
    ("kind", "name", "most_V"),
    [("--hppc", "hppc_p25", 0.025), ("--drive", "drive_p25_cycle_2", 0.035)],
)
def test_one_test_of_the_panasonic(kind, name, most_V, real_data, tmp_path, capsys):
    folder = real_data / PANASONIC
    file = folder / f"{name}.csv.gz"
    stated = f"{file}@soc0=1" if kind == "--drive" else str(file)
    model, said = identified([kind, stated, "--nominal-ah", "2.9"], tmp_path, capsys)
    check_range(said, read_log(file), model.capacity_Ah)
    drives = [read_log(folder / f"drive_p25_{n}.csv.gz") for n in JUDGED]
    assert missed_V(model, drives) < most_V
