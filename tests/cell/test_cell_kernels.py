"""The cell's equations: theorems, and scipy as oracle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.interpolate import RegularGridInterpolator
from scipy.linalg import expm

from cellwise.cell import equations as kernels
from cellwise.cell.effects import Hysteresis, SlowDiffusion
from cellwise.cell.equations import CellState
from cellwise.cell.model_error import ModelError
from example_cells import EFFECTS, curved_cell, linear_cell, random_model

currents = st.floats(-20.0, 20.0)
seconds = st.floats(1e-3, 500.0)


def advance(model, state, current, dt, temperature=25.0):
    return kernels.advance(model.parameters(), state, current, dt, temperature)


@given(v=st.floats(-1, 1), i=currents, r=st.floats(1e-4, 1), tau=st.floats(0.1, 1e4), dt=seconds)
def test_rc_step_is_the_matrix_exponential(v, i, r, tau, dt):
    # d/dt (v, I) = [[-1/tau, r/tau], [0, 0]] (v, I)
    exact = expm(np.array([[-1 / tau, r / tau], [0, 0]]) * dt) @ [v, i]
    assert kernels.rc_step(v, i, r, tau, dt) == pytest.approx(exact[0], rel=1e-11, abs=1e-12)


def test_one_step_of_2_dt_differs_from_two_by_second_order_where_tables_depend_on_soc():
    # The tables are smooth within one segment of the grid; stay inside it.
    model = curved_cell(points=6)
    start = CellState(0.58, 0.02, 0.03, 0.0, 0.0)

    def difference(dt):
        once, _ = advance(model, start, 9.0, 2 * dt)
        half, _ = advance(model, start, 9.0, dt)
        twice, _ = advance(model, half, 9.0, dt)
        return np.array(once)[1:3] - np.array(twice)[1:3]

    ratio = difference(0.4) / difference(0.2)
    assert np.all(np.abs(difference(0.4)) > 1e-12)
    np.testing.assert_allclose(ratio, 4.0, rtol=0.1)


@given(soc=st.floats(0.0, 1.0), i=currents, dt=seconds, efficiency=st.floats(0.9, 1.0))
def test_charge_is_counted_and_comes_back(soc, i, dt, efficiency):
    cell = linear_cell(charge_efficiency=efficiency).parameters().cell
    after = kernels.soc_step(cell, soc, i, dt)
    moved = i * dt / (3600 * 3.0)
    assert soc - after == pytest.approx(moved if i > 0 else efficiency * moved, abs=1e-15)
    # Putting the same charge back costs 1/efficiency of it.
    back = -i / efficiency if i > 0 else -i * efficiency
    assert kernels.soc_step(cell, after, back, dt) == pytest.approx(soc, abs=1e-13)


def test_hysteresis_is_the_solution_of_its_differential_equation():
    model = linear_cell(effects=(Hysteresis(0.03, 25.0),))
    state = CellState(0.5, 0.0, 0.0, 0.0, 0.6)
    for current in (4.0, -7.0, 0.0, 2.0):
        rate = 25.0 * abs(current) / (3600 * 3.0)
        exact = solve_ivp(
            lambda _, h, r=rate, i=current: -r * (h + np.sign(i)), (0, 100.0), [state.h],
            rtol=1e-11, atol=1e-12,
        ).y[0, -1]  # fmt: skip
        state, _ = advance(model, state, current, 100.0)
        assert state.h == pytest.approx(exact, abs=1e-9)


def test_third_branch_is_one_more_rc():
    model = linear_cell(effects=(SlowDiffusion(0.05, 600.0),))
    after, point = advance(model, CellState(0.5, 0.0, 0.0, 0.01, 0.0), 2.0, 60.0)
    assert after.v3_V == pytest.approx(kernels.rc_step(0.01, 2.0, 0.05, 600.0, 60.0), rel=1e-14)
    without = after._replace(v3_V=0.0)
    gap = kernels.voltage_of(point, without, 2.0) - kernels.voltage_of(point, after, 2.0)
    assert gap == pytest.approx(after.v3_V, rel=1e-10)


def test_terminal_voltage_is_the_sum_of_its_terms():
    point = kernels.look_up(linear_cell().parameters(), 0.5, 25.0)
    point = point._replace(ocv_V=3.7, r0_ohm=0.03, m_V=0.02)
    state = CellState(0.5, 0.011, 0.022, 0.033, -0.5)
    exact = 3.7 - 0.03 * 2.0 - 0.011 - 0.022 - 0.033 - 0.01
    assert kernels.voltage_of(point, state, 2.0) == pytest.approx(exact, abs=1e-15)


class TestLookUp:
    def test_the_model_error_is_looked_up_as_well(self):
        model = curved_cell(error=ModelError.of_white_and_slow(slow_V=(0.03, 0.01, 0.02)))
        for soc, error in ((0.0, 0.03), (0.25, 0.02), (0.5, 0.01), (1.0, 0.02), (1.5, 0.02)):
            assert kernels.look_up(model.parameters(), soc, 25.0).error_V == pytest.approx(error)
            assert float(model.error.at(soc)) == pytest.approx(error)

    names = ("r0_ohm", "r1_ohm", "tau1_s", "r2_ohm", "tau2_s")

    @pytest.mark.parametrize("soc", [0.0, 0.013, 0.5, 0.77, 0.999, 1.0, -0.3, 1.2])
    def test_along_soc_it_is_numpy_interp(self, soc):
        model = random_model(np.random.default_rng(1), temperatures=1, effects=False)
        point = kernels.look_up(model.parameters(), soc, 25.0)
        for name in self.names:
            table = getattr(model, name)[0]
            assert getattr(point, name) == pytest.approx(np.interp(soc, model.soc, table))
        if 0 <= soc <= 1:
            assert point.ocv_V == pytest.approx(np.interp(soc, model.soc, model.ocv_V[0]))

    @pytest.mark.parametrize(
        ("soc", "inner", "end"), [(-0.03, 1, 0), (1.04, -2, -1), (-0.2, 1, 0), (1.3, -2, -1)]
    )
    def test_ocv_goes_on_along_its_last_segment_for_a_while(self, soc, inner, end):
        model = random_model(np.random.default_rng(2), temperatures=1, effects=False)
        ocv, grid = model.ocv_V[0], model.soc
        slope = (ocv[end] - ocv[inner]) / (grid[end] - grid[inner])
        point = kernels.look_up(model.parameters(), soc, 25.0)
        beyond = np.clip(soc - grid[end], -kernels.BEYOND, kernels.BEYOND)
        assert point.ocv_V == pytest.approx(ocv[end] + slope * beyond)
        assert point.ocv_slope_V == pytest.approx(slope)

    @settings(max_examples=100)
    @given(soc=st.floats(0.0, 1.0), temperature=st.floats(-40.0, 70.0))
    def test_with_temperature_it_is_bilinear_and_held_at_the_ends(self, soc, temperature):
        model = random_model(np.random.default_rng(3), temperatures=4, effects=False)
        grid = model.temperature_C
        at = [np.clip(temperature, grid[0], grid[-1]), soc]
        point = kernels.look_up(model.parameters(), soc, temperature)
        for name in (*self.names, "ocv_V"):
            exact = RegularGridInterpolator((grid, model.soc), getattr(model, name))(at)[0]
            assert getattr(point, name) == pytest.approx(exact, rel=1e-12)

    @pytest.mark.parametrize("temperature", [-5.0, 17.0, 60.0])
    def test_slope_is_the_derivative_of_the_ocv(self, temperature):
        model = random_model(np.random.default_rng(4), temperatures=3, effects=False)
        for soc in (0.031, 0.52, 0.97):
            near = [
                kernels.look_up(model.parameters(), soc + d, temperature).ocv_V
                for d in (-1e-6, 1e-6)
            ]
            slope = kernels.look_up(model.parameters(), soc, temperature).ocv_slope_V
            assert slope == pytest.approx((near[1] - near[0]) / 2e-6, rel=1e-6)

    def test_agrees_with_the_model_at_one_temperature(self):
        model = random_model(np.random.default_rng(5), temperatures=3)
        for temperature in (-40.0, 3.0, 21.0, 80.0):
            cold = model.at_temperature(temperature)
            for soc in (0.02, 0.49, 0.9):
                a = kernels.look_up(model.parameters(), soc, temperature)
                b = kernels.look_up(cold.parameters(), soc, temperature)
                np.testing.assert_allclose(a, b, rtol=1e-12)


def test_seen_current_lies_between_the_last_two():
    cell = linear_cell(effects=EFFECTS).parameters().cell  # 0.4 s of skew
    assert kernels.delayed_current(cell, 5.0, 1.0, 1.0) == pytest.approx(0.6 * 5.0 + 0.4 * 1.0)
    assert kernels.delayed_current(cell, 5.0, 1.0, 0.2) == 1.0  # no more than one interval
    assert kernels.delayed_current(cell, 5.0, 1.0, 0.0) == 5.0
    assert kernels.delayed_current(linear_cell().parameters().cell, 5.0, 1.0, 1.0) == 5.0
