"""The front door: files as they lie there, through the commands, as a new user types them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cellwise.cell.stock import stock_model
from cellwise.cli import main
from cellwise.logs import CellLog, write_log
from cellwise.logs.writing import write_columns
from virtual_tester import logged

STOCK = "lmo-pouch"
CELLS = 8
PAUSE_S = 20_000.0


def car(soc0: float, seed: int) -> CellLog:
    """Some minutes of a drive, as a lossless car logs them: 5 s, no counter, under load."""
    rng = np.random.default_rng(seed)
    model = stock_model(STOCK)
    time = 5.0 * np.arange(300)
    current = model.capacity_Ah * np.repeat(rng.uniform(-0.3, 1.0, 60), 5)
    log = CellLog(time, current, np.full(300, 3.9), np.full(300, 25.0))
    return logged(model, log, soc0)


def day(folder: Path, name: str, seed: int) -> Path:
    """A day of a car: two drives, charged between, cells in mV beside the pack's voltage."""
    rng = np.random.default_rng(seed)
    drives = car(0.5, seed), car(0.8, seed + 100)
    volts = np.concatenate([d.voltage_V for d in drives])
    cells = volts[:, None] + rng.normal(0.0, 0.002, (volts.size, CELLS))
    table = {
        "time_s": np.concatenate(
            [drives[0].time_s, drives[0].time_s[-1] + PAUSE_S + drives[1].time_s]
        ),
        "segment": np.repeat([0.0, 1.0], 300),
        "current_A": np.concatenate([d.current_A for d in drives]),
        "voltage_V": CELLS * volts,
        "temperature_1_C": np.full(600, 24.0),
        "temperature_2_C": np.full(600, 26.0),
        **{f"cell_{k + 1:02d}_mV": 1e3 * cells[:, k] for k in range(CELLS)},
    }
    return Path(write_columns(table, folder / name))


@pytest.fixture(scope="module")
def month(tmp_path_factory) -> Path:
    """A folder of days, and what else lies in such a folder."""
    folder = tmp_path_factory.mktemp("month")
    for k in (2, 1, 3):
        day(folder, f"car_2024-06-0{k}.parquet", k)
    (folder / "index.csv").write_text("name,km\ncar_2024-06-01,12\n")
    (folder / "README.md").write_text("a car\n")
    return folder


def test_a_pack_s_file_is_its_mean_cell_where_one_cell_is_asked_for(month, run_json):
    log = str(month / "car_2024-06-01.parquet")
    found = run_json("inspect", log)
    assert 3.0 < found["voltage_V"]["min"] < found["voltage_V"]["max"] < 4.3
    assert found["temperature_C"] == {"min": 25.0, "max": 25.0}
    assert any("`cellwise pack`" in notice for notice in found["notices"])
    assert run_json("simulate", "--model", STOCK, log)["rmse_V"] < 0.01
    halved = run_json("inspect", log, "--series", str(CELLS // 2))
    assert halved["voltage_V"]["min"] > 6.0  # a stated number is believed


def test_a_simulation_begins_again_after_a_pause_that_nobody_counted(month, run_json):
    log = str(month / "car_2024-06-01.parquet")
    found = run_json("simulate", "--model", STOCK, log, "--soc0", "0.5")
    assert found["max_error_V"] < 0.02
    assert any("begins again" in notice for notice in found["notices"])


def test_folders_and_patterns_are_logs_in_the_order_of_time(month, run_json, capsys):
    each = run_json("replay", "--model", STOCK, str(month))["logs"]
    # Each day has a pause that nobody counted, and is two stretches.
    assert [one["log"][:14] for one in each] == [f"car_2024-06-0{k}" for k in (1, 1, 2, 2, 3, 3)]
    life = run_json("history", "--model", STOCK, str(month / "car_*"))
    days = list(dict.fromkeys(one["log"][:14] for one in life["logs"]))
    assert days == [f"car_2024-06-0{k}" for k in (1, 2, 3)]
    capsys.readouterr()
    assert main(["pack", "--model", STOCK, str(month), "--json"]) == 0
    packed, said = capsys.readouterr()
    assert json.loads(packed)["cells"] == CELLS
    assert "index.csv" in said
    assert "README" not in said


@pytest.mark.slow
def test_a_month_of_drives_is_identified_as_it_lies_there(month, tmp_path, run_json):
    found = run_json(
        *("identify", "--drive", str(month), "--prior", STOCK, "--nominal-ah", "33"),
        *("-o", str(tmp_path / "car.json")),
    )
    assert found["fit"]["rmse_V"] < 0.005
    assert {one["log"].split(",")[0] for one in found["own_logs"]} == {
        f"car_2024-06-0{k}" for k in (1, 2, 3)
    }
    verdict = run_json("diagnose", "--model", str(tmp_path / "car.json"), str(month))["verdict"]
    assert verdict in ("none", "undetermined")


def test_a_folder_without_a_log_and_a_log_to_be_overwritten_are_refused(month, tmp_path, refused):
    assert "no log in the folder" in refused("history", "--model", STOCK, str(tmp_path))
    assert "no file that matches" in refused("pack", "--model", STOCK, str(tmp_path / "*.csv"))
    own = month / "car_2024-06-01.parquet"
    said = refused("history", "--model", STOCK, str(month), "-o", str(own))
    assert "both to read and to write" in said
    assert "rows of one log" in refused(
        "replay", "--model", STOCK, str(month), "-o", str(tmp_path / "rows.csv")
    )


def test_a_first_row_without_current_is_no_rest(tmp_path, run_json):
    """A car that stands at a light has come from a load: nothing in one row says it has rested."""
    model = stock_model(STOCK)
    time = np.arange(0.0, 1200.0, 1.0)
    current = np.full(time.size, 1.5 * model.capacity_Ah)
    current[600] = 0.0
    log = CellLog(time, current, np.full(time.size, 3.9), np.full(time.size, 25.0))
    log = logged(model, log, 0.9).part(600, 1200)
    place = str(write_log(log, tmp_path / "light.parquet"))
    for command in ("simulate", "replay"):
        start = json.loads(json.dumps(run_json(command, "--model", STOCK, place)["soc0"]))
        assert "rest" not in start["how"]
        assert abs(start["value"] - 0.65) < 2 * start["std"]
