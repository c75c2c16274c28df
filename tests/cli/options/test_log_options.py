"""What a user says of a log is said in the same way to every command."""

from __future__ import annotations

import json

import numpy as np
import pytest

from cellwise.cli import main
from cellwise.cli.command_line import build_parser
from cellwise.data import datasets_folder, load_dataset
from cellwise.logs import read_log, write_log
from cellwise.logs import reading as isolated
from vehicle_files import write_ulog

pytest.importorskip("pyulog")
pytest.importorskip("cantools")

OPTIONS = ("--sign", "--series", "--parallel", "--channel", "--instance", "--dbc", "--partial")


def commands_with_a_log():
    (commands,) = (a for a in build_parser()._actions if hasattr(a, "choices") and a.choices)
    for name, parser in commands.choices.items():
        if any(action.metavar == "LOG" for action in parser._actions):
            yield pytest.param(parser, id=name)


@pytest.mark.parametrize("parser", list(commands_with_a_log()))
def test_every_command_that_takes_a_log_takes_its_options(parser):
    assert set(OPTIONS) <= set(parser._option_string_actions)


@pytest.fixture(scope="module")
def flight(tmp_path_factory, drive):
    """A drive on the embedded cell as a flight of a pack of 4 in series and 2 in parallel."""
    log = read_log(drive)
    every = slice(None, 4000)
    pack = {
        "time_s": log.time_s[every],
        "current_A": 2 * log.current_A[every],
        "voltage_V": 4 * log.voltage_V[every],
        "ampere_hours": 2 * (log.counted_charge_Ah()[every]),
        "temperature_C": log.temperature_C[every],
    }
    return str(write_ulog(tmp_path_factory.mktemp("flight") / "flight.ulg", [pack]))


@pytest.fixture(scope="module")
def tidy(tmp_path_factory, drive):
    from cellwise.logs import write_log

    place = tmp_path_factory.mktemp("tidy") / "drive.parquet"
    return str(write_log(read_log(drive).part(0, 4000), place))


PACK = ("--series", "auto", "--parallel", "2")


def test_a_flight_is_its_mean_cell_to_every_command(flight, tidy, model, run_json, tmp_path):
    found, expected = run_json("inspect", flight, *PACK), run_json("inspect", tidy)
    assert found["format"] == "px4-ulog"
    assert (found["samples"], found["sign"]) == (expected["samples"], expected["sign"])
    out = tmp_path / "flight.csv.gz"
    run_json("convert", flight, *PACK, "-o", str(out))
    one, other = read_log(out), read_log(tidy)
    np.testing.assert_allclose(one.voltage_V, other.voltage_V, atol=1e-5)
    np.testing.assert_allclose(one.current_A, other.current_A, atol=1e-4)
    for command, key, most in (("simulate", "rmse_V", 2e-5), ("replay", "soc_final", 1e-3)):
        given = (command, "--model", model, "--soc0", "0.9")
        own, wanted = run_json(*given, flight, *PACK), run_json(*given, tidy)
        assert own[key] == pytest.approx(wanted[key], abs=most)


def test_a_replay_says_what_is_left(flight, model, run_json, tmp_path):
    page = tmp_path / "page.html"
    arguments = ("replay", "--model", model, flight, *PACK, "--cutoff-v", "3.0")
    left = run_json(*arguments, "--report", str(page))["forecast"]
    low, high = left["remaining_s_band"]
    assert 0 <= low <= left["remaining_s"] <= high
    assert left["end_voltage_V"] >= 3.0 - 1e-9
    assert left["typical"]["load_A"] > 0
    assert "Remaining time and energy" in page.read_text(encoding="utf-8")


def test_columns_are_stated_on_the_command_line(tmp_path, run_json):
    path = tmp_path / "rig.csv"
    path.write_text("t,Strom,Klemme\n0,1500,3.9\n1,1500,3.8\n")
    told = ("time_s=t", "current_mA=Strom", "voltage_V=Klemme")
    found = run_json("inspect", str(path), *(x for t in told for x in ("--channel", t)))
    assert found["current_A"]["max"] == 1.5


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--dbc", "nowhere.dbc"), "no DBC file"),
        (("--instance", "3"), "no battery 3"),
    ],
)
def test_what_cannot_be_followed_is_refused_and_nothing_written(
    arguments, says, flight, refused, tmp_path
):
    out = tmp_path / "out.csv"
    assert says in refused("convert", flight, *arguments, "-o", str(out))
    assert not out.exists()


def test_a_library_that_is_missing_is_named(flight, refused, monkeypatch, tmp_path):
    """In the process that reads: a new one, which finds a library that is not there."""
    missing = "raise ModuleNotFoundError('no pyulog', name='pyulog')\n"
    (tmp_path / "pyulog.py").write_text(missing)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(isolated, "_idle", [])
    message = refused("inspect", flight)
    assert "pyulog is not installed" in message
    assert "pip install 'pyulog>=" in message


def test_an_embedded_data_set_is_read_by_its_name_and_a_file_of_that_name_first(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(["inspect", "nmc_drive_b", "--json"]) == 0
    embedded = json.loads(capsys.readouterr().out)
    assert embedded["samples"] == len(load_dataset("nmc_drive_b"))
    write_log(read_log(datasets_folder() / "nmc" / "drive_c.parquet"), tmp_path / "here.parquet")
    (tmp_path / "here.parquet").rename(tmp_path / "nmc_drive_b")
    assert main(["inspect", "nmc_drive_b", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["samples"] == len(load_dataset("nmc_drive_c"))
    assert main(["inspect", "nmc_drive_x"]) == 2
    assert "no file 'nmc_drive_x'" in capsys.readouterr().err
