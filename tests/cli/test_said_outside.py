"""A model of 25 degC in the cold: every command that uses it says so, first, with numbers."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from cellwise.cli import main
from cellwise.estimate.status import OUTSIDE
from cellwise.logs import read_log, write_log
from cellwise.logs.cell_log import CellLog
from streams import json_lines

SAID = "leaves what the model's data covered"
ROWS = 1200


@pytest.fixture(scope="module")
def logs(drive, tmp_path_factory) -> tuple[CellLog, CellLog]:
    """The drive as it was, and one that is said to have cooled down to -12 degC for 25 %."""
    warm = read_log(drive).part(0, ROWS)
    cold = np.where(np.arange(ROWS) < 0.75 * ROWS, 25.0, -12.0)
    return warm, replace(warm, temperature_C=cold)


@pytest.fixture
def cold(logs, tmp_path) -> str:
    place = tmp_path / "cold" / "cold.parquet"
    place.parent.mkdir()
    write_log(logs[1], place)
    return str(place)


def test_identify_prints_and_writes_it(identified):
    printed = identified.printed["validity"]
    assert json.loads(identified.path.read_text())["validity"] == printed
    assert printed["soc"][0] < 0.05
    assert printed["soc"][1] > 0.95
    for low, high in (printed["temperature_C"], printed["current_A"]):
        assert low < high


@pytest.mark.parametrize("command", ["simulate", "replay"])
def test_rows_outside_the_model_s_temperatures_are_said_first(command, model, cold, run_json):
    notices = run_json(command, "--model", model, cold)["notices"]
    assert SAID in notices[0]
    assert "25 % of the rows are below" in notices[0]
    assert "to -12" in notices[0]


def test_what_is_stated_of_a_log_counts_too(model, logs, tmp_path, run_json):
    place = tmp_path / "unmeasured.parquet"
    write_log(replace(logs[0], temperature_C=None), place)
    assert not any(SAID in n for n in run_json("simulate", "--model", model, str(place))["notices"])
    found = run_json("simulate", "--model", model, f"{place}@-20")["notices"]
    assert "100 % of the rows are below" in found[0]


def test_a_stream_says_so_once(model, logs, tmp_path, capsys):
    place, out = tmp_path / "stream.jsonl", tmp_path / "out.jsonl"
    source = json_lines(logs[1], place)
    assert main(["live", "--model", model, "--source", source, "-o", str(out), "--json"]) == 0
    said = capsys.readouterr()
    assert said.err.count("temperature -12.0 degC (the model's data:") == 1
    states = [json.loads(line) for line in out.read_text().splitlines()]
    flagged = ["OUTSIDE" in s["flags"] for s in states]
    assert json.loads(said.out)["outside"] == sum(flagged) == 0.25 * ROWS
    change = flagged.index(True)
    assert not any(flagged[:change])
    widths = [s["soc_std"] for s in states[change - 1 :]]
    # Five minutes of voltages from outside its data make a filter hardly surer.
    assert widths[-1] > 0.98 * widths[0]
    assert all(b >= 0.999 * a for a, b in pairwise(widths[:50]))


def test_a_fleet_s_row_says_what_lies_outside_the_model(model, cold, tmp_path, run_json):
    pytest.importorskip("distributed")
    import pyarrow.parquet

    folder = cold.rpartition("/")[0]
    more = ("-o", str(tmp_path / "out"), "--scheduler", "local", "--workers", "1")
    run_json("fleet", "replay", "--model", model, folder, *more)
    row = pyarrow.parquet.read_table(tmp_path / "out").to_pylist()[0]
    assert row["notices"].find(SAID) in range(30)
    assert row["status"] & OUTSIDE
