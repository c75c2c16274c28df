"""Empty by the user's own limit: a load that ends there says how much the cell holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from prior_cells import CAPACITY_AH, drive_of, other_cell

from cellwise.cell.simulate import simulate
from cellwise.cell.stock import stock_model
from cellwise.data import list_datasets, load_dataset
from cellwise.identify import IdentifySettings, TestLogs, identify_cell
from cellwise.identify.prior.cutoff import EmptyEnd, empty_ends, left_at
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
    (end,) = empty_ends([log], 2.8)
    assert log.current_A[end.row] > 0.0
    assert log.voltage_V[end.row] == pytest.approx(2.8, abs=0.02)
    assert end.charge_Ah == pytest.approx(np.max(log.counted_charge_Ah()), rel=2e-3)
    assert end.above_V == 0.0


def test_a_drive_that_only_stops_is_no_end():
    assert empty_ends([drive_of(other_cell(), 0.8, 0.5)], 2.8) == []


def test_an_end_above_the_lowest_limit_of_all_leaves_more():
    high, low = empty_ends([discharge(1.0, 3.0), discharge(1.0, 2.8)], 2.8)
    assert high.above_V == pytest.approx(0.2, abs=0.02)
    assert left_at(high, 0.2)[0] > left_at(low, 0.2)[0]


def test_a_larger_drop_leaves_more_and_is_less_sure():
    end = EmptyEnd(0, 0, 1.0, 0.0)
    left, std = np.array([left_at(end, drop) for drop in (0.0, 0.1, 0.2, 0.4)]).T
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
