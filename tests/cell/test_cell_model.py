"""CellModel: what it holds, and each thing it refuses."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from cellwise.cell.effects import Hysteresis, SlowDiffusion
from cellwise.cell.model import TABLES, CellModel
from cellwise.cell.point_kernels import COLUMNS, M
from cellwise.cell.simulate import simulate
from cellwise.cell.stock import stock_model
from cellwise.errors import InputError
from example_cells import EFFECTS, curved_cell, linear_cell, random_log, random_model


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


def test_one_number_is_a_table_that_has_it_everywhere():
    ocv_V = np.linspace(3.0, 4.2, 11)
    model = CellModel(3.0, np.tile(ocv_V, (2, 1)), r0_ohm=0.03, r1_ohm=[[0.01], [0.02]], tau1_s=5,
                      r2_ohm=np.full(11, 0.01), tau2_s=60.0, temperature_C=[0.0, 25.0])  # fmt: skip
    assert {getattr(model, name).shape for name in TABLES} == {(2, 11)}
    np.testing.assert_array_equal(model.r0_ohm, 0.03)
    np.testing.assert_array_equal(model.r1_ohm, np.repeat([[0.01], [0.02]], 11, axis=1))


def test_a_model_of_ocv_and_r0_alone_is_ohms_law():
    model = CellModel(capacity_Ah=3.0, ocv_V=np.linspace(3.0, 4.2, 11), r0_ohm=0.03)
    log = random_log(np.random.default_rng(2), rows=200)
    found = simulate(model, log, 0.6)
    expected = 3.0 + 1.2 * found.soc - 0.03 * log.current_A
    np.testing.assert_allclose(found.voltage_V, expected, atol=5e-6)


def test_an_ocv_at_uneven_points_and_in_either_order_is_read_off_linearly():
    soc, ocv_V = np.array([0.0, 0.05, 0.4, 1.0]), np.array([3.0, 3.4, 3.7, 4.2])
    model = CellModel.from_ocv(soc, ocv_V, capacity_Ah=2.0, r0_ohm=[0.05, 0.04, 0.03, 0.03],
                               r1_ohm=0.01, tau1_s=8.0, points=101)  # fmt: skip
    again = CellModel.from_ocv(soc[::-1], ocv_V[::-1], capacity_Ah=2.0, r0_ohm=0.03, points=101)
    np.testing.assert_allclose(np.interp(soc, model.soc, model.ocv_V[0]), ocv_V)
    np.testing.assert_array_equal(again.ocv_V, model.ocv_V)
    np.testing.assert_allclose(np.interp(0.4, model.soc, model.r0_ohm[0]), 0.03)
    np.testing.assert_array_equal(model.r1_ohm, 0.01)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"soc": [0.0, 50.0, 100.0]}, "Divide per cent by 100"),
        ({"soc": [0.1, 0.5, 1.0]}, "from 0.1 to 1.*Add the ends"),
        ({"soc": [0.0, 0.5, 0.4]}, "not in order"),
        ({"soc": 0.5}, "every point of the OCV"),
        ({"soc": None}, "soc = None"),
        ({"ocv_V": [3.0, 4.0]}, r"ocv_V of shape \(2,\) at 3 points"),
        ({"ocv_V": 3.7}, r"ocv_V of shape \(\) at 3 points"),
        ({"r0_ohm": [0.02, 0.03]}, "or one number"),
        ({"r0_ohm": "0.02"}, "r0_ohm = '0.02'"),
        ({"capacity_Ah": "3"}, "capacity_Ah = '3'"),
        ({"capacity_Ah": None}, "capacity_Ah = None"),
    ],
)
def test_a_model_by_hand_says_what_is_wrong(changes, message):
    values = {"soc": [0.0, 0.5, 1.0], "ocv_V": [3.0, 3.7, 4.2], "capacity_Ah": 3.0, "r0_ohm": 0.03}
    with pytest.raises(InputError, match=message):
        CellModel.from_ocv(**values | changes)


def judged_fit(handed_out, **errors):
    """A provenance of a fit at 0 and 25 degC with standard errors of one share."""
    rows = [
        {"temperature_C": warm_C, "standard_errors": {
            name: {"soc": [0.0, 1.0], "std": [share, 3.0 * share]} for name, share in at.items()}}
        for warm_C, at in zip((0.0, 25.0), (errors, {n: 2.0 * s for n, s in errors.items()}),
                              strict=True)
    ]  # fmt: skip
    return {"refinement": rows, "plain_model": {"handed_out": handed_out}}


def test_a_standard_error_has_the_unit_of_its_value_at_the_nearest_tested_temperature():
    provenance = judged_fit("fit", r0_ohm=0.1, ocv_V=0.002)
    rows = np.tile(curved_cell(11).ocv_V, (3, 1))
    model = curved_cell(11, ocv_V=rows, temperature_C=[0.0, 10.0, 20.0], provenance=provenance)
    table = model.table()
    share = np.concatenate([np.linspace(a, 3.0 * a, 11) for a in (0.1, 0.1, 0.2)])
    np.testing.assert_allclose(table["r0_std_ohm"], share * table["r0_ohm"])
    np.testing.assert_allclose(table["ocv_std_V"], 0.02 * share)
    assert np.isnan(table["tau1_std_s"]).all()
    np.testing.assert_array_equal(table["temperature_C"], np.repeat([0.0, 10.0, 20.0], 11))


def test_errors_of_a_fit_are_not_those_of_the_plain_model_that_was_handed_out():
    model = curved_cell(11, provenance=judged_fit("plain", r0_ohm=0.1))
    assert np.isnan(model.table()["r0_std_ohm"]).all()


def test_a_stock_model_is_as_uncertain_as_cells_of_its_kind_differ():
    model = stock_model("nmc-18650")
    spread, table = model.provenance["stock"]["spread"], model.table()
    np.testing.assert_allclose(table["ocv_std_V"], spread["ocv_V"])
    np.testing.assert_allclose(table["r3_std_ohm"], spread["ln_resistance"] * table["r3_ohm"])
