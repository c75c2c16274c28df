"""One sensor file for `replay`, `live`, `export` and `certify`: the same numbers in all of them."""

from __future__ import annotations

import json
import shutil

import pytest

from cellwise.cli import main
from cellwise.data import datasets_folder

TEXT = "voltage_offset_V = 0.03\ncurrent_offset_C = 0.01\ncurrent_gain = 0.02\n"
MODEL = ["--model", "nmc-18650"]
LOG = str(datasets_folder() / "nmc" / "drive_b.parquet")
SHORT = ["--cells", "2", "--hours", "3", "--physics", "0"]
compiled = pytest.mark.skipif(
    shutil.which("cc") is None and shutil.which("gcc") is None, reason="no C compiler"
)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "sensor.toml"
    path.write_text(TEXT, encoding="utf-8")
    return ["--sensor", str(path)]


@pytest.fixture
def table(tmp_path):
    """A stream of a few samples."""
    path = tmp_path / "stream.csv"
    rows = [f"{t},{-1.0},{3.7},25" for t in range(10)]
    path.write_text("\n".join(["time_s,current_A,voltage_V,temperature_C", *rows]) + "\n")
    return path


@pytest.fixture
def ran(capsys, monkeypatch):
    """The JSON of a command."""
    monkeypatch.setattr("cellwise.export.cross.cores_here", list)

    def run(*arguments):
        main([*map(str, arguments), "--json"])
        return json.loads(capsys.readouterr().out)

    return run


def exported(ran, place, *more):
    return ran("export", *MODEL, "--dt", "5", "-o", place, *more)


@compiled
def test_every_command_takes_the_same_numbers(ran, file, table, tmp_path):
    replayed = ran("replay", *MODEL, LOG, "--dt", "5", *file)
    export = exported(ran, tmp_path / "firmware", *file)
    streamed = ran("live", *MODEL, "--source", f"csv:{table}", *file)
    judged = ran("certify", tmp_path / "firmware", *SHORT, *file)
    said = [found["sensor"] for found in (replayed, export, streamed, judged)]
    assert all(one == said[0] for one in said)
    assert said[0]["voltage_offset_V"] == 0.03
    assert said[0]["by_default"] is False


@compiled
def test_a_certificate_is_of_the_sensor_that_was_exported(ran, file, tmp_path):
    place = tmp_path / "firmware"
    export = exported(ran, place, *file)
    of_export = ran("certify", place, *SHORT)
    assert of_export["sensor"] == export["sensor"]
    assert of_export == ran("certify", place, *SHORT, *file)


@compiled
def test_without_a_file_it_is_a_car_s_and_said(ran, capsys, tmp_path):
    export = exported(ran, tmp_path / "firmware")
    judged = ran("certify", tmp_path / "firmware", *SHORT)
    replayed = ran("replay", *MODEL, LOG)
    assert export["sensor"] == judged["sensor"] == replayed["sensor"]
    assert export["sensor"]["by_default"] is True
    main(["replay", *MODEL, LOG])
    assert "sensors: a car's, as nobody stated them (--sensor)" in capsys.readouterr().out


def test_a_file_widens_the_band_of_a_replay(ran, file):
    bare, stated = (ran("replay", *MODEL, LOG, *more) for more in ((), file))
    assert stated["soc_final_std"] > bare["soc_final_std"]


def test_noise_that_is_stated_holds_over_the_sensor(ran, file, tmp_path):
    stated = exported(ran, tmp_path / "a", *file, "--noise", "offset_share=0.5")
    of_file = exported(ran, tmp_path / "b", *file)
    assert stated["noise"]["offset_share"] == 0.5
    assert stated["noise"] == of_file["noise"] | {"offset_share": 0.5}


@pytest.mark.parametrize("command", ["replay", "export", "live", "certify"])
def test_a_wrong_file_is_refused_by_every_command(command, table, tmp_path, capsys):
    path = tmp_path / "sensor.toml"
    path.write_text("voltage_offset_mV = 30\n", encoding="utf-8")
    more = {
        "replay": [*MODEL, LOG],
        "export": [*MODEL, "--dt", "5", "-o", str(tmp_path / "firmware")],
        "live": [*MODEL, "--source", f"csv:{table}"],
        "certify": [str(tmp_path)],
    }[command]
    assert main([command, *more, "--sensor", str(path)]) == 2
    assert "Did you mean 'voltage_offset_V'?" in capsys.readouterr().err
