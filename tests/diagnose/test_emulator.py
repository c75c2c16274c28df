"""The emulator that hides effects, held against theorems, closed forms and other integrators."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cellwise import CellModel, simulate
from cellwise.cell.effects import (
    ChargeAsymmetry,
    Hysteresis,
    RateDependence,
    SelfDischarge,
    SelfHeating,
    SlowDiffusion,
    TemperatureDependence,
)
from emulator import Cell, Sensor, emulate, flat, measure
from emulator_cells import random_cell
from emulator_drives import random_load
from emulator_effects import EFFECTS, NAMES, World, amplitude, draw_effect, size_of
from hidden_cases import Plan, hidden_case

EVERYTHING = {
    "activation_K": 2500.0,
    "m_V": flat(0.02),
    "gamma": 40.0,
    "rate_h": 0.05,
    "charge_scale": 1.3,
    "leak_A": 0.02,
    "thermal_s": 300.0,
    "charge_efficiency": 0.98,
}


def warming(cell: Cell, kelvin_at_1c: float) -> float:
    """Thermal resistance [K/W] at which a steady 1C warms the core by so much."""
    return kelvin_at_1c / (cell.capacity_Ah**2 * 3.0 * float(np.mean(cell.r0_ohm.values)))


def cell_and_load(seed: int, rows: int = 2000, rate_hz: float = 1.0, chemistry="nmc", **changes):
    rng = np.random.default_rng(seed)
    cell = replace(random_cell(rng, chemistry, third=True), **changes)
    if "thermal_s" in changes:
        cell = replace(cell, rth_K_per_W=warming(cell, 3.0))
    load = random_load(
        rng, cell.capacity_Ah, 0.9, rows=rows, rate_hz=rate_hz, charge=True, temperature_C=(5, 40)
    )
    return cell, load


def test_what_leaves_the_cell_is_what_its_soc_loses():
    cell, load = cell_and_load(1, leak_A=0.03)
    run = emulate(cell, load.time_s, load.current_A, load.temperature_C, 0.9)
    flowed = np.sum((load.current_A[1:] + 0.03) * np.diff(load.time_s))
    assert 3600 * cell.capacity_Ah * (0.9 - run.soc[-1]) == pytest.approx(flowed, rel=1e-9)


def ode_voltage(cell: Cell, load, rows: int) -> np.ndarray:
    """Every state through scipy's adaptive integrator, interval by interval."""

    def factor(current, core, slow=False):
        k = np.exp(cell.activation_K * (1 / (core + 273.15) - 1 / (cell.reference_C + 273.15)))
        k *= cell.charge_scale if current < 0 else 1.0
        return k if slow else k / (1 + cell.rate_h * abs(current) / cell.capacity_Ah)

    def slopes(t, y, current, surface):
        soc, v1, v2, v3, h, heat = y
        core = surface(t) + heat
        used = current if current > 0 else current * cell.charge_efficiency
        fast, slow = factor(current, core) * current, factor(current, core, True) * current
        power = current * (cell.r0_ohm(soc) * fast + v1 + v2 + v3)
        reach = cell.gamma * abs(current) / (3600 * cell.capacity_Ah)
        return [
            -(used + cell.leak_A) / (3600 * cell.capacity_Ah),
            (cell.r1_ohm(soc) * fast - v1) / cell.tau1_s(soc),
            (cell.r2_ohm(soc) * fast - v2) / cell.tau2_s(soc),
            (cell.r3_ohm(soc) * slow - v3) / cell.tau3_s(soc),
            reach * (-np.sign(current) - h),
            (cell.rth_K_per_W * power - heat) / cell.thermal_s,
        ]

    def surface(t):
        return np.interp(t, load.time_s, load.temperature_C)

    y, voltage = np.array([0.9, 0.0, 0.0, 0.0, 1.0, 0.0]), []
    for k in range(1, rows):
        span = (load.time_s[k - 1], load.time_s[k])
        current = load.current_A[k]
        y = solve_ivp(slopes, span, y, args=(current, surface), rtol=1e-8, atol=1e-10).y[:, -1]
        core = surface(span[1]) + y[5]
        drop = factor(current, core) * cell.r0_ohm(y[0]) * current
        voltage.append(cell.ocv_V(y[0]) - drop - y[1:4].sum() + cell.m_V(y[0]) * y[4])
    return np.array(voltage)


def test_everything_at_once_agrees_with_an_adaptive_integrator():
    cell, load = cell_and_load(3, rows=600, rate_hz=0.5, **EVERYTHING)
    run = emulate(cell, load.time_s, load.current_A, load.temperature_C, 0.9)
    assert np.max(np.abs(run.voltage_V[1:400] - ode_voltage(cell, load, 400))) < 5e-5


@pytest.mark.parametrize("seed", range(5))
def test_the_package_simulates_what_the_emulator_does(seed):
    """Two ways to the same numbers, on a grid on which parameters are constant in an interval."""
    rng = np.random.default_rng(seed)
    chemistry = ("nmc", "lfp")[seed % 2]
    cell, load = cell_and_load(100 + seed, 4000, (1.0, 10.0)[seed % 2], chemistry, **EVERYTHING)
    held = np.repeat(load.current_A, 4)
    time = 0.25 * load.time_s[1] * np.arange(held.size)
    surface = np.interp(time, load.time_s, load.temperature_C)
    log = measure(emulate(cell, time, held, surface, 0.9), Sensor(), rng)
    soc = np.linspace(0.0, 1.0, cell.ocv_V.values.size)
    model = CellModel(
        capacity_Ah=cell.capacity_Ah,
        ocv_V=cell.ocv_V(soc),
        r0_ohm=cell.r0_ohm(soc),
        r1_ohm=cell.r1_ohm(soc),
        tau1_s=cell.tau1_s(soc),
        r2_ohm=cell.r2_ohm(soc),
        tau2_s=cell.tau2_s(soc),
        effects=(
            SlowDiffusion(cell.r3_ohm(soc)[None, :], cell.tau3_s(soc)[None, :]),
            Hysteresis(0.02, cell.gamma),
            TemperatureDependence(cell.activation_K, cell.reference_C),
            RateDependence(cell.rate_h),
            ChargeAsymmetry(cell.charge_scale),
            SelfHeating(cell.rth_K_per_W, cell.thermal_s),
            SelfDischarge(cell.leak_A),
        ),
        charge_efficiency=cell.charge_efficiency,
    )
    assert np.max(np.abs(simulate(model, log, 0.9).error_V)) < 2e-4


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_is_hidden_at_the_size_asked_for_and_grows_with_it(name):
    rng = np.random.default_rng(8)
    warm = 2500.0 if name == "self_heating" else 0.0
    cell, load = cell_and_load(11, 3000, activation_K=warm, r3_ohm=flat(0.0))
    draw, loads = draw_effect(rng), [(load, 0.9)]
    plain = World(cell)
    sizes = []
    for wanted in (0.002, 0.006):
        world, values = EFFECTS[name][0](plain, draw, amplitude(name, draw, plain, loads, wanted))
        sizes.append(size_of(plain, world, loads))
        assert all(np.isfinite(v) for v in values.values())
    assert sizes[0] == pytest.approx(0.002, rel=0.1)
    assert sizes[1] == pytest.approx(0.006, rel=0.1)


def test_the_instrument_does_what_its_numbers_say():
    cell, load = cell_and_load(13)
    run = emulate(cell, load.time_s, load.current_A, load.temperature_C, 0.9)
    rng = np.random.default_rng(0)
    log = measure(run, Sensor(offset_A=0.2, gain=1.1, offset_V=0.01), rng)
    assert np.allclose(log.current_A, 1.1 * load.current_A + 0.2)
    assert np.allclose(log.voltage_V, run.voltage_V + 0.01)
    late = measure(run, Sensor(skew_s=3.0), rng)
    assert np.allclose(late.voltage_V[3:], run.voltage_V[:-3])
    rough = measure(run, Sensor(step_V=0.005), rng)
    assert np.max(np.abs(rough.voltage_V - run.voltage_V)) <= 0.0025 + 1e-12


def test_a_case_is_sealed_until_there_is_a_verdict():
    class Open:
        verdict = ""

    case = hidden_case(5, ("capacity",), plan=Plan(rows=600))
    with pytest.raises(ValueError, match="sealed"):
        case.open(None)
    with pytest.raises(ValueError, match="sealed"):
        case.open(Open())
    Open.verdict = "none"
    assert case.open(Open()).names == ("capacity",)
    told = " ".join(log.name + log.source for log in (*case.logs, *case.holdout, *case.baseline))
    assert "capacity" not in told + case.label + case.model.name


def test_a_seed_is_a_case_and_hiding_changes_only_what_is_hidden():
    plan = Plan(rows=600, baseline=True)
    one, again = (hidden_case(6, ("voltage_offset",), plan=plan) for _ in range(2))
    assert np.array_equal(one.logs[0].voltage_V, again.logs[0].voltage_V)
    other = hidden_case(6, ("current_offset",), plan=plan)
    assert np.array_equal(one.baseline[0].voltage_V, other.baseline[0].voltage_V)
    assert not np.array_equal(one.logs[0].current_A, other.logs[0].current_A)
