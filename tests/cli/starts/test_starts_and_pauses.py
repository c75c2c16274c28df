"""Where a log begins, and what lies behind a pause, by the commands on files as they lie there."""

from __future__ import annotations

import json

import numpy as np
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pytest

from cellwise import read_log
from cellwise.cli import main
from cellwise.logs.writing import write_columns

PAUSE_S = 7200.0


@pytest.fixture
def paused(drive, tmp_path):
    """A drive's late part, two hours that nobody logged, its early part: charged meanwhile."""
    log = read_log(drive)
    rows = {"late": slice(-2500, None), "early": slice(0, 2500)}
    time_s = [log.time_s[r] - log.time_s[r][0] for r in rows.values()]
    time_s[1] = time_s[1] + time_s[0][-1] + PAUSE_S
    columns = {"time_s": np.concatenate(time_s)}
    for name in ("current_A", "voltage_V", "temperature_C"):
        columns[name] = np.concatenate([getattr(log, name)[r] for r in rows.values()])
    path = tmp_path / "day.csv"
    write_columns(columns, path)
    return str(path)


def test_replay_begins_again_after_a_pause_that_nobody_counted(model, paused, run_json, tmp_path):
    out = tmp_path / "rows.parquet"
    found = run_json("replay", "--model", model, paused, "-o", str(out))
    late, early = found["logs"]
    assert early["soc0"]["value"] - late["soc_final"] > 0.3
    assert found["soc_final"] == early["soc_final"]
    simulated = run_json("simulate", "--model", model, paused)
    assert simulated["rmse_V"] < 0.03
    rows = pq.read_table(out).to_pandas()
    assert len(rows) == late["samples"] + early["samples"]
    assert np.all(np.diff(rows["time_s"]) > 0.0)


def test_a_folder_of_days_is_one_table_of_all_stretches(model, paused, capsys, tmp_path):
    assert main(["replay", "--model", model, str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "ekf on 2 logs" in said
    assert said.count("final SOC") == 1


def test_history_takes_each_stretch_for_itself(model, paused, run_json):
    found = run_json("history", "--model", model, paused)
    assert len(found["logs"]) == 2
    assert found["logs"][1]["soc_start"] - found["logs"][0]["soc_end"] > 0.3


def test_a_temperature_that_nobody_measured_is_said_as_assumed(paused, run_json, tmp_path):
    table = pacsv.read_csv(paused)
    path = tmp_path / "cold.csv"
    pacsv.write_csv(table.drop_columns(["temperature_C"]), path)
    for command in ("simulate", "replay"):
        arguments = (command, "--model", "nmc-18650", "--capacity-ah", "5")
        said = run_json(*arguments, str(path))["notices"]
        assert any("degC is assumed" in n for n in said), said
        said = run_json(*arguments, f"{path}@10")["notices"]
        assert not any("is assumed" in n for n in said), said


def test_a_first_row_that_stands_alone_before_a_pause_ends_no_command(
    model, drive, run_json, tmp_path
):
    log = read_log(drive).part(0, 1500)
    columns = {n: getattr(log, n) for n in ("time_s", "current_A", "voltage_V", "temperature_C")}
    columns["time_s"] = np.where(np.arange(1500) > 0, log.time_s + PAUSE_S, log.time_s[0])
    path = str(write_columns(columns, tmp_path / "alone.csv"))
    for command in ("simulate", "replay", "diagnose"):
        assert run_json(command, "--model", model, path)
    assert run_json("simulate", "--model", model, path)["rmse_V"] < 0.03


def test_of_a_folder_what_cannot_serve_is_left_out_and_said(model, drive, tmp_path, capsys):
    log = read_log(drive).part(0, 1500)
    for k, cells in enumerate((1, 4, 1)):
        columns = {n: getattr(log, n) for n in ("time_s", "current_A")}
        write_columns(columns | {"voltage_V": cells * log.voltage_V}, tmp_path / f"d{k}.csv")
    for command in ("simulate", "replay"):
        assert main([command, "--model", model, str(tmp_path)]) == 0
        said = capsys.readouterr()
        assert "left out: a voltage of typically" in said.err
        assert "'d1'" in said.err
        assert "d2" in said.out


@pytest.mark.parametrize(("soc0", "held"), [("-0.002", 0.0), ("1.004", 1.0)])
def test_a_start_just_beyond_empty_or_full_is_held_there_and_said(
    drive, tmp_path, capsys, soc0, held
):
    told = ["simulate", "--model", "nmc-18650", "--capacity-ah", "5", "--json"]
    assert main([*told, drive, "--soc0", soc0]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["soc0"]["value"] == held
    assert f"a SOC of {soc0} was taken as {held:g}" in said.err
    assert main([*told, f"{drive}@soc0={soc0}"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert any(f"a SOC of {soc0} was taken as" in n for n in found["notices"])
