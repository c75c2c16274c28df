"""The command: one JSON object, tables, a page, what it refuses."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from cellwise.benchmark.figures import COLUMNS
from cellwise.cli import main

SUITE = """
about = "a drive through the identified model"
estimators = ["ekf"]
start_errors = [0.0, -0.3]
faults = ["offset +3 % of 1C", "temperature +3 K", "voltage +30 mV"]
[slow]
start_errors = [-0.3]
faults = ["none"]
dt_s = 30.0
[[cell]]
name = "nmc"
chemistry = "NMC"
model = "{model}"
[[log]]
cell = "nmc"
log = "embedded:nmc_drive_b"
[[log]]
cell = "nmc"
log = "embedded:nmc_flight"
from_soc = 0.7
"""


@pytest.fixture(scope="module")
def suite(identified, tmp_path_factory):
    place = tmp_path_factory.mktemp("benchmark") / "small.toml"
    place.write_text(SUITE.format(model=identified.path.as_posix()), encoding="utf-8")
    return place


@pytest.fixture(scope="module")
def arguments(suite):
    return ["benchmark", str(suite), "-o", str(suite.parent / "out"), "--processes", "1"]


def test_one_object_one_row_per_run(arguments, capsys):
    assert main([*arguments, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert set(told) == {"suite", "rows", "resumed", "parquet", "page"}
    assert all(list(row) == list(COLUMNS) for row in told["rows"])
    assert {r["fault"] for r in told["rows"]} == {"none", "offset +3 % of 1C", "temperature +3 K"}
    ekf = [r for r in told["rows"] if r["estimator"] == "ekf" and r["fault"] == "none"]
    assert {r["log"] for r in ekf} == {"nmc_drive_b", "nmc_flight from 70 %"}
    # From a rest and full the SOC is known; from 70 % under load it is what the model's voltage
    # allows, and the deviation has to say so.
    whole = [r for r in ekf if r["log"] == "nmc_drive_b"]
    assert all(r["settled_rmse"] < 0.005 for r in whole)
    assert all(r["coverage_2sigma"] > 0.9 for r in ekf)
    never = [r for r in told["rows"] if r["estimator"] == "coulomb" and r["start_error"]]
    assert all(r["convergence_s"] is None for r in never)


def test_the_page_has_tables_and_stands_alone(arguments, capsys):
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    for name in ("coulomb", "rest-ocv", "filterpy-ekf", "filterpy-ukf", "ekf"):
        assert name in printed
    assert "from an earlier run" in printed
    text = (Path(arguments[3]) / "index.html").read_text(encoding="utf-8")
    assert text.count("<table") >= 6  # standings, bands, logs, starts, faults twice
    assert not re.search(r'(src|href)="(?!#)', text)
    assert "every run" in text.lower()
    assert "is first of" in text


def test_other_estimators_on_the_same_suite(arguments, capsys):
    assert main([*arguments, "--estimator", "ukf", "--json", "--no-page"]) == 0
    told = json.loads(capsys.readouterr().out)
    names = {r["estimator"] for r in told["rows"]}
    gauges = {"TableGauge", "OneStateEkf"}
    assert names == {"ukf", "coulomb", "rest-ocv", "filterpy-ekf", "filterpy-ukf"} | gauges
    assert told["page"] is None
    assert told["resumed"] > 0


def test_benchmark_lists_every_suite(capsys):
    assert main(["benchmark", "--list", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    names = {s["name"] for s in told["suites"]}
    assert names == {"embedded", "leo", "flight", "panasonic", "a123", "public-1"}
