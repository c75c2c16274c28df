"""What a certificate is made of beside the model's own cells: physics, measured logs, kept logs."""

from __future__ import annotations

import json
import shutil
from importlib.util import find_spec

import numpy as np
import pytest

from cellwise.benchmark.certify import Limits, certify, measured_log, read_export
from cellwise.benchmark.certify.physics_cells import physics_cell
from cellwise.cell.protocol import (
    ConstantCurrent,
    ConstantVoltage,
    DriveProfile,
    Rest,
    run_protocol,
)
from cellwise.cell.stock import stock_model
from cellwise.cli import main
from cellwise.data import load_dataset
from cellwise.errors import InputError

pytestmark = pytest.mark.skipif(
    shutil.which("cc") is None and shutil.which("gcc") is None, reason="no C compiler"
)
needs_pybamm = pytest.mark.skipif(find_spec("pybamm") is None, reason="PyBaMM is not installed")
DRIVE = "nmc_drive_a"


@needs_pybamm
@pytest.mark.slow
@pytest.mark.parametrize(("name", "temperature_C"), [("nca-18650", 25.0), ("lfp-26650", 10.0)])
def test_porous_electrodes_have_the_cells_pulse_capacity_and_ocv(name, temperature_C):
    model = stock_model(name)
    cell = physics_cell(model, temperature_C)
    capacity = model.capacity_Ah
    pulse = (Rest(10.0), ConstantCurrent(current_A=0.5 * capacity, duration_s=600.0))
    want = run_protocol(model, pulse, 0.5, 1.0, temperature_C)
    found, soc = cell.lived(pulse, 0.5, 1.0)
    for after_s in (11.0, 610.0):
        drop, asked = (
            np.interp([10.0, after_s], log.time_s, log.voltage_V) @ [1.0, -1.0]
            for log in (found, want)
        )
        assert drop == pytest.approx(asked, rel=0.06)
    moved_Ah = np.sum(found.current_A * np.diff(found.time_s, prepend=0.0)) / 3600.0
    assert soc[0] - soc[-1] == pytest.approx(moved_Ah / capacity, abs=1e-9)
    quiet = (ConstantCurrent(current_A=0.1 * capacity, duration_s=7200.0), Rest(8 * 3600.0))
    found, soc = cell.lived(quiet, 0.9, 60.0)
    ocv = np.interp(soc[-1], np.linspace(0.0, 1.0, 1001), cell.ocv_V(np.linspace(0.0, 1.0, 1001)))
    assert found.voltage_V[-1] == pytest.approx(ocv, abs=2e-3)


@needs_pybamm
@pytest.mark.slow
def test_a_charger_of_porous_electrodes_keeps_its_limits():
    model = stock_model("nmc-18650")
    capacity, high_V = model.capacity_Ah, model.voltage_max_V
    drive = np.full(600, 0.5 * capacity)
    drive[::4] = -0.3 * capacity  # at full the cell cannot take it
    steps = (
        ConstantCurrent(current_A=-0.5 * capacity, voltage_max_V=high_V),
        ConstantVoltage(voltage_V=high_V, until_current_A=0.05 * capacity),
        DriveProfile(time_s=np.arange(1.0, 601.0), current_A=drive),
    )
    log, soc = physics_cell(model, 25.0).lived(steps, 0.7, 5.0)
    assert log.voltage_V.max() <= high_V + 1e-3
    assert soc.max() > 0.97
    assert log.duration_s > 3600.0


@needs_pybamm
@pytest.mark.slow
def test_the_page_says_which_cells_are_physics(folder, tmp_path, capsys):
    place = tmp_path / "c"
    asked = ["--cells", "2", "--physics", "1", "--hours", "6", "-o", str(place), "--json"]
    assert main(["certify", str(folder), *asked]) == 0
    data = json.loads(capsys.readouterr().out)
    assert {name: one["cells"] for name, one in data["sources"].items()} == {
        "model": 2,
        "physics": 1,
    }
    page = (place / "index.html").read_text()
    assert "cells of porous electrodes 1 x 6 h" in page
    assert "PyBaMM" in page


def test_physics_without_pybamm_is_refused(folder, monkeypatch):
    monkeypatch.setattr("cellwise.benchmark.certify.run.has_pybamm", lambda: False)
    exported = read_export(folder)
    with pytest.raises(InputError, match="pip install 'pybamm>="):
        certify(exported, 1, 3.0, physics=1)
    assert list(certify(exported, 20, 1.5).sources) == ["model"]


def test_a_measured_log_is_run_with_every_fault(folder, capsys):
    asked = ["--cells", "1", "--hours", "2", "--physics", "0", "--json"]
    log = ["--log", f"{DRIVE}@soc0=1", "--reference-capacity-ah", "5.15"]
    assert main(["certify", str(folder), *asked, *log]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["sources"]["measured"]["cells"] == 8
    assert data["settings"]["measured"][0][1:] == [1.0, 5.15]
    faults = {one["fault"] for one in data["worst"] if one["source"] == "measured"}
    assert len(faults) == 8
    assert (
        sum(g["cells"] for g in data["by"]["age"].values()) == 1
    )  # of a measured log it is unknown


def test_a_measured_log_with_an_unknown_start_is_refused(folder, embedded_drive):
    model = read_export(folder).model
    rows = np.flatnonzero(embedded_drive.current_A > 0.0)
    cut = embedded_drive.part(int(rows[rows.size // 3]), len(embedded_drive))
    with pytest.raises(InputError, match="begins at"):
        measured_log(model, cut, None, None)
    assert measured_log(model, cut, 0.6, None).soc0 == pytest.approx(0.6)
    with pytest.raises(InputError, match="hour and a half"):
        measured_log(model, cut.part(0, 100), 0.6, None)


@pytest.fixture(scope="module")
def embedded_drive():
    """An embedded drive that began full."""
    return load_dataset(DRIVE)


def test_each_source_keeps_the_limits(folder, embedded_drive):
    """A fleet that is good hides no measured log that is bad."""
    exported = read_export(folder)
    wrong = measured_log(exported.model, embedded_drive, 0.5, 10.0)  # a reference far off
    sources = certify(exported, 1, 2.0, physics=0, measured=[wrong]).sources
    limit = 0.5 * (sources["model"]["rmse"] + sources["measured"]["rmse"])
    assert limit > sources["model"]["rmse"]
    found = certify(exported, 1, 2.0, physics=0, measured=[wrong], limits=Limits(rmse=limit))
    assert len(found.beyond) == 1
    assert "measured" in found.beyond[0]


@pytest.mark.slow
def test_kept_logs_replay_to_the_same_error(folder, tmp_path, capsys):
    place = tmp_path / "c"
    asked = ["--cells", "2", "--hours", "4", "--physics", "0", "-o", str(place), "--json"]
    assert main(["certify", str(folder), *asked, "--keep-logs", "1"]) == 0
    worst = json.loads(capsys.readouterr().out)["worst"][0]
    arguments = [
        "replay", str(place / worst["log"]), "--model", str(folder / "cell.json"),
        "--estimator", "fixed-step", "--soc0", str(worst["started_at"]), "--soc0-std", "0.15",
        "--reference-soc0", str(worst["soc0"]),
        "--reference-capacity-ah", str(worst["capacity_Ah"]), "--json",
    ]  # fmt: skip
    assert main(arguments) == 0
    replayed = json.loads(capsys.readouterr().out)
    assert replayed["soc_max_error"] >= worst["worst"] - 0.005


@pytest.mark.slow
def test_processes_give_what_threads_give(folder):
    pytest.importorskip("distributed")
    exported = read_export(folder)
    here = certify(exported, 2, 2.0, physics=0).to_dict()
    assert certify(exported, 2, 2.0, physics=0, scheduler="processes").to_dict() == here
