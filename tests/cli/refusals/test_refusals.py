"""Bad input at the command line: exit code 2, one message, nothing written, nothing destroyed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cellwise.cli import main
from cellwise.data import datasets_folder
from cellwise.errors import InputError

HPPC = str(datasets_folder() / "nmc" / "hppc.parquet")
TIDY = "time_s,current_A,voltage_V\n"
# What is wrong with a log is tested in tests/logs; here: every command asks.
BAD_LOGS = {
    "empty": b"",
    "prose": b"Dear Sir or Madam,\nthe battery is flat.\n",
    "time runs back": (TIDY + "0,1,3.7\n5,1,3.7\n2,1,3.6\n").encode(),
    "truncated gzip": b"\x1f\x8b\x08\x00\x00\x00\x00\x00",
    "truncated parquet": b"PAR1" + b"\x00" * 40,
}


@pytest.fixture(params=BAD_LOGS)
def bad_log(request, tmp_path) -> str:
    suffix = {"truncated gzip": ".csv.gz", "truncated parquet": ".parquet"}.get(request.param)
    path = tmp_path / f"bad{suffix or '.csv'}"
    path.write_bytes(BAD_LOGS[request.param])
    return str(path)


def written(folder: Path) -> set[str]:
    return {p.name for p in folder.iterdir()}


def test_a_bad_log_is_refused_by_every_command(refused, tmp_path, bad_log, model):
    before, out = written(tmp_path), str(tmp_path / "out.csv")
    assert Path(bad_log).name.partition(".")[0] in refused("inspect", bad_log)
    refused("convert", bad_log, "-o", out)
    refused("identify", "--hppc", bad_log, "--nominal-ah", "5", "-o", str(tmp_path / "m.json"))
    refused("identify", "--drive", bad_log, "--nominal-ah", "5", "-o", str(tmp_path / "m.json"))
    refused("simulate", "--model", model, bad_log, "-o", out)
    refused("replay", "--model", model, bad_log, "-o", out)
    assert written(tmp_path) == before


@pytest.fixture
def bad_model(request, tmp_path, identified) -> str:
    path = tmp_path / "model.json"
    data = json.loads(identified.path.read_text())
    texts = {
        "version": json.dumps({**data, "schema_version": 2}),
        "negative resistance": json.dumps({**data, "r0_ohm": [[-r for r in data["r0_ohm"][0]]]}),
        "truncated": identified.path.read_text()[:5000],
    }
    path.write_text(texts[request.param])
    return str(path)


# What is wrong with a model is tested in tests/cell/test_model_file.py; here: every command asks.
@pytest.mark.parametrize(
    "bad_model", ["version", "negative resistance", "truncated"], indirect=True
)
def test_a_bad_model_is_refused(refused, bad_model, drive):
    refused("simulate", "--model", bad_model, drive)
    refused("replay", "--model", bad_model, drive)


@pytest.mark.slow
def test_a_log_that_never_rests_gives_what_a_population_leaves_open_and_says_so(run_json, tmp_path):
    """Where its OCV ends it does not show, nor its capacity: these are the prior's, and open."""
    t = np.arange(3000.0)
    wave = 2.0 + np.sin(t / 20.0)
    path = tmp_path / "busy.csv"
    rows = np.column_stack((t, wave, 4.0 - 0.05 * wave - 1e-4 * t))
    np.savetxt(path, rows, delimiter=",", header=TIDY.strip(), comments="")
    found = run_json("identify", "--hppc", str(path), "--nominal-ah", "3", "-o",
                     str(tmp_path / "m.json"))  # fmt: skip
    assert found["notices"][0].startswith("'busy' ")
    assert any("hardly anything of the OCV at SOC" in notice for notice in found["notices"])
    assert found["pulses"]["healthy"] == 0
    assert found["posterior"]["prior"].startswith("population of")
    assert found["posterior"]["std"][found["posterior"]["directions"].index("capacity_Ah")] > 0.1


def test_a_swapped_sign_is_refused_and_the_way_out_works(refused, run_json, tmp_path):
    rows = pd.read_parquet(HPPC)
    rows["current_A"] *= -1.0
    rows["ampere_hours"] *= -1.0
    path, out = tmp_path / "swapped.parquet", tmp_path / "m.json"
    rows.to_parquet(path)
    message = refused("identify", "--hppc", str(path), "-o", str(out))
    assert "--sign charge-positive" in message
    assert not out.exists()
    run_json("identify", "--hppc", str(path), "--sign", "charge-positive", "--no-refine",
             "-o", str(out))  # fmt: skip
    assert out.exists()


@pytest.mark.parametrize("name", ["nowhere/out.csv", "."])
def test_a_place_that_cannot_be_written_to_is_refused_at_once(
    refused, tmp_path, model, drive, name, monkeypatch
):
    def never(*_args, **_kwargs):
        raise AssertionError("the work was begun")

    monkeypatch.setattr("cellwise.cli.common.log_options.read_log", never)
    out = str(tmp_path / name)
    refused("convert", drive, "-o", out)
    refused("identify", "--hppc", HPPC, "-o", out)
    refused("identify", "--hppc", HPPC, "-o", str(tmp_path / "m.json"), "--report", out)
    refused("simulate", "--model", model, drive, "-o", out)
    refused("replay", "--model", model, drive, "-o", out)
    refused("replay", "--model", model, drive, "--report", out)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission(refused, tmp_path, model, drive):
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    refused("simulate", "--model", model, drive, "-o", str(locked / "a.csv"))


def test_a_failure_leaves_an_existing_model_and_its_page_alone(refused, tmp_path):
    out, page = tmp_path / "m.json", tmp_path / "page.html"
    out.write_text("precious")
    page.write_text("precious")
    refused("identify", "--hppc", HPPC, "--capacity-choice", "none such", "-o", str(out),
            "--report", str(page))  # fmt: skip
    assert out.read_text() == page.read_text() == "precious"
    assert written(tmp_path) == {"m.json", "page.html"}


def test_a_write_that_breaks_off_leaves_no_half_file(capsys, tmp_path, model, drive, monkeypatch):
    out = tmp_path / "rows.csv"
    out.write_text("precious")

    def breaks(_table, stream, *_args):
        stream.write(b"time_s,so")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pyarrow.csv.write_csv", breaks)
    assert main(["simulate", "--model", model, drive, "-o", str(out)]) == 2
    assert "No space left" in capsys.readouterr().err
    assert out.read_text() == "precious"
    assert written(tmp_path) == {"rows.csv"}


def test_interrupting_is_no_traceback(capsys, model, drive, monkeypatch):
    def stopped(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("cellwise.cli.common.log_options.read_log", stopped)
    assert main(["simulate", "--model", model, drive]) == 130
    assert "Traceback" not in capsys.readouterr().err


def test_a_bug_is_called_a_bug(capsys, model, drive, monkeypatch):
    def broken(*_args, **_kwargs):
        raise RuntimeError("wires crossed")

    monkeypatch.setattr("cellwise.cli.common.log_options.read_log", broken)
    assert main(["simulate", "--model", model, drive]) == 1
    message = capsys.readouterr().err
    assert "wires crossed" in message
    assert "--debug" in message
    assert "Traceback" not in message


@pytest.mark.parametrize(
    "arguments", [["inspect", "none.csv"], ["simulate", "--model", "none.json", "none.csv"]]
)
def test_debug_shows_where_it_was_refused(arguments):
    with pytest.raises(InputError):
        main([*arguments, "--debug"])


def test_missing_values_in_the_middle_are_no_bad_input(run_json, model, drive, tmp_path):
    rows = pd.read_parquet(drive)
    rows.loc[1000:1200, "voltage_V"] = np.nan
    rows.loc[3000:3050, "current_A"] = np.nan
    path = tmp_path / "holes.csv"
    rows.to_csv(path, index=False)
    found = run_json("simulate", "--model", model, str(path))
    assert found["samples"] == len(rows) - 201
    judged = run_json("replay", "--model", model, str(path), "--reference-capacity-ah", "5.1532")
    assert judged["settled"]["rmse"] < 0.02


@pytest.mark.parametrize("stamp", ["", "inf", "nan"])
def test_a_row_without_a_time_is_left_out_and_told(run_json, tmp_path, stamp):
    path = tmp_path / "log.csv"
    rows = [f"{k},1,{3.7 - 0.001 * k}" for k in range(20)]
    rows[7] = f"{stamp},1,3.69"
    path.write_text(TIDY + "\n".join(rows) + "\n")
    found = run_json("inspect", str(path))
    assert found["samples"] == 19
    assert any("time" in notice for notice in found["notices"])


def test_a_gap_is_no_bad_input(run_json, model, drive, tmp_path):
    rows = pd.read_parquet(drive)
    path = tmp_path / "gap.parquet"
    pd.concat([rows.iloc[:2500], rows.iloc[2800:]]).to_parquet(path)
    assert len(run_json("inspect", str(path))["gaps"]) == 1
    judged = run_json("replay", "--model", model, str(path), "--reference-capacity-ah", "5.1532")
    assert judged["settled"]["rmse"] < 0.02


def test_a_closed_pipe_is_no_error():
    command = f"{sys.executable} -c 'from cellwise.cli import main; main()' data list | head -1"
    done = subprocess.run(
        command, shell=True, capture_output=True, text=True, check=False, timeout=60
    )
    assert "Traceback" not in done.stderr
    assert "Broken" not in done.stderr
