"""A model scaled to a capacity: n cells in parallel are one cell of n times the capacity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import SelfDischarge, SelfHeating
from cellwise.cell.simulate import simulate
from cellwise.cell.stock import scaled_model, stock_model, stock_names
from cellwise.data import load_dataset


@pytest.mark.parametrize("name", stock_names())
@pytest.mark.parametrize("cells", [0.4, 1.0, 3.0])
def test_parallel_cells_show_the_voltage_of_one(name, cells):
    model = stock_model(name).with_effect(SelfHeating(8.0, 500.0)).with_effect(SelfDischarge(0.01))
    log = load_dataset("nmc_drive_a")
    share = model.capacity_Ah / 5.0
    one = replace(log, current_A=share * log.current_A, charge_Ah=None)
    all_ = replace(log, current_A=cells * share * log.current_A, charge_Ah=None)
    scaled = scaled_model(model, cells * model.capacity_Ah)
    alone, together = simulate(model, one, 0.9), simulate(scaled, all_, 0.9)
    np.testing.assert_allclose(together.voltage_V, alone.voltage_V, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(together.soc, alone.soc, rtol=0.0, atol=1e-12)


def test_the_currents_of_its_data_grow_with_the_cell():
    model = stock_model("nmc-18650")
    low, high = model.validity.current_A
    scaled = scaled_model(model, 2.0 * model.capacity_Ah).validity
    assert scaled.current_A == pytest.approx((2.0 * low, 2.0 * high))
    assert scaled.soc == model.validity.soc
    assert scaled.temperature_C == model.validity.temperature_C
