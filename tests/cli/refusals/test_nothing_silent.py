"""Nothing overwritten, nothing silent: what is wrong with a log is said first by every command."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellwise import load_dataset, write_log
from cellwise.cli import main

RUN = [sys.executable, "-m", "cellwise"]


def spoiled_time(log):
    return {"time_s": np.repeat(log.time_s[::2], 2)[: len(log)]}


def without_half_the_voltages(log):
    return {"voltage_V": np.where(np.arange(len(log)) % 2 == 0, log.voltage_V, np.nan)}


def spike(log):
    current = log.current_A.copy()
    current[100] = 1e6
    return {"current_A": current}


def milliampere(log):
    """All values are far off: the unit is wrong, and nothing is taken out."""
    return {"current_A": 1e3 * log.current_A, "charge_Ah": None}


# What is done to a drive, and what every command has to say first.
SPOILED = {
    "every second stamp repeated": (spoiled_time, "time LOOKS WRONG"),
    "current 0 throughout": (
        lambda log: {"current_A": np.zeros(len(log)), "charge_Ah": None},
        "current LOOKS WRONG: it is 0 throughout",
    ),
    "half the voltages missing": (without_half_the_voltages, "voltage LOOKS WRONG"),
    "one spike": (spike, "1e+06 A in row 101"),
    "a stuck voltage": (
        lambda log: {"voltage_V": np.full(len(log), 3.7)},
        "voltage LOOKS WRONG: it stands still",
    ),
}


@pytest.fixture(params=SPOILED)
def spoiled(request, tmp_path):
    change, said = SPOILED[request.param]
    log = load_dataset("nmc_drive_b")
    log = replace(log, **change(log))
    return str(write_log(log, tmp_path / "spoiled.parquet")), said


def first_notice(run_json, *arguments):
    notices = run_json(*arguments)["notices"]
    assert notices
    return notices[0]


def test_a_wrong_channel_is_said_first(run_json, model, spoiled, tmp_path, capsys):
    path, said = spoiled
    out = str(tmp_path / "out.parquet")
    assert said in first_notice(run_json, "inspect", path)
    assert said in first_notice(run_json, "convert", path, "-o", out)
    assert said in first_notice(run_json, "simulate", "--model", model, path)
    assert said in first_notice(run_json, "replay", "--model", model, path)
    capsys.readouterr()
    assert main(["replay", "--model", model, path]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  !")]
    assert said in lines[0]


@pytest.mark.parametrize("command", ["simulate", "replay"])
def test_milliamperes_are_said_first_and_refused_beside_a_model(
    command, run_json, model, tmp_path, capsys
):
    log = load_dataset("nmc_drive_b")
    path = str(write_log(replace(log, **milliampere(log)), tmp_path / "spoiled.parquet"))
    assert "current LOOKS WRONG" in first_notice(run_json, "inspect", path)
    capsys.readouterr()
    assert main([command, "--model", model, path]) == 2
    assert "Milliamperes?" in capsys.readouterr().err


@pytest.mark.slow
def test_a_diagnosis_says_it_first(model, spoiled, capsys):
    """Or refuses the log, which says it as well."""
    path, said = spoiled
    arguments = ["diagnose", "--model", model, path, "--soc0", "0.9", "--cause", "resistance_scale"]
    code = main([*arguments, "--json"])
    captured = capsys.readouterr()
    assert code in (0, 2)
    if code == 2:
        assert captured.err.count("\n") == 1
        return
    assert said in json.loads(captured.out)["notices"][0]
    assert main(arguments) == 0
    assert said in capsys.readouterr().out.splitlines()[0]


def test_a_pack_read_as_one_cell_is_said_first(run_json, tmp_path, capsys):
    log = load_dataset("nmc_drive_b")
    path = str(write_log(replace(log, voltage_V=4.0 * log.voltage_V), tmp_path / "pack.csv"))
    assert "4 cells in series, read as one cell" in first_notice(run_json, "inspect", path)
    notices = run_json("inspect", path, "--series", "4")["notices"]
    assert not any("LOOKS WRONG" in notice for notice in notices)


def test_stamps_that_are_all_zero_are_refused(refused, model, tmp_path):
    log = load_dataset("nmc_drive_b")
    path = str(write_log(replace(log, time_s=np.zeros(len(log))), tmp_path / "still.csv"))
    for command in (["inspect"], ["simulate", "--model", model], ["replay", "--model", model]):
        assert "the same time, 0 s, in all" in refused(*command, path)


@pytest.fixture
def precious(tmp_path):
    path = write_log(load_dataset("nmc_drive_b").part(0, 400), tmp_path / "original.csv")
    return path, path.read_bytes()


@pytest.mark.parametrize(
    "name", ["original.csv", "link.csv", "hard.csv", "../{folder}/original.csv"]
)
def test_no_command_writes_over_its_log(refused, model, precious, name):
    path, content = precious
    folder = path.parent
    (folder / "link.csv").symlink_to(path)
    os.link(path, folder / "hard.csv")
    out = str(folder / name.format(folder=folder.name))
    for command in (
        ["convert", str(path)],
        ["convert", f"{path}@25"],
        ["simulate", "--model", model, str(path)],
        ["replay", "--model", model, str(path)],
    ):
        assert "both to read and to write" in refused(*command, "-o", out)
    assert "both to read" in refused("replay", "--model", model, str(path), "--report", out)
    assert path.read_bytes() == content


def test_no_command_writes_over_its_model(refused, model, precious, tmp_path):
    copy = tmp_path / "model.json"
    copy.write_bytes(Path(model).read_bytes())
    log = str(precious[0])
    said = refused("diagnose", "--model", str(copy), log, "-o", str(copy))
    assert "both to read and to write" in said
    refused("identify", "--hppc", log, "--nominal-ah", "5", "-o", log)
    assert copy.read_bytes() == Path(model).read_bytes()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_a_full_disk_is_one_line(refused, model, precious):
    log = str(precious[0])
    for option in ("-o", "--report"):
        said = refused("replay", "--model", model, log, option, "/dev/full")
        assert "No space left" in said or "suffix" in said


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_standard_output_on_a_full_disk_is_one_line(precious):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [*RUN, "inspect", str(precious[0]), "--json"],
            stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "standard output" in done.stderr


def test_names_that_are_too_long_are_one_line(refused, model, precious):
    log, long = str(precious[0]), "x" * 300 + ".csv"
    refused("inspect", long)
    refused("convert", log, "-o", long)
    refused("simulate", "--model", long, log)
    refused("replay", "--model", model, log, "--report", long + ".html")
    refused("identify", "--hppc", log, "-o", long)


def test_json_that_is_nested_too_deeply_is_one_line(refused, precious, tmp_path):
    deep = tmp_path / "deep.json"
    deep.write_text('{"a":' * 100_000 + "1" + "}" * 100_000)
    refused("simulate", "--model", str(deep), str(precious[0]))
    refused("inspect", str(deep))


# The program as it is installed, which says when it has the signal: before, it is Python's alone.
SAYS_WHEN = """
import _signal, sys
take = _signal.signal
def said(*given):
    before = take(*given)
    print(flush=True)
    return before
_signal.signal = said
from cellwise.cli import main
sys.exit(main())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.slow
@pytest.mark.parametrize("after_s", [0.0, 0.05, 0.15, 0.3, 0.5, 1.0])
def test_an_interrupt_at_any_time_is_one_line(model, precious, after_s, tmp_path):
    out = tmp_path / "out.csv"
    command = [sys.executable, "-c", SAYS_WHEN, "replay", "--model", model, str(precious[0])]
    process = subprocess.Popen(
        [*command, "-o", str(out)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "\n"
    time.sleep(after_s)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    # Nothing is said by a program that is ended by the signal: before its command and after it.
    assert process.returncode in (130, -signal.SIGINT)
    lines = said.splitlines()
    assert len(lines) <= 1
    assert lines or process.returncode == -signal.SIGINT
    assert all(line.startswith("cellwise: interrupted") for line in lines)
    assert {p.name for p in tmp_path.iterdir()} <= {"original.csv", "out.csv"}
