"""A wrong log is refused or said first, by every command that has a model."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from cellwise import InputError, load_dataset, read_model, replay, simulate, write_log
from cellwise.diagnose import diagnose
from cellwise.notices import texts

LARGE_V = 0.2


@pytest.fixture
def wrong(tmp_path):
    """Write a changed drive; its path."""

    def write(factor_A=1.0, factor_V=1.0, name="nmc_drive_b"):
        log = load_dataset(name)
        charge = None if log.charge_Ah is None else factor_A * log.charge_Ah
        log = replace(log, current_A=factor_A * log.current_A, charge_Ah=charge,
                      voltage_V=factor_V * log.voltage_V)  # fmt: skip
        return str(write_log(log, tmp_path / "wrong.parquet"))

    return write


@pytest.mark.parametrize("command", ["simulate", "replay"])
@pytest.mark.parametrize("cells", [2, 3, 4, 12])
def test_a_pack_is_asked_for_its_cells(refused, model, wrong, command, cells):
    said = refused(command, "--model", model, wrong(factor_V=cells))
    assert f"Give --series {cells}." in said


@pytest.mark.parametrize("command", ["simulate", "replay"])
def test_a_cell_read_as_a_pack_is_refused(refused, model, wrong, command):
    assert "--series" in refused(command, "--model", model, wrong(), "--series", "4")


def test_a_pack_with_its_cells_is_taken(run_json, model, wrong):
    found = run_json("simulate", "--model", model, wrong(factor_V=4.0), "--series", "4")
    assert found["rmse_V"] < 0.02


def test_ten_times_the_current_is_said_first(run_json, model, wrong):
    found = run_json("simulate", "--model", model, wrong(factor_A=10.0))
    assert "times the model's capacity" in found["notices"][0]
    assert "outside 0..1" in found["notices"][0]


def test_no_deviation_of_hundreds_of_millivolts_without_a_notice(run_json, model, wrong):
    for soc0 in ("1", "0.9", "0.7", "0.3"):
        found = run_json("simulate", "--model", model, wrong(), "--soc0", soc0)
        if found["max_error_V"] >= LARGE_V:
            assert any(f"{1e3 * found['max_error_V']:.0f} mV off" in n for n in found["notices"])
        else:
            assert not any("mV off" in n for n in found["notices"])
    assert found["max_error_V"] > LARGE_V


@pytest.mark.parametrize("soc0", [0.05, 0.3, 1.0])
def test_a_soc_outside_is_always_said(model, soc0):
    found = simulate(read_model(model), load_dataset("nmc_drive_b"), soc0)
    outside = found.soc.min() < -0.001 or found.soc.max() > 1.001
    assert any("outside 0..1" in n for n in texts(found.notices)) == outside
    assert outside == (soc0 < 0.5)


def test_a_good_log_has_nothing_said(run_json, model, drive):
    for command in ("simulate", "replay"):
        assert run_json(command, "--model", model, drive)["notices"] == []


def test_fleet_says_it_in_the_log_s_row(run_json, model, wrong, tmp_path):
    from pathlib import Path

    import pyarrow.parquet

    folder = Path(wrong(factor_V=4.0)).parent
    write_log(load_dataset("lfp_cdc"), folder / "other.parquet")
    out = tmp_path.parent / f"{tmp_path.name}_out"
    run_json("fleet", "replay", "--model", model, str(folder), "-o", str(out))
    rows = [
        r for part in out.glob("*.parquet") for r in pyarrow.parquet.read_table(part).to_pylist()
    ]
    by_log = {row["log"]: row for row in rows}
    assert "`series=4`" in by_log["wrong.parquet"]["error"]
    assert "another cell" in by_log["other.parquet"]["notices"]


def test_a_stream_of_a_pack_is_refused(refused, model, tmp_path):
    stream = tmp_path / "stream.json"
    rows = [{"time_s": k, "current_A": 1.0, "voltage_V": 15.5} for k in range(5)]
    stream.write_text("\n".join(json.dumps(r) for r in rows) + "\n")
    assert "cells in series" in refused("live", "--model", model, "--source", f"json:{stream}")


def test_a_filter_that_uses_no_voltage_says_so(model):
    log = load_dataset("nmc_drive_b")
    lost = replace(log, voltage_V=np.full(len(log), 20.0))
    assert "no voltage of" in replay(read_model(model), lost, "ekf", soc0=0.9).notices[0].text
    assert not any(
        "no voltage of" in n for n in texts(replay(read_model(model), log, "coulomb").notices)
    )


@pytest.mark.parametrize("logs", ["x", ["x"], [None]])
def test_a_diagnosis_of_what_is_no_log_says_so(model, logs):
    with pytest.raises(InputError, match="log"):
        diagnose(read_model(model), logs)
