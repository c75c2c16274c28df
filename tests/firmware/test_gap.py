"""What has flowed unseen in a gap: the SOC's as far as a voltage shows it, stated beyond that."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate
from cellwise.cell.stock import stock_model
from cellwise.estimate.fixed.layout import INPUT
from cellwise.estimate.fixed.step import shown_unseen
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.export.firmware import HostLibrary
from cellwise.logs.cell_log import CellLog

CHEMISTRIES = ("nmc-18650", "nca-18650", "lfp-26650")
ROWS, LATER, DT_S = 2160, 60, 5.0


@pytest.mark.parametrize("seed", range(20))
def test_the_variance_that_a_voltage_shows_is_the_likeliest(seed):
    """Of all up to what may have flowed the one of greatest likelihood."""
    rng = np.random.default_rng(seed)
    unseen, slope_V, known_V2 = 0.0025, rng.uniform(0.01, 1.0), rng.uniform(1e-6, 1e-3)
    off_V = rng.normal() * np.sqrt(known_V2 + 2.0 * unseen * slope_V**2)
    tried = np.linspace(0.0, unseen, 20001)
    variance_V2 = known_V2 + tried * slope_V**2
    likeliest = tried[np.argmin(np.log(variance_V2) + off_V**2 / variance_V2)]
    found = shown_unseen(unseen, off_V, known_V2, slope_V)
    assert found == pytest.approx(likeliest, abs=unseen / 10000)


def over_a_gap(name, off_V, flowed_soc):
    """SOC and deviation of two hours of a drive, one of rest, one without power, and then.

    A cell's own model, sure of 5 mV, whose table is off; the true SOC at the end.
    """
    model = replace(stock_model(name), error=ModelError.of_white_and_slow(0.002, 0.005))
    records = np.zeros(ROWS + LATER, dtype=INPUT)
    driven = np.arange(1440)
    records["current_A"][:1440] = np.where(driven // 12 % 5 < 3, 0.4, -0.1) * model.capacity_Ah
    records["temperature_C"] = 25.0
    records["sequence"] = np.arange(records.size)
    records["sequence"][ROWS:] += 720
    log = CellLog(
        DT_S * np.arange(ROWS),
        records["current_A"][:ROWS].astype(float),
        np.zeros(ROWS),
        temperature_C=np.full(ROWS, 25.0),
    )
    cell = simulate(model, log, 0.8)
    row = int(np.argmin(np.abs(np.asarray(model.temperature_C) - 25.0)))
    soc = cell.soc[-1] - flowed_soc
    moved = np.interp([soc, cell.soc[-1]], model.soc, model.ocv_V[row])
    records["voltage_V"][:ROWS] = cell.voltage_V + off_V
    records["voltage_V"][ROWS:] = cell.voltage_V[-1] + off_V + (moved[0] - moved[1])
    library = HostLibrary(fixed_step_tables(model, DT_S))
    said = library.filter_rows(library.start_filter(11, 0.8, 0.01), records)
    return said["soc"], np.sqrt(said["soc_variance"]), soc


needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")


@needs_compiler
@pytest.mark.parametrize("name", CHEMISTRIES)
def test_a_gap_in_which_nothing_flowed_takes_nothing_away(name):
    """A table that is off was so before: it says nothing of what flowed. The deviation says it."""
    soc, std, _ = over_a_gap(name, 0.02, 0.0)
    assert np.abs(soc[ROWS : ROWS + 12] - soc[ROWS - 1]).max() < 0.002
    assert std[ROWS] > 0.045  # five points may have flowed


@needs_compiler
@pytest.mark.parametrize("name", CHEMISTRIES[:2])
def test_what_has_flowed_in_a_gap_is_found_where_the_voltage_shows_it(name):
    """Six points within five minutes; on an LFP's plateau no voltage shows them."""
    soc, _, true_soc = over_a_gap(name, 0.0, 0.06)
    assert soc[ROWS - 1] - true_soc > 0.05
    assert abs(soc[-1] - true_soc) < 0.015
