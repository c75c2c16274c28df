"""Stock models: found by name, read as any model, each with source, validity and spread."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.model_file import write_model
from cellwise.cell.stock import (
    list_stock,
    named_model,
    stock_folder,
    stock_model,
    stock_names,
)

NAMES = ("lfp-26650", "lipo-pouch", "lmo-pouch", "nca-18650", "nmc-18650")
LARGEST_BYTES = 60_000


def test_the_names_are_those_that_outside_programs_rely_on():
    assert stock_names() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_stock_model_is_small_and_inside_its_window(name):
    assert (stock_folder() / f"{name}.json").stat().st_size < LARGEST_BYTES
    model = stock_model(name)
    assert model.voltage_min_V is not None
    assert model.voltage_max_V is not None
    assert model.ocv_V.min() > model.voltage_min_V - 0.25
    # The LiPo of the measurements was charged to 4.1 V only; its full OCV is the prior's.
    assert model.ocv_V.max() < model.voltage_max_V + 0.15


@pytest.mark.parametrize("entry", list_stock(), ids=lambda e: e["name"])
def test_every_entry_says_where_it_is_from_and_how_far_it_holds(entry):
    assert entry["source"]["licence"]
    assert entry["source"]["logs"]
    low, high = entry["validity"]["temperature_C"]
    assert low < high
    assert entry["spread"]["ocv_V"] > 0.0
    assert entry["spread"]["ln_resistance"] > 0.0


@pytest.mark.parametrize("name", NAMES)
def test_the_error_is_that_of_another_cell_not_of_its_own_fit(name):
    model = stock_model(name)
    about = model.provenance["stock"]
    assert np.min(model.error.at(model.soc)) >= about["spread"]["ocv_V"]
    assert model.error.shown_share() >= about["spread"]["ln_resistance"]


def test_a_file_of_that_name_has_precedence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_model(stock_model("lfp-26650"), "nca-18650")
    assert named_model("nca-18650").ocv_V.max() < 4.0
