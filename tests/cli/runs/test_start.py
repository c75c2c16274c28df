"""cellwise start: a folder as it lies there, what each file is, the commands, and their page."""

from __future__ import annotations

import json
import shlex
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from cellwise import load_dataset
from cellwise.cli import main
from cellwise.cli import start as command
from cellwise.data import datasets_folder
from cellwise.logs.writing import write_columns

NMC = datasets_folder() / "nmc"
# What the measured cells' files are, by how their own makers named them.
MEASURED = {
    "nissan_leaf": {"hppc": "hppc", "cap": "capacity", "cycling": "ocv", "modules": "pack"},
    "samsung_30q_ageing": {"hppc": "hppc", "fresh_s001_discharge_c10": "ocv", "d1": "capacity"},
    "lipo_5450": {"c": "capacity"},
    "plett_a123": {
        "dyn_p25_s1": "drive",
        "dyn_p25_s2": "end",
        "ocv_p25_s1": "ocv",
        "ocv_p25_s2": "end",
    },
}


def laid_out(folder: Path, names: dict[str, str]) -> Path:
    """Files of the embedded cell under other names, and what else lies in such a folder."""
    folder.mkdir()
    for name, source in names.items():
        shutil.copy(NMC / f"{source}.parquet", folder / name)
    (folder / "README.md").write_text("a cell\n")
    (folder / "notes.csv").write_text("who,when\nme,today\n")
    return folder


def kinds(found) -> dict[str, str]:
    return {Path(f["path"]).name: f["kind"] for f in found["files"]}


@pytest.fixture
def bench(tmp_path) -> Path:
    names = {
        "monday.parquet": "hppc", "tuesday.parquet": "ocv_c20", "wednesday.parquet": "cap_c5",
        "thursday.parquet": "drive_a", "friday.parquet": "drive_b",
    }  # fmt: skip
    return laid_out(tmp_path / "bench", names)


def test_a_cell_s_tests_are_told_by_their_content(bench, run_json, tmp_path):
    found = run_json("start", str(bench), "-o", str(tmp_path / "out"))
    assert kinds(found) == {
        "monday.parquet": "hppc", "tuesday.parquet": "ocv", "wednesday.parquet": "capacity",
        "thursday.parquet": "drive", "friday.parquet": "drive",
        "notes.csv": "unread", "README.md": "other",
    }  # fmt: skip
    assert all(0 < len(f["why"]) < 100 for f in found["files"])
    identify, replay = map(shlex.split, found["commands"])
    given = {o: Path(f).name for o, f in pairwise(identify)}
    assert given["--hppc"] == "monday.parquet"
    assert given["--ocv"] == "tuesday.parquet"
    assert given["--capacity"] == "wednesday.parquet"
    assert abs(float(given["--nominal-ah"]) / 5.0 - 1.0) < 0.1
    held_out = next(Path(a).name for a in replay if a.endswith("y.parquet"))
    assert {given["--drive"], held_out} == {"thursday.parquet", "friday.parquet"}
    assert found["missing"] == []
    assert not (tmp_path / "out").exists()


def test_it_says_which_test_is_missing(tmp_path, run_json):
    folder = laid_out(tmp_path / "few", {"one.parquet": "ocv_c20"})
    said = " ".join(run_json("start", str(folder))["missing"])
    assert "a pulse test" in said
    assert "a drive" in said
    assert "a low-rate test" not in said


def test_two_cells_in_one_folder_are_two_models(tmp_path, run_json):
    folder = laid_out(tmp_path / "two", {"nmc.parquet": "ocv_c20", "nmc_drive.parquet": "drive_a"})
    shutil.copy(datasets_folder() / "lfp" / "ocv_c20.parquet", folder / "lfp.parquet")
    found = run_json("start", str(folder))
    models = [c for c in found["commands"] if c.startswith("cellwise identify")]
    assert len(models) == 2
    assert not any("lfp" in c and "nmc" in c for c in models)


def test_a_temperature_in_a_name_alone_is_stated_and_said(tmp_path, run_json):
    folder = tmp_path / "cold"
    folder.mkdir()
    log = load_dataset("nmc_hppc_p00")
    columns = {"time_s": log.time_s, "current_A": log.current_A, "voltage_V": log.voltage_V}
    write_columns(columns, folder / "hppc_n10.parquet")
    found = run_json("start", str(folder))
    assert "hppc_n10.parquet@-10" in found["commands"][0]
    assert any("measured temperature" in m for m in found["missing"])


def test_a_pack_and_a_flight_are_known(tmp_path, run_json):
    folder = tmp_path / "mixed"
    folder.mkdir()
    drive = load_dataset("nmc_drive_a").part(0, 3000)
    cells = {f"cell_{k:02d}_mV": 1e3 * drive.voltage_V + k for k in range(1, 5)}
    write_columns(
        {"time_s": drive.time_s, "current_A": drive.current_A, **cells}, folder / "pack.parquet"
    )
    string = {
        "time_s": drive.time_s,
        "current_A": drive.current_A,
        "voltage_V": 4 * drive.voltage_V,
    }
    write_columns(string, folder / "string.parquet")
    found = run_json("start", str(folder), "--nominal-ah", "5")
    assert kinds(found) == {"pack.parquet": "pack", "string.parquet": "drive"}
    assert any(c.startswith("cellwise pack ") for c in found["commands"])
    strings = [c for c in found["commands"] if "string.parquet" in c]
    assert all("--series 4" in c for c in strings)
    assert any("--nominal-ah X" in c for c in run_json("start", str(folder))["commands"])


@pytest.mark.slow
def test_it_runs_its_commands_and_ends_on_a_page(tmp_path, capfd, monkeypatch):
    folder = laid_out(tmp_path / "drives", {"drive.parquet": "drive_c"})
    out = tmp_path / "out"
    given = ("--run", "--nominal-ah", "5", "--prior", "nmc-18650", "-o", str(out))
    assert main(["start", str(folder), *given]) == 0
    page = out / "replay.html"
    lines = capfd.readouterr().out.splitlines()
    assert [str(page) in line for line in lines if "page" in line].count(True) == 1
    assert lines[-1] == f"page to open: {page}"
    assert page.is_file()
    assert json.loads((out / "model.json").read_text())["schema_version"]
    monkeypatch.setattr(command, "_run", lambda *_, **__: None)
    assert main(["start", str(folder), *given, "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["pages"] == [str(page)]


def test_a_folder_without_a_battery_log_is_refused(tmp_path, refused):
    (tmp_path / "cells").mkdir()
    (tmp_path / "README.md").write_text("nothing\n")
    said = refused("start", str(tmp_path))
    assert "no battery log in the folder" in said
    assert "cells" in said
    assert "no folder" in refused("start", str(tmp_path / "not_there"))
    (tmp_path / "cells" / "index.csv").write_text("a,b\n1,2\n")
    assert "'index.csv'" in refused("start", str(tmp_path / "cells"), "--run")


def test_what_has_to_be_stated_is_asked_for_before_anything_runs(tmp_path, refused):
    log = load_dataset("nmc_drive_a").part(0, 2000)
    voltage = np.where(np.isfinite(log.voltage_V), log.voltage_V, 3.7)
    folder = tmp_path / "one"
    folder.mkdir()
    columns = {"time_s": log.time_s, "current_A": log.current_A, "voltage_V": voltage}
    write_columns(columns, folder / "drive.csv")
    said = refused("start", str(folder), "--run", "-o", str(tmp_path / "out"))
    assert "--nominal-ah" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize("cell", MEASURED)
def test_measured_files_are_what_their_makers_named_them(real_data, run_json, tmp_path, cell):
    folder = tmp_path / cell
    folder.mkdir()
    for begin in MEASURED[cell]:
        for place in sorted((real_data / cell).glob(f"{begin}*"))[:4]:
            shutil.copy(place, folder / place.name)
    found = run_json("start", str(folder))
    wrong = {
        name: kind
        for name, kind in kinds(found).items()
        if kind != next(k for begin, k in MEASURED[cell].items() if name.startswith(begin))
    }
    assert wrong == {}


@pytest.mark.slow
def test_native_files_are_read_and_grouped_by_cell(real_data, run_json):
    found = run_json("start", str(real_data / "native"))
    assert set(kinds(found).values()) == {"ocv", "capacity", "flight"}
    assert len([c for c in found["commands"] if c.startswith("cellwise identify")]) == 5


def swapped(folder: Path, *names: str) -> None:
    """Logs of the embedded cell, tidy but for the sign of the current."""
    folder.mkdir()
    for name in names:
        log = load_dataset(f"nmc_{name}")
        columns = {"time_s": log.time_s, "current_A": -log.current_A, "voltage_V": log.voltage_V}
        write_columns(columns, folder / f"{name}.csv")


def test_a_sign_that_every_log_contradicts_is_read_the_other_way(tmp_path, run_json):
    swapped(tmp_path / "logs", "hppc", "drive_b")
    found = run_json("start", str(tmp_path / "logs"))
    assert kinds(found) == {"hppc.csv": "hppc", "drive_b.csv": "drive"}
    assert all("charge-positive, by its voltage" in f["why"] for f in found["files"])
    assert all("--sign charge-positive" in line for line in found["commands"])


def test_a_log_whose_sign_is_another_than_its_neighbours_is_left_out(tmp_path, run_json):
    swapped(tmp_path / "logs", "drive_b")
    shutil.copy(NMC / "hppc.parquet", tmp_path / "logs")
    found = run_json("start", str(tmp_path / "logs"))
    assert kinds(found) == {"drive_b.csv": "unread", "hppc.parquet": "hppc"}
    assert not any("--sign" in line for line in found["commands"])
    (why,) = (f["why"] for f in found["files"] if f["kind"] == "unread")
    assert "--sign charge-positive" in why


def small_test(size):
    """A C/10 test of a cell of so many ampere hours: a rest, a discharge, a charge."""
    time = np.arange(0.0, 76_000.0, 60.0)
    current = np.where((time > 1800) & (time <= 36_800), 0.1, 0.0)
    current = size * np.where((time > 39_000) & (time <= 73_000), -0.1, current)
    left = 1.0 - np.cumsum(current) * 60.0 / 3600.0 / size
    voltage = 3.3 + 0.8 * left + 0.15 * np.tanh(20.0 * (left - 0.03)) - 0.05 / size * current
    return {"time_s": time, "current_A": current, "voltage_V": voltage}


@pytest.mark.parametrize("size", [0.5, 0.1, 0.004])
def test_a_small_cell_s_test_is_one(tmp_path, run_json, size):
    write_columns(small_test(size), tmp_path / "slow.csv")
    found = run_json("start", str(tmp_path))
    assert kinds(found) == {"slow.csv": "ocv"}
    assert "C/9.7" in found["files"][0]["why"]


@pytest.mark.slow
def test_a_coin_cell_is_identified(tmp_path, run_json):
    path = write_columns(small_test(0.004), tmp_path / "coin.csv")
    given = ("--ocv", str(path), "--nominal-ah", "0.004", "-o", str(tmp_path / "m.json"))
    found = run_json("identify", *given)
    assert abs(found["capacity_Ah"] - 0.0039) < 2e-4


def test_each_file_is_said_with_the_one_thing_to_do(tmp_path, run_json, capsys):
    from scipy.io import savemat

    time = np.arange(0.0, 3000.0, 2.0)
    current = np.where(time % 300 < 150, 2.0, 0.1)
    voltage = 3.9 - 0.05 * current - 1e-5 * np.cumsum(current)
    one = {"t": time, "I": current, "V": voltage}
    savemat(tmp_path / "two.mat", {"a": one, "b": one})
    write_columns({"t": time, "Strom": current, "Klemme": voltage}, tmp_path / "foreign.csv")
    rows = "".join(f"{f:.3g},0.02,-0.01\n" for f in np.geomspace(1e4, 0.1, 30))
    (tmp_path / "eis.csv").write_text(f"Frequency (Hz),Z' (Ohm),Z'' (Ohm)\n{rows}")
    (tmp_path / "pack.dbc").write_text('VERSION ""\n')
    found = run_json("start", str(tmp_path))
    said = {(Path(f["path"]).name, f["instance"]): f for f in found["files"]}
    assert {said["two.mat", k]["kind"] for k in (0, 1)} <= {"drive", "hppc"}
    assert any("two.mat@instance=0" in c for c in found["commands"])
    assert "impedance spectrum" in said["eis.csv", None]["why"]
    assert "CAN" in said["pack.dbc", None]["why"]
    why = said["foreign.csv", None]["why"]
    assert why.startswith("a log under other names: cellwise convert ")
    assert main(shlex.split(why.partition("cellwise ")[2])) == 0  # what it proposes works
    capsys.readouterr()
    again = run_json("start", str(tmp_path))
    assert kinds(again)["foreign_tidy.csv"] in ("drive", "hppc")
