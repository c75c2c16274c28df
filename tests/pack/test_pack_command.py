"""`cellwise pack`: the keys that outside programs rely on, files whole or not at all, refusals."""

from __future__ import annotations

import json

import numpy as np
import pytest

from cellwise.cli import main
from cellwise.logs.writing import read_rows, write_columns
from emulated_packs import Fault, emulated_pack


@pytest.fixture(scope="module")
def pack_file(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pack")
    _, log = emulated_pack(6, Fault(cell=4, resistance=0.4), hours=1.0)
    return write_columns(log.columns(), folder / "pack_2024-05-01.parquet")


def test_the_keys_of_the_contract(pack_file, capsys, tmp_path):
    out, state = tmp_path / "cells.parquet", tmp_path / "state.json"
    arguments = ["pack", "--model", "nca-18650", str(pack_file), "--json"]
    assert main([*arguments, "-o", str(out), "--state", str(state)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["cells"] == 6
    assert set(found["soc"]) == {"min", "mean", "max"}
    assert found["soc"]["min"] <= found["soc"]["mean"] <= found["soc"]["max"]
    assert set(found["weakest"]) == {"by_soc", "by_capacity", "by_resistance"}
    assert found["weakest"]["by_resistance"] == "cell_05"
    assert [row["name"] for row in found["per_cell"]] == [f"cell_{k:02d}" for k in range(1, 7)]
    keys = {"soc", "soc_std", "capacity_Ah", "capacity_std_Ah", "resistance_scale"}
    keys |= {"resistance_std", "voltage_rmse_V"}
    assert all(keys <= set(row) for row in found["per_cell"])
    assert [c["cell"] for c in found["causes"]] == ["cell_05"]
    assert found["causes"][0]["name"] == "resistance_scale"
    assert found["usable_Ah"] > 0.0
    assert isinstance(found["notices"], list)
    assert read_rows(out)["name"] == [f"cell_{k:02d}" for k in range(1, 7)]
    assert main([*arguments, "--state", str(state)]) == 0  # goes on from what it wrote
    assert json.loads(capsys.readouterr().out)["cells"] == 6


def test_strings_in_parallel_give_their_sum(tmp_path, capsys):
    _, log = emulated_pack(4, hours=0.5)
    found = []
    for strings in (1, 2):
        columns = dict(log.columns()) | {"current_A": strings * log.mean.current_A}
        path = write_columns(columns, tmp_path / f"pack_{strings}.parquet")
        arguments = ["pack", "--model", "nca-18650", str(path), "--json"]
        assert main([*arguments, "--parallel", str(strings)]) == 0
        found.append(json.loads(capsys.readouterr().out))
    for key in ("usable_Ah", "usable_Wh", "left_Ah", "balanced_Ah"):
        assert found[1][key] == pytest.approx(2.0 * found[0][key], rel=1e-6)
    assert found[1]["per_cell"][0]["capacity_Ah"] == found[0]["per_cell"][0]["capacity_Ah"]


def test_inspect_says_what_a_pack_holds(pack_file, tmp_path, capsys):
    columns = dict(read_rows(pack_file)) | {"temperature_1_C": 20.0, "temperature_2_C": 22.0}
    del columns["temperature_C"]
    rows = len(columns["time_s"])
    columns = {k: np.broadcast_to(v, rows) for k, v in columns.items()}
    assert main(["inspect", str(write_columns(columns, tmp_path / "two.parquet"))]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "6 cells and 2 temperatures" in said
    assert "`cellwise pack`" in said
    assert "21 to 21 degC" in said


def test_a_pack_for_people_names_the_cell(pack_file, capsys):
    assert main(["pack", "--model", "nca-18650", str(pack_file)]) == 0
    shown = capsys.readouterr().out
    assert "resistance_scale: cell_05" in shown


def test_a_log_of_one_cell_is_refused_with_the_way_out(tmp_path, capsys):
    _, log = emulated_pack(2, hours=0.2)
    path = write_columns(
        {"time_s": log.mean.time_s, "current_A": log.mean.current_A, "voltage_V": log.cell_V[:, 0]},
        tmp_path / "cell.csv",
    )
    assert main(["pack", "--model", "nca-18650", str(path)]) == 2
    said = capsys.readouterr().err
    assert "cell_01_V" in said
    assert "cellwise replay" in said


def test_a_state_that_is_none_is_refused_and_stays(pack_file, tmp_path, capsys):
    state = tmp_path / "state.json"
    state.write_text("{}")
    arguments = ["pack", "--model", "nca-18650", str(pack_file), "--state", str(state)]
    assert main(arguments) == 2
    assert state.read_text() == "{}"
    assert "an earlier run" in capsys.readouterr().err


def test_a_wrong_sign_is_said_first_and_withholds(pack_file, tmp_path, capsys):
    columns = dict(read_rows(pack_file))
    columns["current_A"] = [-x for x in columns["current_A"]]
    told = ["pack", "--model", "nca-18650", str(write_columns(columns, tmp_path / "w.parquet"))]
    assert main(told) == 0
    said = capsys.readouterr().out
    first = said.splitlines()[0]
    assert "THE SIGN OF THE CURRENT LOOKS WRONG" in first
    assert "--sign charge-positive" in first
    assert "withheld" in first
    assert said.count("THE SIGN OF THE CURRENT") == 1
    assert "nan" not in said
    assert main([*told, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["usable_Ah"] is None
    assert found["causes"] == []
    assert main([*told, "--sign", "charge-positive", "--json"]) == 0
    right = json.loads(capsys.readouterr().out)
    assert right["usable_Ah"] > 0.0
    assert [c["cell"] for c in right["causes"]] == ["cell_05"]


def test_one_day_that_cannot_serve_ends_nothing(tmp_path, capsys):
    """A first row alone before a pause is part of its day; a day of other cells is left out."""
    for day in range(1, 5):
        _, log = emulated_pack(4, hours=0.5, seed=day)
        columns = dict(log.columns())
        if day == 2:
            columns["time_s"] = np.where(np.arange(len(log)) > 0, columns["time_s"] + 4000.0, 0.0)
        if day == 3:
            del columns["cell_04_V"]
        write_columns(columns, tmp_path / f"drive_2024-05-0{day}.csv")
    assert main(["pack", "--model", "nca-18650", str(tmp_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [one["log"][-2:] for one in found["logs"]] == ["01", "02", "04"]
    assert any(n.startswith("left out: 3 cells in 'drive_2024-05-03'") for n in found["notices"])
