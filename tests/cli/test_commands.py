"""Every command through `main`: what it prints, what it refuses, what it writes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest

from cellwise.cell.model_file import read_model
from cellwise.cli import main
from cellwise.data import datasets_folder
from cellwise.logs import read_log, write_log

DATA = datasets_folder()
HPPC = str(DATA / "nmc" / "hppc.parquet")
OCV = str(DATA / "nmc" / "ocv_c20.parquet")
CAP = str(DATA / "nmc" / "cap_c3.parquet")
DRIVE = str(DATA / "nmc" / "drive_b.parquet")


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("model") / "nmc.json"
    tests = ["--hppc", HPPC, "--ocv", OCV, "--nominal-ah", "5"]
    assert main(["identify", *tests, "-o", str(path)]) == 0
    return path


def run_json(capsys, *arguments: str) -> dict:
    """Run a command that must succeed; its standard output is exactly one JSON object."""
    assert main([*arguments, "--json"]) == 0
    out = capsys.readouterr().out
    assert out.count("\n") == 1
    found = json.loads(out)
    assert isinstance(found, dict)
    return found


def refused(capsys, *arguments: str) -> str:
    """Run a command that must be refused; its one message on standard error."""
    assert main(list(arguments)) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Traceback" not in captured.err
    message = captured.err.strip()
    assert message.startswith(f"cellwise {arguments[0]}: found ")
    assert "; expected " in message
    return message


class TestInspectAndConvert:
    def test_keys_of_the_contract(self, capsys):
        found = run_json(capsys, "inspect", DRIVE)
        for key in ("format", "samples", "duration_s", "sign", "gaps", "duplicates", "current_A",
                    "voltage_V", "temperature_C", "charge_Ah", "notices"):  # fmt: skip
            assert key in found
        assert found["sign"] == "verified"
        assert set(found["current_A"]) == {"min", "max"}
        assert found["samples"] == len(read_log(DRIVE))

    @pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".parquet"])
    def test_round_trip(self, capsys, tmp_path, suffix):
        out = tmp_path / f"tidy{suffix}"
        run_json(capsys, "convert", DRIVE, "-o", str(out))
        before, after = read_log(DRIVE), read_log(out)
        for name in ("time_s", "current_A", "voltage_V", "charge_Ah"):
            np.testing.assert_array_equal(getattr(before, name), getattr(after, name))

    def test_other_sign_is_seen_and_can_be_overridden(self, capsys, tmp_path):
        log = read_log(DRIVE)
        wrong = tmp_path / "wrong.csv"
        write_log(type(log)(log.time_s, -log.current_A, log.voltage_V, None, -log.charge_Ah), wrong)
        assert run_json(capsys, "inspect", str(wrong))["sign"] == "contradicted"
        found = run_json(capsys, "inspect", str(wrong), "--sign", "charge-positive")
        assert found["sign"] == "verified"

    @pytest.mark.parametrize(
        "content", [b"", b"time_s,current_A,voltage_V\n", b"\x00\x01\x02", b"a,b,c\n1,2,3\n4,5,6\n"]
    )
    def test_refused_files(self, capsys, tmp_path, content):
        bad, out = tmp_path / "bad.csv", tmp_path / "out.csv"
        bad.write_bytes(content)
        refused(capsys, "inspect", str(bad))
        refused(capsys, "convert", str(bad), "-o", str(out))
        assert not out.exists()

    def test_missing_file(self, capsys, tmp_path):
        refused(capsys, "inspect", str(tmp_path / "none.csv"))

    def test_an_existing_file_survives_a_failure(self, capsys, tmp_path):
        out = tmp_path / "kept.csv"
        out.write_text("precious")
        refused(capsys, "convert", str(tmp_path / "none.csv"), "-o", str(out))
        assert out.read_text() == "precious"


class TestIdentify:
    def test_keys_of_the_contract(self, capsys, tmp_path):
        out = tmp_path / "m.json"
        found = run_json(capsys, "identify", "--hppc", HPPC, "--ocv", OCV, "--capacity", CAP,
                         "--nominal-ah", "5", "-o", str(out))  # fmt: skip
        assert set(found["pulses"]) == {"healthy", "trimmed", "distorted", "spurious"}
        assert set(found["fit"]) >= {"rmse_V", "mae_V", "max_error_V"}
        for key in ("capacity_Ah", "capacity_choice", "capacities", "seconds"):
            assert key in found
        assert found["capacities"][found["capacity_choice"]] == found["capacity_Ah"]
        assert {"nominal", "cc-average", "cc-cv-average", "hppc-total", "rate:C/20"} <= set(
            found["capacities"]
        )
        assert json.loads(out.read_text())["schema_version"] == 1
        assert read_model(out).capacity_Ah == found["capacity_Ah"]

    def test_the_capacity_choice_is_taken(self, capsys, tmp_path):
        found = run_json(capsys, "identify", "--hppc", HPPC, "--ocv", OCV, "--nominal-ah", "5",
                         "--capacity-choice", "nominal", "--no-refine",
                         "-o", str(tmp_path / "m"))  # fmt: skip
        assert found["capacity_Ah"] == 5.0

    @pytest.mark.parametrize(
        ("extra", "says"),
        [
            (["--capacity-choice", "rate:7C"], "capacity choice"),
            (["--hppc", "nowhere.csv"], "nowhere.csv"),
            (["--hppc", f"{HPPC}@warm"], "LOG@TEMPERATURE"),
            (["--hppc", f"{HPPC}@298"], "298 degC"),
        ],
    )
    def test_refusals_write_nothing(self, capsys, tmp_path, extra, says):
        out = tmp_path / "m.json"
        message = refused(
            capsys, "identify", "--hppc", HPPC, "--nominal-ah", "5", *extra, "-o", str(out)
        )
        assert says in message
        assert not out.exists()

    def test_nothing_given(self, capsys, tmp_path):
        assert "HPPC" in refused(capsys, "identify", "-o", str(tmp_path / "m.json"))

    def test_swapped_sign_names_the_option(self, capsys, tmp_path):
        log = read_log(HPPC)
        wrong = tmp_path / "wrong.parquet"
        write_log(type(log)(log.time_s, -log.current_A, log.voltage_V), wrong)
        message = refused(
            capsys, "identify", "--hppc", str(wrong), "--nominal-ah", "5", "-o", str(tmp_path / "m")
        )
        assert "--sign" in message

    def test_a_log_that_never_rests(self, capsys, tmp_path):
        t = np.arange(3000.0)
        wave = 2.0 + np.sin(t / 20.0)
        path = tmp_path / "busy.csv"
        rows = np.column_stack((t, wave, 4.0 - 0.05 * wave - 1e-4 * t))
        np.savetxt(path, rows, delimiter=",", header="time_s,current_A,voltage_V", comments="")
        refused(
            capsys, "identify", "--hppc", str(path), "--nominal-ah", "3", "-o", str(tmp_path / "m")
        )


class TestSimulateAndReplay:
    def test_simulate_keys_and_file(self, capsys, tmp_path, model):
        out = tmp_path / "sim.parquet"
        found = run_json(capsys, "simulate", "--model", str(model), DRIVE, "-o", str(out))
        for key in ("rmse_V", "mae_V", "max_error_V", "mean_error_V", "std_error_V", "ci95_V",
                    "rmse_above_10pct_V", "bands", "samples", "seconds", "soc0"):  # fmt: skip
            assert key in found
        assert found["soc0"]["value"] == pytest.approx(1.0, abs=0.02)
        rows = pyarrow.parquet.read_table(out).to_pydict()
        error = np.array(rows["error_V"])
        assert np.sqrt(np.nanmean(error**2)) == pytest.approx(found["rmse_V"], rel=1e-12)
        low, high = found["ci95_V"]
        assert high - low == pytest.approx(2 * 1.96 * found["std_error_V"], rel=1e-12)

    @pytest.mark.parametrize("estimator", ["coulomb", "ekf"])
    def test_replay_keys_and_file(self, capsys, tmp_path, model, estimator):
        out = tmp_path / "soc.csv"
        found = run_json(capsys, "replay", "--model", str(model), DRIVE, "--estimator", estimator,
                         "--soc0", "0.7", "--reference-soc0", "1", "--reference-capacity-ah",
                         "5.15", "-o", str(out))  # fmt: skip
        for key in ("estimator", "samples", "soc_final", "soc_rmse", "soc_mae", "soc_max_error",
                    "convergence_s", "settled", "coverage_2sigma", "nis_mean", "voltage_rmse_V",
                    "ns_per_step"):  # fmt: skip
            assert key in found
        assert set(found["settled"]) == {"rmse", "mae", "max"}
        assert found["estimator"] == estimator
        columns = pyarrow.csv.read_csv(out).column_names
        assert columns[:5] == ["time_s", "soc", "soc_std", "voltage_V", "innovation_V"]
        if estimator == "ekf":
            assert found["settled"]["rmse"] < 0.02
        else:  # counting can never correct its start
            assert found["soc_rmse"] == pytest.approx(0.3, abs=0.03)

    def test_without_a_reference_there_is_no_judgement(self, capsys, model):
        found = run_json(capsys, "replay", "--model", str(model), DRIVE)
        assert found["soc_rmse"] is None
        assert found["convergence_s"] is None

    def test_even_step(self, capsys, model):
        log = read_log(DRIVE)
        found = run_json(capsys, "replay", "--model", str(model), DRIVE, "--dt", "10")
        assert found["samples"] == int(log.duration_s // 10) + 1

    @pytest.mark.parametrize(
        ("arguments", "says"),
        [
            (["--soc0", "1.5"], "start SOC of 1.5"),
            (["--soc0", "80"], "Divide by 100"),
            (["--soc0", "full"], "--soc0 full"),
            (["--soc0", "nan"], "start SOC"),
            (["--estimator", "crystal-ball"], "crystal-ball"),
            (["--dt", "0"], "time step"),
            (["--reference-capacity-ah", "-3"], "reference capacity"),
            (["-o", "rows.xlsx"], "rows.xlsx"),
        ],
    )
    def test_replay_refusals(self, capsys, model, arguments, says):
        assert says in refused(capsys, "replay", "--model", str(model), DRIVE, *arguments)

    def test_model_files_that_are_none(self, capsys, tmp_path, model):
        newer = json.loads(model.read_text())
        newer["schema_version"] = 99
        for text, says in (
            (json.dumps(newer), "schema_version"),
            (model.read_text()[:200], "not JSON"),
            ("[]", "not a cellwise model"),
        ):
            path = tmp_path / "other.json"
            path.write_text(text)
            assert says in refused(capsys, "simulate", "--model", str(path), DRIVE)
        refused(capsys, "simulate", "--model", str(tmp_path / "none.json"), DRIVE)

    def test_debug_raises(self, model):
        from cellwise import InputError

        with pytest.raises(InputError):
            main(["replay", "--model", str(model), DRIVE, "--soc0", "2", "--debug"])


class TestTheRest:
    def test_data_list(self, capsys):
        found = run_json(capsys, "data", "list")
        assert {"nmc_hppc", "lfp_cdc"} <= {e["name"] for e in found["embedded"]}
        assert all(o["licence"] for o in found["originals"])

    def test_data_generate_without_pybamm_or_name(self, capsys, tmp_path):
        message = refused(capsys, "data", "generate", "-o", str(tmp_path), "--only", "no_such_test")
        assert "no_such_test" in message or "pip install" in message

    def test_people_get_tables(self, capsys, model):
        assert main(["inspect", DRIVE]) == 0
        assert main(["simulate", "--model", str(model), DRIVE]) == 0
        assert main(["replay", "--model", str(model), DRIVE]) == 0
        out = capsys.readouterr().out
        assert "sign (positive = discharge)" in out
        assert "RMSE above 10 % SOC" in out
        assert "final SOC" in out

    def test_unknown_command_exits_2(self):
        with pytest.raises(SystemExit) as stop:
            main(["conjure"])
        assert stop.value.code == 2

    def test_installed_command(self):
        program = Path(sys.executable).with_name("cellwise")
        if not program.exists():
            pytest.skip("cellwise is importable here but not installed: no command to run")
        done = subprocess.run([program, "--version"], capture_output=True, text=True, check=True)
        assert done.stdout.startswith("cellwise ")

    def test_importing_cellwise_loads_no_compiler(self):
        code = "import cellwise, sys; print([m for m in ('numba', 'scipy') if m in sys.modules])"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert done.stdout.strip() == "[]"
