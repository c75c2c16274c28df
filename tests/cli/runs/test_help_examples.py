"""Every example that a help prints does what it says, one after the other in one folder."""

from __future__ import annotations

import io
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import cellwise as cw
from cellwise.cli import main
from cellwise.cli.command_line import build_parser
from cellwise.cli.common.usage import sections
from cellwise.data import datasets_folder
from emulated_packs import emulated_pack
from log_files import write_csv
from streams import driven
from tester_files import table
from vehicle_files import write_dataflash

# The internet, gigabytes, a bus; and minutes of work, which other tests do with less of it.
ELSEWHERE = ("data fetch", "data import", "live --model cell.json --source can")
MINUTES = ("benchmark --est", "capacity-study", "certify", "data gen", "demo", "export", "papers")
NOT_HERE = (*ELSEWHERE, *MINUTES)
SECONDS = ("inspect", "convert", "simulate", "data list")  # quick ones; all others are slow
SUITE = """
estimators = ["coulomb"]
[[cell]]
name = "LG M50"
chemistry = "NMC"
nominal_Ah = 5.0
model = "cell.json"
[[log]]
cell = "LG M50"
log = "drive.csv"
soc0 = 0.8
reference_Ah = 2.78
"""
MINE = """
class Mine:
    def __init__(self, model, dt_s=1.0):
        self.capacity_Ah = model.capacity_Ah

    def start(self, soc0, soc0_std):
        self.soc = soc0

    def step(self, current_A, voltage_V, temperature_C, dt_s):
        self.soc -= current_A * dt_s / (3600.0 * self.capacity_Ah)
        return self.soc
"""
COMMANDS = {
    name: [line.strip()[2:] for line in items.splitlines() if line.strip().startswith("$ ")]
    for name, (_, _, items) in sections().items()
    if items.strip()
}


def columns(log, cells=1):
    kept = {n: getattr(log, n) for n in ("time_s", "current_A", "voltage_V", "temperature_C")}
    charge = np.cumsum(log.interval_current_A * np.diff(log.time_s, prepend=0.0)) / 3600.0
    return {**kept, "voltage_V": cells * kept["voltage_V"], "ampere_hours": charge}


def aged(model, share, seed):
    """A drive of the same cell with so much of its capacity left."""
    cell = replace(model, capacity_Ah=share * model.capacity_Ah)
    return driven(cell, soc0=0.95, rows=4000, seed=seed, rest=120)


def write_mpt(path, c):
    """A text as EC-Lab writes it: positive charges."""
    charge_mAh = -1e3 * c["ampere_hours"]
    heads = {"time/s": c["time_s"], "Ewe/V": c["voltage_V"], "<I>/mA": -1e3 * c["current_A"]}
    above = "EC-Lab ASCII FILE\nNb header lines : 4\n\n"
    path.write_text(above + table({**heads, "(Q-Qo)/mA.h": charge_mAh}, "\t"))


def write_packs(folder):
    _, pack = emulated_pack(3, hours=0.5)
    made = {"time_s": pack.mean.time_s, "current_A": pack.mean.current_A}
    made |= {f"cell_{k + 1:02d}_V": pack.cell_V[:, k] for k in range(3)}
    for name in ("day1.csv", "day2.csv", "packs/one.csv"):
        write_csv(folder / name, made)
    pd.DataFrame(made).to_parquet(folder / "day.parquet")


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """The folder of somebody who has what the examples name, made of embedded data."""
    folder = tmp_path_factory.mktemp("measured")
    nmc = datasets_folder() / "nmc"
    for name in ("logs", "cells/one", "packs", "measurements", "flights"):
        (folder / name).mkdir(parents=True)
    model = cw.named_model("nmc-18650")
    cw.write_model(model, folder / "cell.json")
    drive = driven(model, rows=1200, rest=60)
    drive = replace(drive, charge_Ah=columns(drive)["ampere_hours"])
    for name in ("drive", "odd", "other", "healthy", "logs/one", "logs/two"):
        cw.write_log(drive, folder / f"{name}.csv")
    for k, year in enumerate((2023, 2024, 2025)):
        log = aged(model, 1.0 - 0.05 * k, k)
        for name in (f"{year}", f"year{k + 1}", f"cells/one/{year}"):
            cw.write_log(log, folder / f"{name}.csv")
    for name, file in (("hppc", "hppc"), ("c20", "ocv_c20"), ("measurements/hppc", "hppc")):
        cw.write_log(cw.read_log(nmc / f"{file}.parquet"), folder / f"{name}.csv")
    milliampere = {**columns(drive), "I_pack": 1e3 * drive.current_A}
    del milliampere["current_A"]
    write_csv(folder / "bms.csv", milliampere)
    write_mpt(folder / "cycler.mpt", columns(drive))
    flown = driven(cw.named_model("lipo-pouch"), soc0=0.95, rows=600, rest=60)
    for name in ("flight.bin", "flights/one.bin", "flights/two.bin"):
        write_dataflash(folder / name, [columns(flown, cells=4)], "instances")
    write_packs(folder)
    (folder / "sensor.toml").write_text("current_offset_A = 0.01\n")
    (folder / "suite.toml").write_text(SUITE)
    (folder / "mine.py").write_text(MINE)
    lines = zip(*(columns(drive)[n] for n in ("time_s", "current_A", "voltage_V")), strict=True)
    rows = "\n".join(",".join(map(str, row)) for row in lines)
    (folder / "samples.csv").write_text(f"time_s,current_A,voltage_V\n{rows}\n")
    return folder


def typed(example: str) -> list[str]:
    """The arguments as a shell hands them over."""
    words = shlex.split(example)
    return [p for w in words for p in (sorted(map(str, Path().glob(w))) if "*" in w else []) or [w]]


def run_here(name):
    return [example for example in COMMANDS[name] if not example.startswith(NOT_HERE)]


def marked(name):
    return pytest.param(name, marks=[] if name in SECONDS else pytest.mark.slow)


def test_every_command_has_two_examples():
    assert all(len(examples) >= 2 for examples in COMMANDS.values())


@pytest.mark.parametrize("name", COMMANDS)
def test_every_example_is_understood(name):
    for example in COMMANDS[name]:
        words = typed(example.partition(" < ")[0])
        assert build_parser().parse_args(words).command == words[0]


@pytest.mark.parametrize("name", [marked(name) for name in COMMANDS if run_here(name)])
def test_every_example_runs_after_the_one_before(name, measured, tmp_path, monkeypatch, capsys):
    folder = tmp_path / "measured"
    shutil.copytree(measured, folder)
    monkeypatch.chdir(folder)
    for example in run_here(name):
        words, _, source = example.partition(" < ")
        if source:
            content = io.BytesIO(Path(source).read_bytes())
            monkeypatch.setattr("sys.stdin", io.TextIOWrapper(content))
        assert main(typed(words)) == 0, f"{example}\n{capsys.readouterr().err}"
