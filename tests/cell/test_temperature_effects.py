"""Activation energies of single branches, and the OCV's temperature coefficient."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import cellwise as cw
from cellwise.cell.effects import BRANCH_ACTIVATIONS, Entropy, SlowDiffusion, TemperatureDependence
from cellwise.cell.equations import look_up
from cellwise.cell.model_file import model_from_dict, model_to_dict
from cellwise.cell.resolved import over_temperature
from example_cells import curved_cell

SLOW = SlowDiffusion(r3_ohm=0.015, tau3_s=1500.0)
ENERGIES = {f"{name}_K": 300.0 * (k + 1) for k, name in enumerate(BRANCH_ACTIVATIONS)}
FIELDS = {
    "r0": "r0_ohm", "r1": "r1_ohm", "tau1": "tau1_s", "r2": "r2_ohm", "tau2": "tau2_s",
    "r3": "r3_ohm", "tau3": "tau3_s",
}  # fmt: skip


def factor(energy_K, temperature_C, reference_C=25.0):
    return np.exp(energy_K * (1.0 / (temperature_C + 273.15) - 1.0 / (reference_C + 273.15)))


@pytest.mark.parametrize("temperature", [-20.0, 5.0, 25.0, 45.0])
@pytest.mark.parametrize("common", [0.0, 2500.0])
def test_every_branch_has_its_own_activation_energy(temperature, common):
    plain = curved_cell(effects=(SLOW,))
    own = plain.with_effect(TemperatureDependence(common, 25.0, **ENERGIES))
    for soc in (0.05, 0.4, 0.93):
        before = look_up(plain.parameters(), soc, 25.0)
        after = look_up(own.parameters(), soc, temperature)
        for name, field in FIELDS.items():
            shared = common if name.startswith("r") else 0.0
            want = getattr(before, field) * factor(ENERGIES[f"{name}_K"] + shared, temperature)
            assert getattr(after, field) == pytest.approx(want, rel=1e-13), name
        assert after.ocv_V == before.ocv_V


@pytest.mark.parametrize("temperature", [-20.0, 25.0, 45.0])
def test_the_ocv_moves_with_temperature_as_the_entropy_says(temperature):
    plain = curved_cell()
    coefficient = 2e-4 * (plain.soc - 0.4)
    cell = plain.with_effect(Entropy(coefficient[None, :], 20.0))
    for soc in (-0.02, 0.13, 0.7, 1.02):
        before = look_up(plain.parameters(), soc, temperature)
        after = look_up(cell.parameters(), soc, temperature)
        moved = 2e-4 * (soc - 0.4) * (temperature - 20.0)
        assert after.ocv_V - before.ocv_V == pytest.approx(moved, abs=1e-13)
        slope = 2e-4 * (temperature - 20.0)
        assert after.ocv_slope_V - before.ocv_slope_V == pytest.approx(slope, abs=1e-11)


def warming(points):
    """A cell with both effects, a log from -15 to 5 degC, and its simulation."""
    known = (TemperatureDependence(1500.0, 25.0, r1_K=3000.0, tau2_K=2500.0), Entropy(4e-4, 25.0))
    cell = curved_cell(points, effects=known)
    current = np.repeat(np.random.default_rng(3).choice([0.0, 2.0, 4.0, -1.0], 60), 30)
    current[:120] = 0.0
    warm = np.linspace(-15.0, 5.0, current.size)
    log = cw.CellLog(np.arange(1800.0), current, np.full(1800, 3.7), warm)
    simulated = cw.simulate(cell, log, soc0=0.7)
    return cell, replace(log, voltage_V=simulated.voltage_V), simulated


def test_a_model_file_keeps_them_and_an_older_one_loads():
    cell = curved_cell(effects=(TemperatureDependence(1500.0, 25.0, r1_K=10.0), Entropy(1e-4)))
    again = model_from_dict(model_to_dict(cell))
    assert again.effect(TemperatureDependence).r1_K == 10.0
    assert again.effect(Entropy).docv_dT_V_per_K == 1e-4
    old = model_to_dict(curved_cell(effects=(TemperatureDependence(1500.0, 25.0),)))
    for effect in old["effects"]:
        for name in BRANCH_ACTIVATIONS:
            effect.pop(f"{name}_K", None)
    assert model_from_dict(old).effect(TemperatureDependence).activation_K == 1500.0


def test_rows_over_temperature_are_the_effects_themselves():
    effects = (SLOW, TemperatureDependence(900.0, 25.0, r1_K=2000.0, tau3_K=1000.0), Entropy(2e-4))
    cell = curved_cell(effects=effects)
    grid = np.arange(-20.0, 41.0, 5.0)
    rows = over_temperature(cell, grid)
    assert {e.name for e in rows.effects} == {"slow_diffusion"}
    for temperature in (-20.0, 5.0, 40.0):
        for soc in (0.1, 0.55):
            a = look_up(cell.parameters(), soc, temperature)
            b = look_up(rows.parameters(), soc, temperature)
            np.testing.assert_allclose(b[:10], a[:10], rtol=1e-12)
    middle = look_up(rows.parameters(), 0.5, -17.5), look_up(cell.parameters(), 0.5, -17.5)
    assert middle[0].r1_ohm == pytest.approx(middle[1].r1_ohm, rel=0.01)


@pytest.mark.slow
def test_a_target_has_them_as_rows_of_its_tables():
    cell, log, simulated = warming(21)
    soc = cw.replay(cell, log, "firmware", soc0=0.7, soc0_std=0.05).trace.soc
    float64 = cw.replay(cell, log, "ekf", soc0=0.7, soc0_std=0.05).trace.soc
    assert np.max(np.abs(soc - float64)) < 2e-3
    assert np.max(np.abs(soc - simulated.soc)) < 3e-3
