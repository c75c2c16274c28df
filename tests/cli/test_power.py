"""The state of power by the commands: columns, JSON, JSON lines, a page, refusals."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from cellwise.cli import main
from cellwise.logs import read_log, write_log
from streams import json_lines

MODEL = ("--model", "nmc-18650", "--capacity-ah", "5")
NAMES = [
    f"{way}_power_{horizon}s_{bound}W"
    for horizon in (2, 10, 30)
    for way in ("discharge", "charge")
    for bound in ("", "low_")
]


@pytest.fixture(scope="module")
def part(drive, tmp_path_factory):
    """Ten minutes of a drive, as a log and as a stream."""
    log = read_log(drive).part(0, 600)
    folder = tmp_path_factory.mktemp("part")
    write_log(log, folder / "part.csv")
    json_lines(log, folder / "part.jsonl")
    return folder


@pytest.mark.slow
def test_replay_writes_columns_and_says_within_what(part, run_json, tmp_path):
    out, page = tmp_path / "out.csv", tmp_path / "page.html"
    log = str(part / "part.csv")
    found = run_json(
        "replay", *MODEL, log, "--soc0", "0.9", "--power", "-o", str(out), "--report", str(page)
    )
    rows = pd.read_csv(out)
    assert [name for name in rows.columns if "power" in name] == NAMES
    assert (rows[NAMES] >= 0.0).all(axis=None)
    power = found["power"]
    assert power["hold"] == "power"
    assert power["limits_from"]["voltage_min_V"] == "model"
    assert power["limits_from"]["discharge_A"] == "data"
    assert [h["horizon_s"] for h in power["horizons"]] == [2.0, 10.0, 30.0]
    last = rows["discharge_power_10s_W"].iloc[-1]
    assert power["horizons"][1]["discharge_power_W"] == pytest.approx(last, rel=2e-5)
    assert "State of power" in page.read_text(encoding="utf-8")
    assert any("largest currents of the model's data" in n for n in found["notices"])
    # The same without: nothing of it, and the same rows.
    plain = tmp_path / "plain.csv"
    without = run_json("replay", *MODEL, log, "--soc0", "0.9", "-o", str(plain))
    assert "power" not in without
    assert pd.read_csv(plain).equals(rows.drop(columns=NAMES))


@pytest.mark.slow
def test_limits_and_horizons_as_given(part, run_json, capsys):
    options = ("--power", "--horizons", "5", "--voltage-limits", "3.2", "4.3", "--current-limits",
               "7", "3", "--soc-limits", "0.1", "0.95", "--hold", "current")  # fmt: skip
    log = str(part / "part.csv")
    found = run_json("replay", *MODEL, log, "--soc0", "0.7", *options)["power"]
    assert found["hold"] == "current"
    assert set(found["limits_from"].values()) == {"given"}
    (only,) = found["horizons"]
    assert only["horizon_s"] == 5.0
    assert only["discharge_current_A"] <= 7.0
    assert only["charge_current_A"] == pytest.approx(3.0, rel=1e-5)
    assert main(["replay", *MODEL, log, "--soc0", "0.7", *options]) == 0
    assert "at least (95 %) [W]" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_live_says_the_same_as_replay(part, run_json, tmp_path):
    out, lines = tmp_path / "out.csv", tmp_path / "lines.jsonl"
    start = ("--soc0", "0.9", "--soc0-std", "0.05", "--power")
    run_json("replay", *MODEL, str(part / "part.csv"), *start, "-o", str(out))
    found = run_json(
        "live", *MODEL, "--source", f"json:{part / 'part.jsonl'}", *start, "-o", str(lines)
    )
    rows = pd.read_csv(out)
    for name in NAMES:
        assert found[name] == pytest.approx(rows[name].iloc[-1], rel=1e-4)
    said = [json.loads(line) for line in lines.read_text().splitlines()]
    with_power = [row for row in said if NAMES[0] in row]
    assert len(with_power) == len([row for row in said if "remaining_s" in row])
    by_time = np.searchsorted(rows["time_s"], with_power[20]["time_s"])
    assert with_power[20][NAMES[4]] == pytest.approx(rows[NAMES[4]][by_time], rel=1e-4)
