"""Empty by the user's own limit: a load that ends there says how much the cell holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from prior_cells import CAPACITY_AH, other_cell

from cellwise.cell.simulate import simulate
from cellwise.cell.stock import stock_model
from cellwise.data import list_datasets, load_dataset
from cellwise.identify import IdentifySettings, TestLogs, identify_cell
from cellwise.identify.prior.update import left_at, lowest_row
from cellwise.logs.cell_log import CellLog


def discharge(rate, limit_V=2.8):
    """A discharge of a cell of the kind from full to its lower limit, then a rest."""
    n = int(3600.0 / rate * 1.1)
    current = np.concatenate((np.zeros(30), np.full(n, rate * CAPACITY_AH)))
    log = CellLog(np.arange(current.size, dtype=float), current, np.full(current.size, 3.7))
    voltage = simulate(other_cell(), log, 1.0).voltage_V
    last = int(np.argmax(voltage < limit_V))
    rest = np.where(np.arange(current.size) < last, current, 0.0)
    whole = replace(log, current_A=rest).part(0, last + 600)
    return replace(whole, voltage_V=simulate(other_cell(), whole, 1.0).voltage_V)


def test_the_end_is_the_last_loaded_row_at_the_limit():
    log = discharge(1.0)
    row, charge_Ah = lowest_row(log), log.counted_charge_Ah()
    assert log.current_A[row] > 0.0
    assert log.voltage_V[row] == pytest.approx(2.8, abs=0.02)
    assert charge_Ah[row] == pytest.approx(np.max(charge_Ah), rel=2e-3)


def test_a_log_that_only_stops_is_no_end():
    left, std = left_at(np.array([3.3, 2.8]), np.array([3.5, 3.5]), np.array([0.1, 0.1]))
    assert np.isinf(std[0])
    assert left[1] < 3.0 * std[1] < 0.1


def test_an_end_above_the_lowest_limit_of_all_leaves_more():
    left, std = left_at(np.array([3.0, 2.8]), np.full(2, 3.5), np.full(2, 0.2))
    assert left[0] > left[1]
    assert std[0] > std[1]


def test_a_larger_drop_leaves_more_and_is_less_sure():
    left, std = left_at(np.full(4, 2.8), np.full(4, 3.5), np.array([0.0, 0.1, 0.2, 0.4]))
    assert np.all(np.diff(left) > 0.0)
    assert np.all(np.diff(std) > 0.0)
    assert 0.0 < left[0] < 0.02


@pytest.mark.slow
def test_one_drive_to_the_limit_gives_the_capacity_by_another_kind():
    """The embedded NMC cell, a physics model, by the NCA stock model: 7 % off without the end."""
    truth = next(d for d in list_datasets() if d["name"] == "nmc_cap_c3")["true_capacity_Ah"]
    settings = IdentifySettings(nominal_Ah=5.0, prior=stock_model("nca-18650"))
    found = identify_cell(TestLogs(drive=((load_dataset("nmc_cap_c3"), None),)), settings)
    assert found.model.capacity_Ah == pytest.approx(truth, rel=0.03)
