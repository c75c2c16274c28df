"""Stock models by name in every command that takes a model, scaled, and as priors."""

from __future__ import annotations

import json

import numpy as np
import pytest

from cellwise import load_dataset, read_model, write_log
from cellwise.cell.stock import stock_names


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A part of a drive of the embedded NMC cell: nobody knows where it began."""
    log = load_dataset("nmc_drive_b")
    soc = 1.0 - log.counted_charge_Ah() / 5.0
    rows = np.flatnonzero((soc < 0.7) & (soc > 0.5))
    path = tmp_path_factory.mktemp("flight") / "flight.csv"
    return str(write_log(log.part(int(rows[0]), int(rows[-1])), path))


@pytest.mark.parametrize("command", ["simulate", "replay"])
def test_a_stock_model_works_at_once(run_json, flight, command):
    found = run_json(command, "--model", "nmc-18650", "--capacity-ah", "5.2", flight)
    assert found["soc0"]["std"] > 0.03


def test_little_known_is_said_by_the_deviation(run_json, flight, tmp_path):
    out = tmp_path / "rows.csv"
    run_json("replay", "--model", "nmc-18650", "--capacity-ah", "5", flight, "-o", str(out))
    std = np.genfromtxt(out, delimiter=",", names=True)["soc_std"]
    assert np.median(std) > 0.02


def test_identify_with_a_stock_model_says_what_its_class_leaves_open(run_json, flight, tmp_path):
    out = tmp_path / "model.json"
    found = run_json("identify", "--drive", flight, "--nominal-ah", "5", "--prior", "nmc-18650",
                "-o", str(out), "--report", str(tmp_path / "page.html"))  # fmt: skip
    assert found["posterior"]["prior"] == "population of layered cells"
    model = read_model(out)
    assert model.posterior.directions == tuple(found["posterior"]["directions"])
    assert 0.01 < model.posterior.capacity_std < 0.1  # of a rating, less than it was
    low, high = model.validity.soc
    soc = np.linspace(0.0, 1.0, model.posterior.ocv_std_V.size)
    seen = (soc > low) & (soc < high)
    assert model.posterior.ocv_std_V[seen].mean() < model.posterior.ocv_std_V[~seen].mean()


def test_a_lineage_that_is_left_out_is_said(run_json, flight, tmp_path):
    found = run_json("identify", "--drive", flight, "--nominal-ah", "5", "--prior", "nmc-18650",
                "--without-lineage", "nmc-18650", "--without-lineage", "lmo-pouch",
                "-o", str(tmp_path / "model.json"))  # fmt: skip
    assert found["posterior"]["prior"].endswith("without lmo-pouch, nmc-18650")


def test_data_list_shows_every_stock_model(run_json):
    listed = {e["name"]: e for e in run_json("data", "list")["stock"]}
    assert set(listed) == set(stock_names())
    assert json.dumps(listed["lfp-26650"]["window_V"]) == "[2.0, 3.6]"
