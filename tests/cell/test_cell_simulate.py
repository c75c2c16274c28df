"""Simulation: scipy as oracle, charge, superposition, gaps, missing values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cellwise.cell.effects import TemperatureDependence
from cellwise.cell.plausibility.validity import Validity
from cellwise.cell.simulate import simulate
from cellwise.cell.stock import named_model, stock_names
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell, linear_cell, random_log, random_model


def continuous(model, log, soc0):
    """The same cell as an ordinary differential equation, solved by scipy interval by interval.

    Branch voltages follow dV/dt = I/C - V/(R C); the tables are numpy's interpolation.
    """
    names = ("r0_ohm", "r1_ohm", "tau1_s", "r2_ohm", "tau2_s")

    def table(name, soc):
        return np.interp(soc, model.soc, getattr(model, name)[0])

    def rate(_, x, current):
        _, r1, tau1, r2, tau2 = (table(name, x[0]) for name in names)
        c1, c2 = tau1 / r1, tau2 / r2
        return [
            -current / (3600 * model.capacity_Ah),
            current / c1 - x[1] / (r1 * c1),
            current / c2 - x[2] / (r2 * c2),
        ]

    x = np.array([soc0, 0.0, 0.0])
    voltage = np.empty(len(log))
    for k, (dt, current) in enumerate(zip(log.interval_s, log.current_A, strict=True)):
        if dt > 0:
            x = solve_ivp(rate, (0, dt), x, args=(current,), rtol=1e-10, atol=1e-12).y[:, -1]
        voltage[k] = table("ocv_V", x[0]) - table("r0_ohm", x[0]) * current - x[1] - x[2]
    return voltage, x[0]


@pytest.mark.parametrize("dt_s", [0.01, 1.0, 60.0])
def test_constant_parameters_are_exact_at_any_time_step(dt_s):
    model = linear_cell(ocv_V=curved_cell(11).ocv_V)
    log = random_log(np.random.default_rng(1), 60, dt_s=dt_s, jitter=0.9)
    voltage, soc = continuous(model, log, 0.8)
    run = simulate(model, log, 0.8)
    np.testing.assert_allclose(run.voltage_V, voltage, atol=1e-8)
    assert run.soc[-1] == pytest.approx(soc, abs=1e-12)


def test_soc_dependent_parameters_converge_to_the_continuous_cell_with_the_time_step():
    model = curved_cell(effects=())
    levels = np.array([0.0, 6.0, -3.0, 9.0, 0.0, 4.0])

    def error(dt):
        rows = int(60 / dt)
        current = np.concatenate(([0.0], np.repeat(levels, rows)))
        log = CellLog(dt * np.arange(current.size), current, np.full(current.size, 3.7))
        coarse = CellLog(60.0 * np.arange(7), np.append(0.0, levels), np.full(7, 3.7))
        exact, _ = continuous(model, coarse, 0.35)
        return np.max(np.abs(simulate(model, log, 0.35).voltage_V[::rows] - exact))

    errors = [error(dt) for dt in (4.0, 2.0, 1.0)]
    assert errors[2] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.15)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.15)


def test_interval_start_meaning_moves_the_current_one_row():
    log = random_log(np.random.default_rng(5), 300)
    late = replace(
        log, current_A=np.append(log.current_A[1:], 99.0), current_meaning="interval_start"
    )
    a, b = simulate(curved_cell(), log, 0.5), simulate(curved_cell(), late, 0.5)
    np.testing.assert_array_equal(a.soc, b.soc)
    np.testing.assert_array_equal(a.voltage_V[1:], b.voltage_V[1:])


class TestGaps:
    gap_s = 500.0

    def log(self, counter_Ah=None):
        """2 A for 100 s, 500 s without rows, 2 A for 100 s; the gap's row says 2 A as well."""
        time = np.concatenate((np.arange(0.0, 101.0), 100.0 + self.gap_s + np.arange(0.0, 101.0)))
        current = np.full(time.size, 2.0)
        current[0] = 0.0
        charge = None
        if counter_Ah is not None:
            flowed = current * np.diff(time, prepend=0.0) / 3600
            flowed[101] = counter_Ah
            charge = 5.0 + np.cumsum(flowed)
        return CellLog(time, current, np.full(time.size, 3.7), charge_Ah=charge)

    def test_no_charge_flows_through_a_gap_without_counter(self):
        run = simulate(linear_cell(), self.log(), 0.5)
        assert self.log().gap_rows[101]
        assert run.soc[101] == run.soc[100]
        assert run.soc[-1] == pytest.approx(0.5 - 2.0 * 200 / (3600 * 3.0))

    def test_branches_relax_through_it(self):
        run = simulate(linear_cell(), self.log(), 0.5)
        ocv = 3.2 + 0.9 * run.soc[101]
        v1 = 0.012 * 2.0 * (1 - np.exp(-100 / 7.0)) * np.exp(-self.gap_s / 7.0)
        v2 = 0.020 * 2.0 * (1 - np.exp(-100 / 90.0)) * np.exp(-self.gap_s / 90.0)
        assert run.voltage_V[101] == pytest.approx(ocv - v1 - v2, abs=1e-12)

    @pytest.mark.parametrize("counter_Ah", [0.3, 0.0, -0.2])
    def test_the_counter_tells_what_flowed(self, counter_Ah):
        run = simulate(linear_cell(), self.log(counter_Ah), 0.5)
        assert run.soc[100] - run.soc[101] == pytest.approx(counter_Ah / 3.0, abs=1e-12)
        mean = 3600 * counter_Ah / self.gap_s
        v2 = 0.020 * 2.0 * (1 - np.exp(-100 / 90.0))
        decay = np.exp(-self.gap_s / 90.0)
        v2 = v2 * decay + 0.020 * mean * (1 - decay)
        v1 = 0.012 * mean  # 500 s are 71 time constants
        ocv = 3.2 + 0.9 * run.soc[101]
        assert run.voltage_V[101] == pytest.approx(ocv - 0.030 * mean - v1 - v2, abs=1e-9)


def test_missing_values_do_not_reach_the_simulation():
    rng = np.random.default_rng(6)
    log = random_log(rng, 400, temperature_C=(20.0, 30.0))
    model = random_model(rng)
    current, voltage = log.current_A.copy(), log.voltage_V.copy()
    current[[0, 50, 51]] = np.nan
    voltage[[0, 60]] = np.nan
    temperature = log.temperature_C.copy()
    temperature[[0, 70, 399]] = np.nan
    holey = replace(log, current_A=current, voltage_V=voltage, temperature_C=temperature)
    run = simulate(model, holey, 0.5)
    assert np.all(np.isfinite(run.voltage_V))
    assert run.metrics.samples == 398
    held = current.copy()
    held[[50, 51]] = current[49]
    held[0] = 0.0
    same = simulate(model, replace(holey, current_A=held), 0.5)
    np.testing.assert_array_equal(run.voltage_V, same.voltage_V)


@pytest.mark.parametrize("soc0", [-0.01, 1.01, 55.0, np.nan, np.inf])
def test_a_start_outside_0_to_1_is_refused(soc0):
    with pytest.raises(InputError, match="from 0 to 1") as error:
        simulate(linear_cell(), random_log(np.random.default_rng(7)), soc0)
    assert ("Per cent" in str(error.value)) == (1 < soc0 <= 100)


def test_temperature_nobody_measured_is_the_models():
    assert linear_cell(temperature_C=np.array([10.0])).usual_temperature_C == 10.0
    many = random_model(np.random.default_rng(8), effects=False)
    many = replace(many, temperature_C=np.array([-10.0, 23.0, 45.0]))
    assert many.usual_temperature_C == 25.0
    # Its rows go on beyond its data.
    of_the_cold = replace(many, validity=Validity(temperature_C=(-10.0, 5.0)))
    assert of_the_cold.usual_temperature_C == 5.0
    cold = replace(many, temperature_C=np.array([-20.0, -10.0, 0.0]))
    assert cold.usual_temperature_C == 0.0
    arrhenius = linear_cell(effects=(TemperatureDependence(2000.0, 40.0),))
    assert arrhenius.usual_temperature_C == 25.0
    warm = replace(arrhenius, validity=Validity(temperature_C=(30.0, 50.0)))
    assert warm.usual_temperature_C == 30.0


@pytest.mark.parametrize("name", stock_names())
def test_a_stock_model_is_at_room_temperature_where_nobody_measured(name):
    """Tables hold where tests were made, at 9 degC for a LiPo with twice the resistance."""
    assert named_model(name).usual_temperature_C == 25.0
