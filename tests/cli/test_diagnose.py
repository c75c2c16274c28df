"""cellwise diagnose: the contract's keys, files that work, refusals that leave nothing behind."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellwise.cell.effects import TemperatureDependence
from cellwise.cell.model_file import read_model, write_model
from cellwise.cell.simulate import simulate
from cellwise.cell.stock import named_model
from cellwise.cli import main
from cellwise.data import load_dataset
from cellwise.diagnose.causes.catalogue import CAUSES
from cellwise.diagnose.sketch_pictures import pictures_in
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.sketch.sketcher import Sketcher
from cellwise.logs import read_log, write_log
from cellwise.logs.cell_log import CellLog
from cellwise.report.diagnosis.statements import probability
from cellwise.workflows.sketches import keep_sketch
from diagnosis_cases import ODD_ROWS, odd_sensor
from example_cells import curved_cell

OFFSET_A = 0.12
# Few causes: the command is under test, not the judge.
QUICK = ("--cause", "current_offset", "--cause", "resistance_scale")


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Path:
    """A model, and drives whose current sensor adds a constant."""
    return odd_sensor(tmp_path_factory.mktemp("bench"), OFFSET_A)


@pytest.fixture(scope="module")
def diagnosed(bench, tmp_path_factory, run_json):
    """One run that writes everything: what it printed and its folder."""
    out = tmp_path_factory.mktemp("out")
    places = ("-o", out / "new.json", "--corrected", out / "logs")
    return run_json(*command(bench), *places, "--report", out / "page.html"), out


def command(bench, *more):
    logs = (str(bench / "drive.csv"), "--holdout", str(bench / "held.csv"))
    model = str(bench / "cell.json")
    return ("diagnose", "--model", model, *logs, "--soc0", "0.9", *QUICK, *more)


FOUND = "verdict causes candidates anatomy next_test extended_model logs limits competing"
CAUSE = "name parameters ci95 train_rmse_before_V train_rmse_after_V holdout_rmse_before_V"
CAUSE += " holdout_rmse_after_V gain gain_ci95 evidence confusable_with probability"


def test_the_keys_of_the_contract(diagnosed):
    found, _ = diagnosed
    assert set(FOUND.split()) <= set(found)
    (cause,) = found["causes"]
    assert set(CAUSE.split()) <= set(cause)
    assert found["verdict"] == cause["name"] == "current_offset"
    assert set(cause["ci95"]) == set(cause["parameters"])
    (low, high), value = cause["ci95"]["offset_A"], cause["parameters"]["offset_A"]
    assert low < value < high
    assert value == pytest.approx(OFFSET_A, rel=0.2)
    before, after = cause["holdout_rmse_before_V"], cause["holdout_rmse_after_V"]
    assert cause["gain"] == pytest.approx(1.0 - after / before)
    assert found["anatomy"]["rows"] == ODD_ROWS
    for tried in found["candidates"]:
        assert {"name", "holdout_rmse_V", "parameters"} <= set(tried)
        assert tried["name"] in CAUSES
    for limits in found["limits"].values():  # what no cell could have limits nothing
        for name, size in limits.items():
            assert size is None or not name.endswith("_ohm") or size < 10.0


@pytest.mark.parametrize("name", ["drive", "held"])
def test_logs_are_what_simulate_prints_with_both_models(diagnosed, bench, run_json, name):
    """One measure: the same start, all rows; where the log is corrected, that beside it."""
    found, out = diagnosed
    row = next(r for r in found["logs"] if r["log"].endswith(name))
    for model, key in ((bench / "cell.json", "rmse_before_V"), (out / "new.json", "rmse_after_V")):
        told = run_json(
            "simulate",
            "--model",
            str(model),
            str(bench / f"{name}.csv"),
            "--soc0",
            str(row["soc0"]),
        )
        assert row[key] == pytest.approx(told["rmse_V"], rel=1e-9)
    assert row["used"] == {"drive": "fit", "held": "holdout"}[name]
    assert row["rmse_corrected_V"] < 0.5 * row["rmse_before_V"]


def test_the_corrected_log_is_explained_by_the_extended_model(diagnosed, bench):
    found, out = diagnosed
    (path,) = found["corrected"]
    assert Path(path).parent == out / "logs"
    log, raw = read_log(path), read_log(bench / "drive.csv")
    offset = found["causes"][0]["parameters"]["offset_A"]
    np.testing.assert_allclose(log.current_A, raw.current_A - offset, atol=1e-9)
    new = read_model(found["extended_model"])
    before = simulate(curved_cell(), raw, 0.9).rmse_V
    assert simulate(new, log, 0.9).rmse_V < 0.3 * before


def test_for_people_first_what_to_do_and_one_figure_everywhere(diagnosed, bench, capsys):
    """In the JSON, on the page and in the terminal; of a cause alone what its log has with it."""
    found, out = diagnosed
    (cause,) = found["causes"]
    assert 0.9 < cause["probability"] < 1.0
    capsys.readouterr()
    assert main(list(command(bench))) == 0
    said = capsys.readouterr().out
    assert "current_offset" in said
    assert "offset_A 0.1" in said
    assert "extended model:" not in said
    places = [said.index(w) for w in ("Keep the model", "measure next", "  - ", "every log")]
    assert places == sorted(places)
    chance = probability(cause["probability"])
    assert chance in said
    assert found["report"] == str(out / "page.html")
    assert f"Current offset, probability {chance}" in (out / "page.html").read_text("utf-8")
    (alone,) = (c for c in found["candidates"] if c["name"] == cause["name"])
    held = next(r for r in found["logs"] if r["used"] == "holdout")
    assert cause["holdout_rmse_before_V"] == pytest.approx(held["rmse_before_V"], rel=1e-9)
    for one in (alone["holdout_rmse_V"], cause["holdout_rmse_after_V"]):
        assert one == pytest.approx(held["rmse_corrected_V"], rel=1e-9)


def test_simulate_by_itself_shows_what_the_logs_say_of_its_own_start(bench, run_json, tmp_path):
    """Nobody states the start, and the new model finds another one than the old."""
    cell, new = curved_cell(), tmp_path / "new.json"
    aged = replace(cell, r0_ohm=1.6 * cell.r0_ohm, r1_ohm=1.6 * cell.r1_ohm)
    names = []
    for name in ("drive", "held"):
        log = read_log(bench / f"{name}.csv")
        voltage = simulate(aged, log, 0.9).voltage_V
        names.append(str(tmp_path / f"{name}.csv"))
        write_log(replace(log, voltage_V=voltage), names[-1])
    logs = (names[0], "--holdout", names[1], "--cause", "resistance_scale", "-o", str(new))
    found = run_json("diagnose", "--model", str(bench / "cell.json"), *logs)
    assert found["verdict"] == "resistance_scale"
    for row, path in zip(found["logs"], names, strict=True):
        one = run_json("simulate", "--model", str(bench / "cell.json"), path)
        two = run_json("simulate", "--model", str(new), path)
        assert row["rmse_before_V"] == pytest.approx(one["rmse_V"], rel=1e-9)
        assert row["rmse_own_start_V"] == pytest.approx(two["rmse_V"], rel=1e-9)
        assert row["soc0_own_start"] == pytest.approx(two["soc0"]["value"], rel=1e-9)


def test_a_log_outside_the_model_s_data_is_said_first(model, drive, run_json, capsys, tmp_path):
    """As `simulate` says it, whatever the verdict; on the page, too."""
    cold = tmp_path / "cold.parquet"
    log = read_log(drive).part(0, 1500)
    write_log(replace(log, temperature_C=np.full(len(log), -12.0)), cold)
    asked = ("--model", model, str(cold))
    (notice, *_) = run_json("simulate", *asked)["notices"]
    assert "leaves what the model's data covered" in notice
    page = tmp_path / "page.html"
    told = ("diagnose", *asked, "--soc0", "0.9", *QUICK)
    assert notice in run_json(*told, "--report", str(page))["notices"]
    assert notice.split(": ")[0].replace("'", "&#x27;") in page.read_text("utf-8")
    capsys.readouterr()
    assert main(list(told)) == 0
    assert notice[:30] in capsys.readouterr().out.splitlines()[0]


def test_where_nothing_is_wrong_the_old_model_is_written(bench, run_json, tmp_path, capsys):
    log = read_log(bench / "drive.csv")
    good = tmp_path / "good.csv"
    write_log(CellLog(log.time_s, log.current_A - OFFSET_A, log.voltage_V), good)
    out = tmp_path / "new.json"
    arguments = ("--model", str(bench / "cell.json"), str(good), "--soc0", "0.9", *QUICK)
    found = run_json("diagnose", *arguments, "-o", str(out), "--corrected", str(tmp_path / "c"))
    assert found["verdict"] == "none"
    assert found["causes"] == []
    assert found["extended_model"] is None
    assert found["corrected"] == []
    assert main(["diagnose", *arguments, "-o", str(out)]) == 0
    assert "no cause changes the model" in capsys.readouterr().out
    kept, old = read_model(out), read_model(bench / "cell.json")
    assert simulate(kept, log, 0.9).rmse_V == simulate(old, log, 0.9).rmse_V
    assert not (tmp_path / "c").exists()


def test_an_error_beyond_the_claim_that_nothing_explains_is_said(bench, run_json, tmp_path):
    """Never none: the model claims less than what it is off by."""
    log = read_log(bench / "drive.csv")
    ripple = 0.1 * np.sin(2.0 * np.pi * log.time_s / 500.0)
    odd = tmp_path / "odd.csv"
    write_log(CellLog(log.time_s, log.current_A - OFFSET_A, log.voltage_V + ripple), odd)
    found = run_json(
        "diagnose", "--model", str(bench / "cell.json"), str(odd), "--soc0", "0.9",
        "--cause", "current_offset",
    )  # fmt: skip
    assert found["verdict"] == "unexplained"
    assert "times what the model claims" in found["reasons"][0]
    assert found["next_test"]
    assert found["causes"] == []


def test_what_the_logs_could_show_is_said_before_what_they_show(diagnosed):
    found, _ = diagnosed
    limit = found["limits"]["current_offset"]["offset_A"]
    assert 0.0 < limit < OFFSET_A
    (first, *_) = found["competing"]
    assert first["causes"] == ["current_offset"]
    assert first["probability"] <= found["causes"][0]["probability"]  # of all sets that hold it
    assert found["causes"][0]["probability"] > 0.9
    assert found["next_test"]


def test_the_model_of_the_user_stays_when_the_folder_cannot_be_written(bench, refused, tmp_path):
    taken = tmp_path / "folder.json"
    taken.mkdir()
    arguments = ("--model", str(bench / "cell.json"), str(bench / "drive.csv"))
    assert "folder" in refused("diagnose", *arguments, "-o", str(taken))


@pytest.mark.slow
def test_what_only_repeats_its_prior_comes_last(real_data, run_json, capsys, tmp_path):
    """A drive at 0 degC, the model of 25 degC without its law: few of thirteen numbers count."""
    folder, model = real_data / "panasonic_18650pf", str(tmp_path / "warm.json")
    tests = ("--hppc", str(folder / "hppc_p25.csv.gz"), "--ocv", str(folder / "ocv_c20_p25.csv.gz"))
    run_json("identify", *tests, "--nominal-ah", "2.9", "-o", model)
    found = read_model(model)  # from the logs' few kelvin and the prior it has a law already
    bare = [e for e in found.effects if not isinstance(e, TemperatureDependence)]
    write_model(replace(found, effects=tuple(bare)), model)
    drive = str(folder / "drive_p00_us06.csv.gz")
    asked = ("diagnose", "--model", model, drive, "--soc0", "1", "--cause")
    (cause,) = run_json(*asked, "temperature_dependence")["causes"]
    folded = cause["prior_only"]
    assert 0 < len(folded) < len(cause["parameters"])
    assert main([*asked, "temperature_dependence"]) == 0
    said, _, last = capsys.readouterr().out.partition("of which these logs say no more")
    first = said.partition("what competes")[0]  # after the causes, before what was tried
    for name in cause["parameters"]:
        assert (f"{name} " in first) != (name in folded), name
        assert (f"{name} " in last) == (name in folded), name


def test_identify_keeps_how_causes_look_in_sketches(tmp_path, capsys, run_json):
    """A model without it is refused, by the name of the command that makes one with it."""
    path, block = tmp_path / "cell.json", tmp_path / "kept.bin"
    asked = ["--drive", "nmc_drive_a", "--prior", "nmc-18650", "--nominal-ah", "5", "--sketch"]
    run_json("identify", *asked, "-o", path)
    model = read_model(path)
    assert set(pictures_in(model)) == {6, 9}
    sketcher = Sketcher(FixedStep(model, dt_s=1.0, sketch=256))
    block.write_bytes(sketcher.bytes_of(sketcher.run(load_dataset("nmc_drive_b"), 0.9)))
    found = run_json("diagnose", "--model", path, "--sketch", block)
    assert found["verdict"] == "undetermined"
    assert "earlier sketch" in found["reasons"][0]
    assert main(["diagnose", "--model", "nmc-18650", "--sketch", str(block)]) == 2
    assert "cellwise identify --sketch" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["fixed-step", "firmware"])
def test_replay_keeps_what_a_target_would(estimator, tmp_path, capsys, run_json):
    """A sketch of two logs in one call, and of one after the other: the same bytes."""
    logs = ["nmc_drive_a", "nmc_drive_b"]
    asked = ["--model", "nmc-18650", "--capacity-ah", "5", "--estimator", estimator, "--dt", "1"]
    first, second = tmp_path / "first.bin", tmp_path / "second.bin"
    run_json("replay", *asked, logs[0], "--soc0", "0.95", "--sketch", first)
    more = ["--sketch-from", first, "--sketch", second]
    run_json("replay", *asked, logs[1], "--soc0", "0.95", *more)
    known = [load_dataset(n) for n in logs]
    model = named_model("nmc-18650", 5.0)
    both = keep_sketch(model, "fixed-step", known, soc0=0.95, dt_s=1.0)
    assert second.read_bytes() == both != first.read_bytes()
    assert main(["replay", *asked[:4], logs[0], "--sketch", str(first)]) == 2
    assert "--estimator fixed-step" in capsys.readouterr().err
    assert main(["replay", *asked, logs[0], "--sketch", str(first)]) == 2
    assert "Give --soc0 SOC" in capsys.readouterr().err
    other = ["replay", *asked[:-1], "5", logs[0], "--soc0", "0.95", "--sketch", str(first)]
    assert main([*other, "--sketch-from", str(second)]) == 2
    assert "another model, period or size" in capsys.readouterr().err
