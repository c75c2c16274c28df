"""CellModel: what it holds, and each thing it refuses."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from cellwise.cell.effects import Hysteresis, SlowDiffusion
from cellwise.cell.point_kernels import COLUMNS, M
from cellwise.errors import InputError
from example_cells import EFFECTS, curved_cell, linear_cell, random_model


def falling(points=11):
    ocv = np.linspace(3.0, 4.0, points)
    ocv[5] = ocv[4] - 1e-6
    return ocv


def with_nan(points=11):
    table = np.full(points, 0.02)
    table[3] = np.nan
    return table


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"capacity_Ah": 0.0}, "capacity_Ah"),
        ({"capacity_Ah": -3.0}, "capacity_Ah"),
        ({"capacity_Ah": np.nan}, "capacity_Ah"),
        ({"capacity_Ah": np.inf}, "capacity_Ah"),
        ({"charge_efficiency": 99.0}, "fraction"),
        ({"charge_efficiency": 0.4}, "charge_efficiency"),
        ({"charge_efficiency": np.nan}, "charge_efficiency"),
        ({"ocv_V": falling()}, "falls with SOC near SOC 0.4"),
        ({"ocv_V": with_nan()}, "ocv_V with missing values"),
        ({"ocv_V": np.array([3.7])}, "two SOC points"),
        ({"ocv_V": np.full((2, 11), 3.7)}, "1 temperature"),
        ({"ocv_V": np.full((1, 11, 2), 3.7)}, "shape"),
        ({"r0_ohm": np.full(10, 0.02)}, "r0_ohm of shape"),
        ({"r0_ohm": np.zeros(11)}, "r0_ohm down to 0"),
        ({"r1_ohm": -np.ones(11)}, "r1_ohm down to -1"),
        ({"r2_ohm": with_nan()}, "r2_ohm with missing values"),
        ({"tau1_s": np.zeros(11)}, "tau1_s down to 0"),
        ({"tau2_s": np.full(11, np.inf)}, "tau2_s"),
        ({"tau1_s": np.full(11, 90.0)}, "tau1_s >= tau2_s"),
        ({"temperature_C": np.array([np.nan])}, "temperatures"),
        ({"voltage_min_V": 4.2, "voltage_max_V": 2.5}, "lower below the upper"),
        ({"voltage_min_V": np.nan}, "finite limits"),
        ({"effects": (SlowDiffusion(np.zeros((1, 10)), 900.0),)}, "shape"),
    ],
)
def test_each_refusal_says_what_is_wrong(changes, message):
    with pytest.raises(InputError, match=message):
        linear_cell(**changes)


def test_it_is_frozen_and_keeps_no_hold_of_the_callers_arrays():
    table = np.full(11, 0.02)
    model = linear_cell(r0_ohm=table)
    table[:] = 7.0
    assert model.r0_ohm.max() == 0.02
    with pytest.raises(ValueError, match="read-only"):
        model.r0_ohm[0, 0] = 1.0
    with pytest.raises(FrozenInstanceError):
        model.capacity_Ah = 4.0


def test_capacitances_are_tau_over_r():
    model = random_model(np.random.default_rng(1))
    np.testing.assert_allclose(model.c1_F * model.r1_ohm, model.tau1_s, rtol=1e-14)
    np.testing.assert_allclose(model.c2_F * model.r2_ohm, model.tau2_s, rtol=1e-14)


def test_the_kernels_see_the_tables_and_the_scalars():
    model = curved_cell(effects=EFFECTS, charge_efficiency=0.98)
    table, grid, cell = model.parameters()
    assert table.shape == (1, model.points, COLUMNS)
    np.testing.assert_array_equal(table[0, :, 0], model.ocv_V[0])
    np.testing.assert_array_equal(table[0, :, M], 0.02)
    np.testing.assert_array_equal(grid, [25.0])
    assert cell.charge_As == pytest.approx(3600 * 3.0)
    assert cell.reference_K == pytest.approx(298.15)
    assert (cell.charge_efficiency, cell.hysteresis_rate, cell.skew_s) == (0.98, 40.0, 0.4)


def test_one_temperature_of_many_is_linear_between_them():
    model = random_model(np.random.default_rng(2))
    middle = float(model.temperature_C[:2].mean())
    cold = model.at_temperature(middle)
    np.testing.assert_allclose(cold.r0_ohm[0], model.r0_ohm[:2].mean(axis=0), rtol=1e-13)
    slow = model.effect(SlowDiffusion).r3_ohm[:2].mean(axis=0)
    np.testing.assert_allclose(cold.effect(SlowDiffusion).r3_ohm[0], slow, rtol=1e-13)
    assert cold.effect(Hysteresis).gamma == model.effect(Hysteresis).gamma
    assert linear_cell().at_temperature(-10.0).temperature_C[0] == 25.0


def test_repr_tells_what_a_person_asks_first():
    text = repr(curved_cell(name="cell 7", effects=EFFECTS))
    for word in ("cell 7", "3 Ah", "101 SOC points", "hysteresis"):
        assert word in text
