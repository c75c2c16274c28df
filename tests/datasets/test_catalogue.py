"""The catalogue tells the truth about the files beside it, the registry all about originals."""

from __future__ import annotations

import hashlib
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

FOLDER = Path(__file__).resolve().parents[2] / "datasets"
CATALOGUE = tomllib.loads((FOLDER / "catalogue.toml").read_text(encoding="utf-8"))["dataset"]
NAMES = [entry["name"] for entry in CATALOGUE]

LARGEST_FILE = 1_000_000
LARGEST_SET = 4_000_000


def columns(entry: dict[str, Any]) -> dict[str, np.ndarray]:
    table = pq.read_table(FOLDER / entry["file"])
    return {name: table[name].to_numpy() for name in table.column_names}


@pytest.fixture(params=CATALOGUE, ids=NAMES)
def entry(request: pytest.FixtureRequest) -> dict[str, Any]:
    return request.param


def test_catalogue_and_folder_hold_the_same_files():
    listed = sorted(entry["file"] for entry in CATALOGUE)
    present = sorted(path.relative_to(FOLDER).as_posix() for path in FOLDER.rglob("*.parquet"))
    assert listed == present
    assert len(set(NAMES)) == len(NAMES)


def test_size_stays_small_enough_for_a_clone():
    sizes = [(FOLDER / entry["file"]).stat().st_size for entry in CATALOGUE]
    assert max(sizes) <= LARGEST_FILE
    assert sum(sizes) <= LARGEST_SET


def test_hash_bytes_and_rows_are_those_of_the_file(entry):
    path = FOLDER / entry["file"]
    content = path.read_bytes()
    assert hashlib.sha256(content).hexdigest() == entry["sha256"]
    assert len(content) == entry["bytes"]
    assert pq.ParquetFile(path).metadata.num_rows == entry["rows"]


# What the files hold, whose hashes are checked above: true again after a file is made again.
@pytest.mark.slow
def test_the_tidy_form_whose_counter_is_the_sum_of_the_currents_that_end_at_the_rows(entry):
    log = columns(entry)
    thermocouple = ["temperature_C"] if entry["name"].startswith("nmc") else []
    expected = ["time_s", "current_A", "voltage_V", *thermocouple, "ampere_hours", "step"]
    assert list(log) == expected
    assert all(np.isfinite(values).all() for values in log.values())
    assert log["step"].dtype == np.int32
    assert log["time_s"][0] == log["ampere_hours"][0] == 0.0
    steps = np.diff(log["time_s"])
    charge = np.concatenate(([0.0], np.cumsum(log["current_A"][1:] * steps))) / 3600.0
    # White current noise of 0.02 % of the range and stamps rounded to 1 ms, both at 5 sigma.
    range_A = next(r for r in (1.0, 5.0, 10.0, 20.0) if r >= np.abs(log["current_A"]).max())
    active = log["current_A"][1:] != 0.0
    noise = 2e-4 * range_A * np.sqrt(np.sum(steps[active] ** 2))
    stamps = np.abs(np.diff(log["current_A"])).max() * 1e-3 * np.sqrt(steps.size)
    bound = 1e-4 + 5.0 * (noise + stamps) / 3600.0
    assert np.abs(charge - log["ampere_hours"]).max() < bound
    # The other meaning of a row, or the other sign, is far outside.
    assert np.abs(charge + log["ampere_hours"]).max() > 100.0 * bound
    moved = log["ampere_hours"][-1] / entry["true_capacity_Ah"]
    assert entry["initial_soc"] - entry["final_soc"] == pytest.approx(moved, abs=1e-4)
    assert 0.98 < entry["initial_soc"] <= 1.0


# The registry says of every public original what a person needs to find and judge it.
ORIGINALS = tomllib.loads((FOLDER / "registry.toml").read_text(encoding="utf-8"))["original"]
TEXTS = ("name", "cell", "chemistry", "lab", "doi", "url", "licence", "sign")
LISTS = ("window_V", "tests", "temperatures_C", "flaws")


@pytest.mark.parametrize("original", ORIGINALS, ids=[entry["name"] for entry in ORIGINALS])
def test_every_catalogue_entry_is_complete(original):
    assert original.get("listing", "https://").startswith("https://")
    assert set(original) - {"listing"} == {*TEXTS, *LISTS, "nominal_Ah", "used_by_tests"}
    assert all(isinstance(original[key], str) and original[key] for key in TEXTS)
    assert all(isinstance(original[key], list) and original[key] for key in LISTS)
    assert 0.0 < original["window_V"][0] < original["window_V"][1] < 5.0
    assert original["nominal_Ah"] > 0.0
    assert isinstance(original["used_by_tests"], bool)
    assert original["doi"].startswith("10.") or original["doi"] in ("none", "not verified")


def test_names_of_data_sets_are_unique():
    names = [entry["name"] for entry in ORIGINALS]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(
    "original",
    [entry for entry in ORIGINALS if entry["used_by_tests"]],
    ids=[entry["name"] for entry in ORIGINALS if entry["used_by_tests"]],
)
def test_entry_used_by_tests_has_its_folder(original, real_data):
    assert (real_data / original["name"]).is_dir()
