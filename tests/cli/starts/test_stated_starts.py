"""A stated start is believed by every command that takes a log."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from cellwise import load_dataset, read_model, write_log, write_model
from cellwise.cli import main
from cellwise.data import datasets_folder

NMC = datasets_folder() / "nmc"


@pytest.fixture
def middle(tmp_path):
    """A drive without its first rest, whose true SOC at the first row is known."""
    log = load_dataset("nmc_drive_b")
    begun = log.part(4000, len(log))
    return str(write_log(begun, tmp_path / "middle.parquet"))


CAUSE = ("--cause", "initial_soc")
JUDGED = ("--reference-capacity-ah", "5")
SAME = {
    "simulate": ((), (), ("rmse_V",)),
    "replay": (JUDGED, (*JUDGED, "--reference-soc0", "0.6"), ("soc_rmse",)),
    "diagnose": ((*CAUSE, "--soc0", "0.1"), CAUSE, ("anatomy", "candidates")),
}  # options beside a stated start, the same beside --soc0, what is alike


@pytest.mark.parametrize("command", SAME)
def test_a_command_begins_where_it_is_stated(run_json, model, middle, command):
    beside, otherwise, alike = SAME[command]
    found = run_json(command, "--model", model, f"{middle}@soc0=0.6", *beside)
    std = ()
    if command != "diagnose":
        assert (found["soc0"]["value"], found["soc0"]["how"]) == (0.6, "stated")
        std = ("--soc0-std", str(found["soc0"]["std"])) if command == "replay" else ()
    same = run_json(command, "--model", model, middle, "--soc0", "0.6", *std, *otherwise)
    assert {key: found[key] for key in alike} == {key: same[key] for key in alike}


@pytest.mark.parametrize(
    ("command", "option"),
    [("simulate", "--soc0"), ("replay", "--soc0"), ("replay", "--reference-soc0")],
)
def test_a_contradiction_is_refused(refused, model, middle, command, option):
    said = refused(command, "--model", model, f"{middle}@soc0=0.6", option, "0.7")
    assert f"{option} 0.7" in said
    assert "0.6" in said


def test_inspect_and_convert_understand_it(run_json, middle, tmp_path):
    assert run_json("inspect", f"{middle}@-20,soc0=0.6")["soc0"] == 0.6
    assert run_json("inspect", f"{middle}@soc0=0.6")["soc0"] == 0.6
    out = tmp_path / "out.csv"
    found = run_json("convert", f"{middle}@soc0=0.6", "-o", str(out))
    assert any("soc0=0.6" in n for n in found["notices"])


def test_live_begins_at_the_soc_stated_behind_its_source(run_json, model, middle, tmp_path):
    stream = tmp_path / "stream.json"
    rows = [{"time_s": k, "current_A": 1.0, "voltage_V": 3.7} for k in range(5)]
    stream.write_text("\n".join(json.dumps(r) for r in rows) + "\n")
    found = run_json("live", "--model", model, "--source", f"json:{stream}@-5,soc0=0.6")
    assert found["soc0"]["value"] == 0.6
    assert found["soc0"]["std"] < 0.01


def test_fleet_takes_it_of_every_log(run_json, model, middle, tmp_path):
    import pyarrow.parquet

    folder = tmp_path / "logs"
    folder.mkdir()
    shutil.copy(middle, folder / "a.parquet")
    run_json("fleet", "replay", "--model", model, f"{folder}@soc0=0.6", "-o",
             str(tmp_path / "out"))  # fmt: skip
    (part,) = (tmp_path / "out").glob("*.parquet")
    row = pyarrow.parquet.read_table(part).to_pylist()[0]
    assert (row["soc0"], row["soc0_how"]) == (0.6, "stated")


@pytest.mark.slow
def test_no_stated_log_is_left_out_of_the_fit(run_json, tmp_path):
    """A drive that begins under load, where its voltage says nothing of SOC."""
    drive = load_dataset("nmc_drive_b").part(0, 9000)
    truth = 1.0
    under_load = drive.rows(drive.known_current_A() > 0.5)
    begun = truth - float(under_load.charge_Ah[0] - drive.charge_Ah[0]) / 5.0
    path = write_log(under_load, tmp_path / "cold.parquet")
    out = str(tmp_path / "model.json")
    found = run_json(
        "identify", "--hppc", str(NMC / "hppc.parquet"), "--ocv", str(NMC / "ocv_c20.parquet"),
        "--drive", f"{path}@temperature_C=25,soc0={begun:.4f}", "-o", out,
    )  # fmt: skip
    assert "cold" in found["fit"]["logs"]
    assert not any("left out" in n for n in found["notices"])
    own = next(o for o in found["own_logs"] if o["log"] == "cold")
    assert (own["used"], own["soc0_how"]) == (True, "stated")
    assert own["soc0"] == pytest.approx(begun, abs=1e-4)
    write_model(read_model(out), tmp_path / "again.json")


def test_a_start_says_how_sure_it_is_taken_to_be(model, middle, capsys):
    asked = ["replay", middle, "--model", model, "--estimator", "ekf", "--soc0", "0.6"]
    assert main(asked) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "60 % ± 30 %, given; --soc0-std states how sure" in said
    assert main([*asked, "--soc0-std", "0.01"]) == 0
    assert "60 % ± 2.0 %, given" in " ".join(capsys.readouterr().out.split())


def test_a_log_cut_where_a_load_has_just_ended_says_how_sure_its_start_is(
    run_json, model, tmp_path
):
    """The first seconds without current after a pulse or a move, and nothing else."""
    pulses = load_dataset("nmc_hppc")
    idle = np.abs(pulses.current_A) < 0.01
    ends = np.flatnonzero(~idle[:-1] & idle[1:]) + 1
    sizes = []
    for row in np.random.default_rng(1).choice(ends, 12, replace=False):
        stop = int(np.searchsorted(pulses.time_s, pulses.time_s[row] + 2.0, side="right"))
        path = str(write_log(pulses.part(int(row), max(stop, int(row) + 2)), tmp_path / "end.csv"))
        truth = 1.0 - float(pulses.charge_Ah[row] - pulses.charge_Ah[0]) / 5.0
        soc0 = run_json("replay", "--model", model, "--estimator", "coulomb", path)["soc0"]
        assert soc0["how"].startswith("rest of"), soc0
        sizes.append(abs(soc0["value"] - truth) / soc0["std"])
    assert np.count_nonzero(np.array(sizes) < 2.0) >= 10, sizes


@pytest.mark.slow
@pytest.mark.parametrize("row", [2500, 4000])
def test_a_drive_of_unknown_start_takes_part_from_where_it_began(run_json, tmp_path, row):
    """Cut under load, no rest after it, nothing stated: its start is found with the tables."""
    drive = load_dataset("nmc_drive_b")
    row += int(np.argmax(drive.current_A[row:] > 2.0))
    truth = 1.0 - float(drive.charge_Ah[row] - drive.charge_Ah[0]) / 5.0
    stop = int(np.flatnonzero(np.abs(drive.current_A) > 0.5)[-1])
    path = write_log(drive.part(row, stop), tmp_path / "cut.parquet")
    found = run_json(
        "identify", "--hppc", str(NMC / "hppc.parquet"), "--ocv", str(NMC / "ocv_c20.parquet"),
        "--drive", str(path), "-o", str(tmp_path / "model.json"),
    )  # fmt: skip
    assert "cut" in found["fit"]["logs"]
    (said,) = [n for n in found["notices"] if "'cut' begins at SOC" in n]
    assert "by its voltages" in said
    assert float(said.split("SOC ")[1].split()[0]) == pytest.approx(truth, abs=0.02), said
