"""A log far off its model: said in the first line, and nothing is foreseen from it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cellwise import load_dataset, replay, simulate
from cellwise.cell.plausibility.notice import FAR_DEVIATIONS, times_stated
from cellwise.cell.stock import named_model
from cellwise.cli import main
from cellwise.logs.writing import write_columns
from streams import json_lines

OTHER = ("--model", "lfp-26650", "--capacity-ah", "5")


def first_line(capsys, *arguments: str) -> str:
    capsys.readouterr()
    assert main(list(arguments)) == 0
    return capsys.readouterr().out.splitlines()[0]


def test_another_chemistry_is_said_first_and_forecasts_are_withheld(drive, run_json, capsys):
    for command in ("simulate", "replay"):
        assert "FAR OFF" in run_json(command, *OTHER, drive)["notices"][0]
        assert "FAR OFF" in first_line(capsys, command, *OTHER, drive)
    found = run_json("replay", *OTHER, drive, "--load", "10")
    assert found["forecast"] is None
    assert found["forecast_given"] is None
    assert "withheld" in found["notices"][0]
    anyway = run_json("replay", *OTHER, drive, "--anyway")
    assert anyway["forecast"] is not None
    assert "FAR OFF" in anyway["notices"][0]


def test_no_health_and_no_power_of_a_log_that_is_far_off(drive, run_json, capsys):
    adaptive = ("replay", *OTHER, drive, "--estimator", "adaptive", "--power")
    found = run_json(*adaptive)
    assert found["parameters"] is None
    assert found["power"] is None
    assert main(list(adaptive)) == 0
    said = capsys.readouterr().out
    assert "state of health" not in said
    assert "power of each cell" not in said
    anyway = run_json(*adaptive, "--anyway")
    assert anyway["parameters"]["capacity_Ah"]["value"] > 0.0
    assert anyway["power"] is not None


def test_no_history_by_logs_that_are_all_far_off(drive, run_json, capsys, tmp_path):
    saved, page = tmp_path / "aged.json", tmp_path / "life.html"
    rows = tmp_path / "life.csv"
    arguments = ["history", *OTHER, drive, "--save-model", str(saved)]
    found = run_json(*arguments, "-o", str(rows), "--report", str(page))
    assert "FAR OFF" in found["notices"][0]
    assert "--anyway" in found["notices"][0]
    (log,) = found["logs"]
    trend = found["trend"]
    health = [log[k] for k in log if k.startswith(("capacity", "resistance"))]
    assert {*health, *trend["use"].values(), *trend["capacity_share"]} == {None}
    assert 0.0 <= log["soc_end"] <= 1.0
    assert not saved.exists()
    assert "drive_b" in rows.read_text()
    assert "Far off this model" in page.read_text(encoding="utf-8")
    assert "FAR OFF" in first_line(capsys, *arguments)
    anyway = run_json(*arguments, "--anyway")
    assert anyway["trend"]["use"]["capacity_std_Ah"] > 0.0
    assert saved.exists()


def test_a_swapped_sign_is_said_first_and_forecasts_are_withheld(model, drive, run_json, capsys):
    swapped = ("replay", "--model", model, drive, "--sign", "charge-positive")
    found = run_json(*swapped)
    assert found["forecast"] is None
    assert "SIGN" in found["notices"][0]
    assert "SIGN" in first_line(capsys, *swapped)


def test_nothing_is_foreseen_of_a_stream_that_is_far_off(model, tmp_path, run_json, capsys):
    log = load_dataset("nmc_drive_b").part(0, 800)
    log = replace(log, temperature_C=None)
    source = ("--source", json_lines(log, tmp_path / "stream.jsonl"))
    power = ("--power",)
    found = run_json("live", *OTHER, *source, *power)
    assert "FAR OFF" in found["far_off"]
    capsys.readouterr()
    main(["live", *OTHER, *source])
    assert "withheld" in capsys.readouterr().err
    foreseen = [k for k in found if k.startswith(("remaining", "median_load", "full"))]
    powers = [k for k in found if k.endswith("_W")]
    assert foreseen
    assert powers
    assert all(found[k] is None for k in foreseen + powers)
    anyway = run_json("live", *OTHER, *source, *power, "--anyway")
    assert any(anyway[k] is not None for k in foreseen)
    own = run_json("live", "--model", model, *source, *power)
    assert own["far_off"] is None
    assert any(own[k] is not None for k in foreseen)


def test_no_health_of_a_pack_that_is_far_off(tmp_path, run_json, capsys):
    log = load_dataset("nmc_drive_b").part(0, 1200)
    cells = {f"cell_{k:02d}_mV": 1e3 * log.voltage_V + 3.0 * k for k in range(1, 5)}
    place, state = tmp_path / "pack.parquet", tmp_path / "state.json"
    write_columns({"time_s": log.time_s, "current_A": log.current_A, **cells}, place)
    page = tmp_path / "pack.html"
    arguments = ("pack", *OTHER, str(place), "--state", str(state), "--report", str(page))
    found = run_json(*arguments)
    assert "FAR OFF" in found["notices"][0]
    assert "withheld" in found["notices"][0]
    assert found["usable_Ah"] is None
    assert found["causes"] == []
    assert {row["capacity_Ah"] for row in found["per_cell"]} == {None}
    assert {row["resistance_scale"] for row in found["per_cell"]} == {None}
    assert all(0.0 <= row["soc"] <= 1.0 for row in found["per_cell"])
    assert not state.exists()
    assert "Far off this model" in page.read_text(encoding="utf-8")
    assert "FAR OFF" in first_line(capsys, "pack", *OTHER, str(place))
    assert run_json("pack", *OTHER, str(place), "--anyway")["usable_Ah"] > 0.0


@pytest.mark.parametrize(("name", "far"), [("lfp-26650", True), ("nmc-18650", False)])
def test_what_a_run_prints_of_itself_says_it_too(name, far):
    log = load_dataset("nmc_drive_b")
    simulation = simulate(named_model(name, 5.0), log)
    assert ("FAR OFF" in repr(simulation)) == far
    assert ("FAR OFF" in repr(replay(named_model(name, 5.0), log))) == far
    assert simulation.model is not None
    times, _ = times_stated(simulation.model, log, simulation.residual_V, simulation.soc)
    assert (times > FAR_DEVIATIONS) == far


@pytest.mark.slow
@pytest.mark.parametrize(
    "place", ["lg_18650hg2/drive_us06_n10_601", "panasonic_18650pf/drive_p25_us06"]
)
def test_lfp_for_a_measured_drive_of_nickel_is_said_by_every_command(place, real_data, run_json):
    """The filter moves the SOC to where LFP is followed best; that it cannot be is said even so."""
    given = ("--model", "lfp-26650", "--capacity-ah", "3", str(real_data / f"{place}.csv.gz"))
    replayed = run_json("replay", *given)
    assert replayed["forecast"] is None
    for command in ("simulate", "diagnose", "history"):
        assert any("FAR OFF" in notice for notice in run_json(command, *given)["notices"][:2])
    assert any("FAR OFF" in notice for notice in replayed["notices"][:2])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "place"),
    [
        ("nca-18650", "panasonic_18650pf/drive_n20_cycle_3"),
        ("nmc-18650", "lg_18650hg2/drive_us06_n20_610"),
        ("lfp-26650", "plett_a123/dyn_p25_s1"),
        ("lmo-pouch", "leaf_pack/leaf_20170701"),
    ],
)
def test_a_stock_model_of_the_right_kind_is_not_far_off_in_the_cold(
    model, place, real_data, run_json
):
    found = next(iter(real_data.glob(f"{place}*")))
    capacity = {"nca": "2.9", "nmc": "3", "lfp": "2.3", "lmo": "65"}[model[:3]]
    said = run_json("replay", "--model", model, "--capacity-ah", capacity, str(found))
    assert not any("FAR OFF" in notice for notice in said["notices"])


def test_a_wrong_sign_of_a_stream_is_said_and_withholds(model, tmp_path, run_json):
    log = load_dataset("nmc_drive_b").part(0, 600)
    source = json_lines(replace(log, current_A=-log.current_A), tmp_path / "wrong.jsonl")
    told = ("live", "--model", model, "--source", source)
    found = run_json(*told)
    assert "THE SIGN OF THE CURRENT LOOKS WRONG" in found["far_off"]
    assert "--sign charge-positive" in found["far_off"]
    assert found["median_load_remaining_s"] is None
    assert run_json(*told, "--sign", "charge-positive")["far_off"] is None
