"""CONTRACT.md to the letter: every key, of the type and in the range that it says."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cellwise.cli import main
from cellwise.cli.common.printing import clean
from cellwise.data import datasets_folder
from cellwise.logs import read_log

NUMBER = (int, float)
ERRORS = {"rmse_V": NUMBER, "mae_V": NUMBER, "max_error_V": NUMBER}
SPAN = {"min": NUMBER, "max": NUMBER}
INSPECT = {
    "format": str, "samples": int, "duration_s": NUMBER, "sign": str, "gaps": list,
    "duplicates": int, "current_A": SPAN, "voltage_V": SPAN, "temperature_C": SPAN,
    "charge_Ah": NUMBER, "notices": list,
}  # fmt: skip
IDENTIFY = {
    "capacity_Ah": NUMBER, "capacity_choice": str, "capacities": dict,
    "pulses": dict.fromkeys(("healthy", "trimmed", "distorted", "spurious"), int),
    "fit": ERRORS, "seconds": NUMBER,
    "error": {"scales_s": list, "soc": list, "temperature_C": list, "std_V": list,
              "share": list, "persistent_share": NUMBER},
}  # fmt: skip
SOC0 = {"value": NUMBER, "std": NUMBER, "how": str}
SIMULATE = {
    **ERRORS, "mean_error_V": NUMBER, "std_error_V": NUMBER, "ci95_V": list,
    "rmse_above_10pct_V": NUMBER, "bands": list, "samples": int, "seconds": NUMBER, "soc0": SOC0,
}  # fmt: skip
REPLAY = {
    "estimator": str, "samples": int, "soc_final": NUMBER, "soc_rmse": NUMBER, "soc_mae": NUMBER,
    "soc_max_error": NUMBER, "convergence_s": NUMBER, "convergence_predicted_s": NUMBER,
    "settled": {"rmse": NUMBER, "mae": NUMBER, "max": NUMBER}, "coverage_2sigma": NUMBER,
    "nis_mean": NUMBER, "nis": list, "voltage_rmse_V": NUMBER, "ns_per_step": NUMBER, "soc0": SOC0,
}  # fmt: skip


def conforms(found: dict[str, Any], schema: dict[str, Any], where: str = "") -> None:
    for key, kind in schema.items():
        assert key in found, f"{where}{key} is missing"
        if isinstance(kind, dict):
            conforms(found[key], kind, f"{where}{key}.")
        else:
            assert isinstance(found[key], kind), f"{where}{key} is {found[key]!r}"
            assert not isinstance(found[key], bool)


def test_inspect_prints_the_keys_of_the_contract(run_json, drive):
    found = run_json("inspect", drive)
    conforms(found, INSPECT)
    assert found["sign"] in ("verified", "contradicted", "undetermined")


def test_inspect_of_a_log_without_temperature(run_json, tmp_path):
    path = tmp_path / "bare.csv"
    path.write_text("time_s,current_A,voltage_V\n0,0,3.7\n1,0,3.7\n2,0,3.7\n")
    found = run_json("inspect", str(path))
    assert found["temperature_C"] is None
    assert found["sign"] == "undetermined"


def test_identify_prints_the_keys_of_the_contract(identified):
    conforms(identified.printed, IDENTIFY)
    assert all(isinstance(v, float) for v in identified.printed["capacities"].values())
    assert identified.printed["capacity_choice"] in identified.printed["capacities"]
    assert identified.stderr == "", "nothing to say on standard error when all is well"


def test_the_capacity_choice_is_taken(run_json, tmp_path):
    found = run_json("identify", "--hppc", str(datasets_folder() / "nmc" / "hppc.parquet"),
                     "--nominal-ah", "5", "--capacity-choice", "nominal", "--no-refine",
                     "-o", str(tmp_path / "m.json"))  # fmt: skip
    assert (found["capacity_Ah"], found["capacity_choice"]) == (5.0, "nominal")


def test_the_model_file_names_its_schema_version_and_logs(identified):
    model = json.loads(identified.path.read_text())
    assert isinstance(model["schema_version"], int)
    assert model["capacity_Ah"] == identified.printed["capacity_Ah"]
    named = model["provenance"]["logs"]
    assert [Path(p).stem for p in named["drive"]] == ["drive_c"]
    assert model["provenance"]["cellwise_version"]


def test_simulate_prints_the_keys_of_the_contract(run_json, model, drive):
    found = run_json("simulate", "--model", model, drive)
    conforms(found, SIMULATE)
    assert found["rmse_V"] ** 2 == pytest.approx(
        found["mean_error_V"] ** 2 + found["std_error_V"] ** 2, rel=1e-3
    )
    assert found["mae_V"] <= found["rmse_V"] <= found["max_error_V"]
    low, high = found["ci95_V"]
    assert (low + high) / 2 == pytest.approx(found["mean_error_V"])
    assert sum(b["samples"] for b in found["bands"]) == found["samples"]
    for band in found["bands"]:
        conforms(band, {**ERRORS, "soc": list, "samples": int})
    squares = sum(b["samples"] * b["rmse_V"] ** 2 for b in found["bands"])
    assert found["rmse_V"] == pytest.approx(math.sqrt(squares / found["samples"]))


def judged(estimator="ekf", soc0="0.7"):
    return ("--estimator", estimator, "--soc0", soc0, "--reference-soc0", "0.99701",
            "--reference-capacity-ah", "5.1532")  # fmt: skip


@pytest.mark.parametrize("estimator", ["ekf", pytest.param("filterpy-ekf", marks=pytest.mark.slow)])
def test_replay_prints_the_keys_of_the_contract(run_json, model, drive, estimator):
    found = run_json("replay", "--model", model, drive, *judged(estimator))
    conforms(found, REPLAY)
    assert found["estimator"] == estimator
    assert found["soc_mae"] <= found["soc_rmse"] <= found["soc_max_error"]
    assert 0.0 <= found["coverage_2sigma"] <= 1.0
    assert found["settled"]["max"] <= 0.02, "settled is what stays within two points"


def test_replay_of_the_counter_never_converges(run_json, model, drive):
    found = run_json("replay", "--model", model, drive, *judged("coulomb"))
    assert found["convergence_s"] is None
    # Off by as much as at its start, until it stands at empty and can fall no further.
    assert found["soc_max_error"] == pytest.approx(0.297, abs=0.01)
    assert found["soc_rmse"] > 0.2


def test_the_reference_never_uses_the_filters_current_nor_the_models_capacity(
    run_json, model, drive, tmp_path
):
    # A sensor that reads 20 % too much moves the counter's estimate, not the reference.
    log = read_log(drive)
    rows = pd.read_parquet(drive)
    rows["current_A"] *= 1.2
    biased = tmp_path / "biased.parquet"
    rows.to_parquet(biased)
    out = tmp_path / "rows.parquet"
    run_json("replay", "--model", model, str(biased), *judged("coulomb", "1"), "-o", str(out))
    reference = pd.read_parquet(out)["reference_soc"].to_numpy()
    expected = 0.99701 - (log.charge_Ah - log.charge_Ah[0]) / 5.1532
    np.testing.assert_allclose(reference, expected, atol=1e-12)


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".parquet"])
def test_rows_of_a_simulation_have_the_columns_of_the_contract(
    run_json, model, drive, tmp_path, suffix
):
    out = tmp_path / f"rows{suffix}"
    found = run_json("simulate", "--model", model, drive, "-o", str(out))
    rows = pd.read_parquet(out) if suffix == ".parquet" else pd.read_csv(out)
    assert list(rows.columns) == [
        "time_s", "current_A", "measured_voltage_V", "voltage_V", "error_V", "soc"
    ]  # fmt: skip
    assert len(rows) == found["samples"]
    np.testing.assert_allclose(rows.error_V, rows.measured_voltage_V - rows.voltage_V, atol=1e-12)
    assert rows.soc[0] == pytest.approx(found["soc0"]["value"])


def test_rows_of_a_replay_have_the_columns_of_the_contract(run_json, model, drive, tmp_path):
    out = tmp_path / "rows.parquet"
    found = run_json("replay", "--model", model, drive, *judged(), "-o", str(out))
    rows = pd.read_parquet(out)
    assert list(rows.columns[:5]) == ["time_s", "soc", "soc_std", "voltage_V", "innovation_V"]
    assert {"reference_soc", "status"} <= set(rows.columns)
    error = rows.soc - rows.reference_soc
    assert found["soc_rmse"] == pytest.approx(float(np.sqrt(np.mean(error**2))))
    assert found["soc_max_error"] == pytest.approx(float(error.abs().max()))
    assert found["soc_final"] == pytest.approx(float(rows.soc.iloc[-1]))
    late = rows.time_s - rows.time_s[0] >= found["convergence_s"]
    assert found["settled"]["rmse"] == pytest.approx(float(np.sqrt(np.mean(error[late] ** 2))))
    within = float(np.mean(error.abs() <= 2.0 * rows.soc_std))
    assert found["coverage_2sigma"] == pytest.approx(within)


def test_rows_without_a_reference_have_no_column_of_it(run_json, model, drive, tmp_path):
    out = tmp_path / "rows.csv"
    run_json("replay", "--model", model, drive, "-o", str(out))
    assert "reference_soc" not in pd.read_csv(out).columns


def test_replay_at_an_even_step_writes_even_rows(run_json, model, drive, tmp_path):
    out = tmp_path / "rows.parquet"
    found = run_json("replay", "--model", model, drive, *judged(), "--dt", "2.5", "-o", str(out))
    time = pd.read_parquet(out)["time_s"]
    np.testing.assert_allclose(np.diff(time), 2.5)
    assert found["settled"]["rmse"] < 0.012


def test_soc0_is_auto_a_number_or_found(run_json, model, drive):
    auto = run_json("simulate", "--model", model, drive)["soc0"]
    assert auto == run_json("simulate", "--model", model, drive, "--soc0", "auto")["soc0"]
    assert abs(auto["value"] - 0.99701) < 2.0 * auto["std"]
    assert "rest" in auto["how"] or "whole log" in auto["how"]
    given = run_json("simulate", "--model", model, drive, "--soc0", "0.25")["soc0"]
    assert (given["value"], given["how"]) == (0.25, "given")


def test_a_log_under_load_from_its_first_row(run_json, model, drive, tmp_path):
    log = read_log(drive)
    start = int(np.flatnonzero(np.abs(log.current_A) > 1.0)[200])
    rows = pd.read_parquet(drive).iloc[start:]
    path = tmp_path / "middle.parquet"
    rows.to_parquet(path)
    found = run_json("simulate", "--model", model, str(path))["soc0"]
    assert "whole log" in found["how"]
    truth = 0.99701 - log.charge_Ah[start] / 5.1532
    assert abs(found["value"] - truth) < 0.03
    assert abs(found["value"] - truth) < 3.0 * found["std"]


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".parquet"])
def test_a_converted_log_reads_back_to_the_bit(run_json, drive, tmp_path, suffix):
    out = tmp_path / f"tidy{suffix}"
    found = run_json("convert", drive, "-o", str(out))
    assert found["output"] == str(out)
    before, after = read_log(drive), read_log(out)
    assert found["samples"] == len(after)
    for name in ("time_s", "current_A", "voltage_V", "charge_Ah", "temperature_C"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))


def test_the_sign_can_be_stated(run_json, drive, tmp_path):
    rows = pd.read_parquet(drive)
    rows["current_A"] *= -1.0
    rows["ampere_hours"] *= -1.0
    path, out = tmp_path / "charge.csv", tmp_path / "tidy.csv"
    rows.to_csv(path, index=False)
    run_json("convert", str(path), "--sign", "charge-positive", "-o", str(out))
    np.testing.assert_allclose(read_log(out).current_A, read_log(drive).current_A)
    assert run_json("inspect", str(path))["sign"] == "contradicted"


@pytest.mark.slow
def test_a_log_of_a_temperature_makes_an_axis(run_json, tmp_path):
    nmc, out = datasets_folder() / "nmc", tmp_path / "two.json"
    found = run_json("identify", "--hppc", f"{nmc / 'hppc.parquet'}@25", "--hppc",
                     f"{nmc / 'hppc_p00.parquet'}@0", "--nominal-ah", "5", "--no-refine",
                     "-o", str(out))  # fmt: skip
    assert found["temperatures_C"] == [0.0, 25.0]
    assert json.loads(out.read_text())["temperature_C"] == [0.0, 25.0]


def test_what_is_not_a_number_becomes_null():
    value = {
        "a": float("nan"),
        "b": np.float64("inf"),
        "c": np.array([1.0, np.nan]),
        3: (np.int8(2),),
    }
    assert clean(value) == {"a": None, "b": None, "c": [1.0, None], "3": [2]}


def test_people_get_the_same_figures(capsys, model, drive, run_json):
    found = run_json("simulate", "--model", model, drive)
    assert main(["simulate", "--model", model, drive]) == 0
    text = capsys.readouterr().out
    assert main(["inspect", drive]) == 0
    assert main(["replay", "--model", model, drive]) == 0
    others = capsys.readouterr().out
    assert "sign (positive = discharge)" in others
    assert "final SOC" in others
    assert f"{1e3 * found['rmse_V']:.1f}" in text
    assert f"{1e3 * found['rmse_above_10pct_V']:.1f} mV" in text
