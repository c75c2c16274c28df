"""What tests of measured cells claim in Python, through the command on the files as published.

``tests/docs/test_capabilities.py`` lists which claim has its twin here.
"""

from __future__ import annotations

import csv
import json
import re

import numpy as np
import pytest

from cellwise.cli import main

pytestmark = pytest.mark.slow

PANASONIC = "panasonic_18650pf"


@pytest.fixture(scope="module")
def identify(tmp_path_factory):
    """Identify by command; what it printed, and its model."""

    def run(*arguments):
        model = str(tmp_path_factory.mktemp("model") / "model.json")
        out = model.replace("model.json", "printed.json")
        with pytest.MonkeyPatch.context() as patch, open(out, "w") as printed:
            patch.setattr("sys.stdout", printed)
            assert main(["identify", *map(str, arguments), "-o", model, "--json"]) == 0
        with open(out) as printed:
            return json.load(printed), model

    return run


@pytest.fixture(scope="module")
def panasonic(real_data, identify):
    folder = real_data / PANASONIC
    return identify(
        *("--hppc", folder / "hppc_p25.csv.gz", "--ocv", folder / "ocv_c20_p25.csv.gz"),
        *("--capacity", folder / "cap_1c_p25_start_?.csv.gz", "--nominal-ah", 2.9),
        *("--drive", folder / "drive_p25_cycle_[23].csv.gz"),
    )


def test_capacities_are_those_of_the_readme(panasonic):
    found, _ = panasonic
    assert found["capacity_Ah"] == pytest.approx(2.997, rel=1e-3)
    assert found["capacities"]["rate:1C"] == pytest.approx((2.798 + 2.752) / 2, rel=2e-3)
    assert found["pulses"]["healthy"] >= 50


def test_a_held_out_drive_and_its_soc(panasonic, real_data, run_json):
    drive = str(real_data / PANASONIC / "drive_p25_us06.csv.gz")
    given = ("--model", panasonic[1], drive)
    assert run_json("simulate", *given, "--soc0", "1")["rmse_above_10pct_V"] < 0.018
    truth = ("--reference-soc0", "1", "--reference-capacity-ah", "2.997")
    found = run_json("replay", *given, "--soc0", "0.7", *truth)
    assert found["convergence_s"] < 300.0
    assert found["coverage_2sigma"] > 0.9
    assert found["settled"]["rmse"] < 0.006


def test_the_fixed_step_is_the_ekf(panasonic, real_data, run_json, tmp_path):
    drive = str(real_data / PANASONIC / "drive_p25_us06.csv.gz")
    columns = []
    for name in ("ekf", "fixed-step"):
        out = tmp_path / f"{name}.csv"
        given = ("--model", panasonic[1], drive, "--soc0", "1", "--dt", "1", "-o", str(out))
        run_json("replay", *given, "--estimator", name)
        with out.open() as rows:
            columns.append(np.array([float(row["soc"]) for row in csv.DictReader(rows)]))
    assert 100.0 * np.sqrt(np.mean((columns[0] - columns[1]) ** 2)) < 0.05  # points


def test_a_fast_discharge_of_pulses_and_a_slow_one(real_data, identify, run_json):
    folder = real_data / "nissan_leaf"
    _, model = identify("--hppc", f"{folder}/hppc_p25.csv.gz@25", "--capacity",
                        folder / "cap_1c_p23.csv.gz", "--nominal-ah", 33)  # fmt: skip
    found = run_json("simulate", "--model", model, str(folder / "cap_2c_p23.csv.gz"))
    assert found["rmse_above_10pct_V"] < 0.030


@pytest.fixture(scope="module")
def car(real_data, identify):
    folder = real_data / "leaf_pack"
    return identify("--drive", folder / "leaf_201706*.parquet", "--prior", "lmo-pouch",
                    "--nominal-ah", 65)[1]  # fmt: skip


def test_a_month_of_a_car_holds_for_the_next(car, real_data, run_json):
    days = str(real_data / "leaf_pack" / "leaf_201707*.parquet")
    found = run_json("simulate", "--model", car, days)["logs"]
    assert np.median([one["rmse_V"] for one in found]) < 0.008


def test_nobody_of_a_healthy_pack_is_accused(car, real_data, run_json):
    days = str(real_data / "leaf_pack" / "leaf_201707*.parquet")
    found = run_json("pack", "--model", car, days)
    assert found["causes"] == []
    assert found["cells"] == 96


def test_a_life_in_the_order_of_its_files(real_data, run_json):
    """Shares of the first capacity, by the maker's own table of complete discharges."""
    folder = real_data / "samsung_30q_ageing"
    files = str(folder / "d1_cellA_cycle?01.csv.gz")
    found = run_json("history", "--model", "nca-18650", files)
    with (folder / "capacities_d1_cellA.csv").open() as rows:
        table = [r for r in csv.DictReader(rows) if r["kind"] == "discharge"]
    whole = [float(r["capacity_Ah"]) for r in table if r["complete"] == "1"]
    # A charge and a discharge with a pause between are two stretches; the second is complete.
    last = {re.search(r"cycle(\d+)", one["log"])[1]: k for k, one in enumerate(found["logs"])}
    truth = np.array([whole[int(cycle) - 1] for cycle in last])
    share = np.array(found["trend"]["capacity_share"])[list(last.values())]
    assert truth.size == 7
    assert np.sqrt(np.mean((share - truth / truth[0]) ** 2)) < 0.015


def test_lipo_fade_at_4c(real_data, run_json):
    files = [str(real_data / "lipo_5450" / f"c4_cycle{k:02d}.csv.gz") for k in (1, 2, 3, 25, 48)]
    found = run_json("history", "--model", "lipo-pouch", *files)
    fade = 100.0 * (1.0 - found["trend"]["capacity_share"][-1])
    assert fade == pytest.approx(100.0 * (1.0 - 5.026 / 5.147), abs=0.3)


def test_every_native_file_is_inspected(real_data, run_json):
    for place in sorted((real_data / "native").iterdir()):
        found = run_json("inspect", str(place))
        assert found["samples"] > 10
        assert found["sign"] != "contradicted"
