"""Each effect does what its equation says; what holds of all is in estimate/test_invariants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import (
    ChargeTransfer,
    Hysteresis,
    SlowDiffusion,
    SurfaceSoc,
    TemperatureDependence,
    TimeSkew,
)
from cellwise.cell.equations import CellState, advance, charge_transfer, empty_state, voltage_of
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell, linear_cell, random_log


@pytest.mark.parametrize("current_A", [-200.0, -12.0, -0.5, 0.01, 3.0, 40.0, 250.0])
def test_the_fast_branch_settles_at_the_overpotential_of_a_reaction(current_A):
    """Butler-Volmer, symmetric: I = 2 I0 sinh(eta F / (2 R T)), so eta is an asinh of I."""
    per_V = 96485.33212 / (2.0 * 8.314462618 * 298.15)
    model = linear_cell(effects=(ChargeTransfer(per_V),))
    exchange_A = 1.0 / (2.0 * per_V * model.r1_ohm[0, 0])
    state, _ = advance(model.parameters(), empty_state(0.5), current_A, 1e3, 25.0)
    assert 2.0 * exchange_A * np.sinh(per_V * state.v1_V) == pytest.approx(current_A, rel=3e-3)
    assert state.v1_V == pytest.approx(np.arcsinh(current_A / (2 * exchange_A)) / per_V, rel=5e-4)
    assert state.v2_V == pytest.approx(model.r2_ohm[0, 0] * current_A, rel=1e-4)


def test_the_fraction_of_a_charge_transfer_is_asinh():
    y = np.concatenate((np.geomspace(1e-4, 60.0, 4000), -np.geomspace(1e-4, 60.0, 4000)))
    found = np.array([charge_transfer(value) for value in y])
    np.testing.assert_allclose(found, np.arcsinh(y) / y, rtol=5e-4)
    assert charge_transfer(0.0) == 1.0


def by_hand(model, state, current_A, dt_s, temperature_C):
    """An interval of a cell with a surface: its states, R0 and OCV, as the theory page has them."""
    effect, capacity = model.effect(SurfaceSoc), model.capacity_Ah
    soc = state.soc - current_A * dt_s / 3600.0 / capacity
    a = np.exp(-dt_s / effect.tau_s)
    slow = a * state.slow_A + (1.0 - a) * current_A
    colder = 1.0 / (temperature_C + 273.15) - 1.0 / (effect.reference_C + 273.15)
    surface = soc - effect.depth_h * np.exp(effect.activation_K * colder) * slow / capacity

    def at(name):
        return np.interp(surface, model.soc, getattr(model, name)[0])

    v1, v2 = (
        v * np.exp(-dt_s / at(f"tau{j}_s")) + at(f"r{j}_ohm") * current_A * -np.expm1(
            -dt_s / at(f"tau{j}_s")
        )
        for j, v in ((1, state.v1_V), (2, state.v2_V))
    )  # fmt: skip
    return soc, v1, v2, slow, at("r0_ohm"), np.interp(soc, model.soc, model.ocv_V[0])


@pytest.mark.parametrize("dt_s", [0.5, 60.0, 7200.0])
@pytest.mark.parametrize("current_A", [4.0, -3.0, 0.0])
@pytest.mark.parametrize("soc", [0.02, 0.5, 0.97])
def test_resistances_and_time_constants_are_those_of_the_surface(soc, current_A, dt_s):
    """Near the ends the surface is beyond them, where the tables are held."""
    model = curved_cell(effects=(SurfaceSoc(0.08, 250.0, 1800.0, 20.0),))
    before = CellState(soc, 0.01, -0.02, 0.0, 0.0, 0.0, 2.5)
    after, point = advance(model.parameters(), before, current_A, dt_s, -5.0)
    new, v1, v2, slow, r0, ocv = by_hand(model, before, current_A, dt_s, -5.0)
    found = (after.soc, after.v1_V, after.v2_V, after.slow_A, point.r0_ohm)
    np.testing.assert_allclose(found, (new, v1, v2, slow, r0), rtol=1e-12, atol=1e-15)
    if 0.0 <= new <= 1.0:
        assert point.ocv_V == pytest.approx(ocv, rel=1e-12)
        expected = ocv - r0 * current_A - v1 - v2
        assert voltage_of(point, after, current_A) == pytest.approx(expected, rel=1e-12)


def test_long_at_1c_the_surface_is_the_depth_below_the_mean():
    """The steady voltage is that of the resistances 6 % of SOC further down, the OCV's here."""
    model = curved_cell(effects=(SurfaceSoc(depth_h=0.06, tau_s=30.0),))
    plain, state = curved_cell(), empty_state(0.9)
    for _ in range(1200):
        state, point = advance(model.parameters(), state, plain.capacity_Ah, 1.0, 25.0)
    r0 = np.interp(state.soc - 0.06, plain.soc, plain.r0_ohm[0])
    assert point.r0_ohm == pytest.approx(r0, rel=1e-12)
    assert state.slow_A == pytest.approx(plain.capacity_Ah, rel=1e-12)
    rested, _ = advance(model.parameters(), state, 0.0, 60.0, 25.0)
    assert rested.slow_A == pytest.approx(np.exp(-2.0) * plain.capacity_Ah, rel=1e-12)


def test_gap_between_the_branches_is_2_m():
    m = 0.03
    # Next to no resistance and a current of C/50: what is left is OCV and hysteresis.
    tiny = np.full(11, 1e-9)
    model = linear_cell(r0_ohm=tiny, r1_ohm=tiny, r2_ohm=tiny, effects=(Hysteresis(m, 60.0),))
    hours = 30
    time = np.arange(0, 2 * hours * 3600.0, 60.0)
    current = np.where(time <= hours * 3600.0, 0.06, -0.06)
    run = simulate(model, CellLog(time, current, np.full(time.size, 3.6)), 0.8)
    down, up = current > 0, current < 0
    for soc in (0.4, 0.5, 0.6):
        v_down = np.interp(-soc, -run.soc[down], run.voltage_V[down])
        v_up = np.interp(soc, run.soc[up], run.voltage_V[up])
        assert v_up - v_down == pytest.approx(2 * m, rel=1e-4)


def test_start_branch_is_the_likelier_one_unless_told():
    model = linear_cell(effects=(Hysteresis(0.03, 60.0),))
    log = CellLog(np.arange(3.0), np.zeros(3), np.full(3, 3.6))
    ocv = [3.2 + 0.9 * s for s in (0.9, 0.1)]
    assert simulate(model, log, 0.9).voltage_V[0] == pytest.approx(ocv[0] + 0.03)
    assert simulate(model, log, 0.1).voltage_V[0] == pytest.approx(ocv[1] - 0.03)
    assert simulate(model, log, 0.9, h0=-0.5).voltage_V[0] == pytest.approx(ocv[0] - 0.015)


@pytest.mark.parametrize("temperature", [-20.0, 25.0, 45.0])
def test_arrhenius_scales_every_resistance_and_nothing_else(temperature):
    energy = 3000.0
    effect = TemperatureDependence(activation_K=energy, reference_C=25.0)
    slow = SlowDiffusion(0.02, 900.0)
    factor = np.exp(energy * (1 / (temperature + 273.15) - 1 / 298.15))
    plain = curved_cell()
    scaled = replace(plain, effects=(slow,)).with_resistances(factor)
    log = random_log(np.random.default_rng(3), 400)
    log = replace(log, temperature_C=np.full(len(log), temperature))
    a = simulate(replace(plain, effects=(effect, slow)), log, 0.6)
    b = simulate(scaled, log, 0.6)
    np.testing.assert_allclose(a.voltage_V, b.voltage_V, rtol=1e-13)
    if temperature == 25.0:
        own = simulate(replace(plain, effects=(slow,)), log, 0.6)
        np.testing.assert_array_equal(a.voltage_V, own.voltage_V)


def test_skew_of_one_interval_shows_every_voltage_one_row_later():
    log = random_log(np.random.default_rng(4), 300)
    plain = simulate(curved_cell(), log, 0.7)
    late = simulate(curved_cell(effects=(TimeSkew(1.0),)), log, 0.7)
    np.testing.assert_allclose(late.voltage_V[1:], plain.voltage_V[:-1], rtol=1e-13)


@pytest.mark.parametrize(
    ("effect", "word"),
    [
        (SlowDiffusion(r3_ohm=-0.1), "r3_ohm"),
        (SlowDiffusion(r3_ohm=0.1, tau3_s=0.0), "tau3_s"),
        (SlowDiffusion(r3_ohm=np.zeros(7)), "shape"),
        (Hysteresis(m_V=2.0), "m_V"),
        (Hysteresis(m_V=0.02, gamma=-1.0), "gamma"),
        (Hysteresis(m_V=np.nan), "m_V"),
        (TemperatureDependence(activation_K=1e6), "activation_K"),
        (TemperatureDependence(reference_C=298.15), "reference_C"),
        (TimeSkew(skew_s=-0.1), "skew_s"),
        (TimeSkew(skew_s=np.inf), "skew_s"),
    ],
)
def test_effect_out_of_bounds_is_refused(effect, word):
    with pytest.raises(InputError, match=word):
        linear_cell(effects=(effect,))


def test_two_effects_of_a_kind_are_refused_and_with_effect_replaces():
    with pytest.raises(InputError, match="one effect of a kind"):
        linear_cell(effects=(TimeSkew(0.1), TimeSkew(0.2)))
    model = linear_cell(effects=(TimeSkew(0.1), Hysteresis(0.01, 5.0)))
    replaced = model.with_effect(TimeSkew(0.2))
    assert replaced.effect(TimeSkew).skew_s == 0.2
    assert replaced.effect(Hysteresis).gamma == 5.0
    assert len(replaced.effects) == 2
