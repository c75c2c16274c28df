"""Effects on the target: each follows the float64 EKF, and costs nothing where it is not."""

from __future__ import annotations

import shutil
from dataclasses import replace
from types import FunctionType

import numpy as np
import pytest

from cellwise.cell import equations
from cellwise.cell.effects import (
    ChargeAsymmetry,
    ChargeTransfer,
    Hysteresis,
    RateDependence,
    SelfDischarge,
    SelfHeating,
    SlowDiffusion,
    SurfaceSoc,
    TemperatureDependence,
    TimeSkew,
)
from cellwise.data import load_dataset
from cellwise.estimate.equations.constants import BLOCK_S
from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.fixed import arithmetic
from cellwise.estimate.fixed.options import CellSettings
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.export.firmware import Firmware
from cellwise.logs.cell_log import resample
from cellwise.printing.firmware import print_files
from example_cells import curved_cell
from firmware_cases import power_asked
from virtual_tester import logged

pytest.importorskip("cffi")
pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
DT_S = 1.0
BLOCK = int(BLOCK_S / DT_S)
# An effect, what it compiles in, and words that the C then needs.
EFFECTS = {
    "slow": (SlowDiffusion(r3_ohm=0.015, tau3_s=1500.0), ("v3_V", "lag3")),
    "hysteresis": (Hysteresis(m_V=0.02, gamma=40.0), ("m_V", "phh")),
    "arrhenius": (
        TemperatureDependence(activation_K=2500.0, reference_C=25.0),
        ("arrhenius_low_C",),
    ),
    "skew": (TimeSkew(skew_s=0.4), ("skew_share",)),
    "rate": (RateDependence(0.1), ("rate_per_A",)),
    "asymmetry": (ChargeAsymmetry(0.8), ("charge_scale",)),
    "transfer": (ChargeTransfer(60.0), ("asinh_per_V", "charge_transfer")),
    "surface": (SurfaceSoc(0.08, 200.0), ("slow_A", "surface_gain")),
    "surface over temperature": (SurfaceSoc(0.08, 200.0, 2000.0), ("slow_A", "depth_per_K")),
    "heating": (SelfHeating(3.0, 300.0), ("heat_K",)),  # felt by what depends on temperature
    "leak": (SelfDischarge(0.01), ("leak_soc",)),
}


def warmed(model):
    """The model at three temperatures, resistances falling from one to the next."""
    fall = np.array([[2.0], [1.0], [0.7]])

    def at(table, scale):
        return table[0][None, :] * scale

    return replace(
        model,
        temperature_C=np.array([0.0, 25.0, 45.0]),
        ocv_V=at(model.ocv_V, np.ones_like(fall)),
        r0_ohm=at(model.r0_ohm, fall),
        r1_ohm=at(model.r1_ohm, fall),
        r2_ohm=at(model.r2_ohm, fall),
        tau1_s=at(model.tau1_s, fall**0.5),
        tau2_s=at(model.tau2_s, fall**0.5),
    )


def model_with(name):
    model = curved_cell(capacity_Ah=5.1)
    if name == "temperatures":
        return warmed(model)
    if name == "efficiency":
        return replace(model, charge_efficiency=0.98)
    if name == "heating":
        model = model.with_effect(EFFECTS["arrhenius"][0])
    return model.with_effect(EFFECTS[name][0])


def drive_of(model):
    """Two hours of driving while the cell warms from 5 to 40 degC, its voltage with noise."""
    log = resample(load_dataset("nmc_drive_b"), DT_S).part(0, 7200)
    log = replace(log, temperature_C=np.linspace(5.0, 40.0, len(log)))
    noise = 0.002 * np.random.default_rng(0).normal(size=len(log))
    return logged(model, log, 0.9, noise)


@pytest.mark.parametrize("name", [*EFFECTS, "temperatures", "efficiency"])
def test_every_effect_follows_the_float64_ekf(name):
    model = model_with(name)
    log = drive_of(model)
    ours = Firmware(model, dt_s=DT_S).run(log, 0.85, 0.05).soc
    apart = ours - Ekf(model).run(log, 0.85, 0.05).soc
    apart = apart[2 * BLOCK :]  # until then the components of the C follow one by one
    assert 100 * np.sqrt(np.mean(apart**2)) < 0.05
    # Without the effect the filter comes to something else: it is compiled in, and used.
    without = model_with("arrhenius") if name == "heating" else curved_cell(capacity_Ah=5.1)
    plain = Firmware(without, dt_s=DT_S).run(log, 0.85, 0.05).soc
    assert np.max(np.abs(plain - ours)) > 1e-5


def test_the_fraction_of_a_charge_transfer_is_that_of_the_equations():
    y = np.concatenate(([0.0], np.geomspace(1e-3, float(arithmetic.LARGE), 2000)))
    single = FunctionType(equations.charge_transfer.py_func.__code__, {"magnitude": abs})
    found = np.array([single(np.float32(value)) for value in y])
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, [equations.charge_transfer(v) for v in y], rtol=1e-6)
    # What the analyser of the C is told.
    tiny = [single(np.float32(v)) for v in np.geomspace(1e-30, 1e-2, 2000)]
    assert np.min(found) > 0.0
    assert np.max((found.max(), *tiny)) <= 1.0


def printed(model, **asked):
    """The C of a lean build."""
    options = fixed_step_tables(model, DT_S, wide=False, **asked).options
    return "".join(print_files(options).values())


ASKED = {
    "power": ({"power": power_asked(curved_cell())}, ("power_low_V", "cellwise_power(")),
    "remaining": ({"remaining_V": 3.2}, ("remaining_low_V", "cellwise_plan(")),
    "health": ({"health": True}, ("per_capacity", "cellwise_set_health(")),
    "cells": ({"cells": CellSettings()}, ("cell_soc2", "cellwise_cells_step(")),
    "soh": ({"soh": True}, ("soh_drift", "cellwise_soh_step(")),
}


@pytest.mark.parametrize("name", [*EFFECTS, *ASKED])
def test_what_is_not_there_or_not_asked_for_is_not_printed(name):
    asked, words = ASKED.get(name) or ({}, EFFECTS[name][1])
    model = curved_cell() if name in ASKED else model_with(name)
    plain, built = printed(curved_cell()), printed(model, **asked)
    assert not any(word in plain for word in words)
    assert all(word in built for word in words)
