"""Models, samples and C programs for the tests of the fixed step and its C twin."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np

from cellwise.cell.effects import (
    ChargeAsymmetry,
    ChargeTransfer,
    RateDependence,
    SelfDischarge,
    SelfHeating,
    SlowDiffusion,
    SurfaceSoc,
)
from cellwise.cell.plausibility.validity import Validity
from cellwise.estimate.fixed.layout import INPUT
from cellwise.estimate.fixed.options import CellSettings
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.estimate.power.limits import OperatingLimits
from cellwise.estimate.power.state_of_power import power_settings
from cellwise.export.accuracy import stress_samples as stress_samples
from cellwise.export.c_tables import STRICT_FLAGS, WARNING_FLAGS, write_sources
from example_cells import curved_cell, random_model

VALID = Validity(soc=(0.3, 0.8), temperature_C=(0.0, 30.0), current_A=(-3.0, 6.0))


CHANGED = {
    "slow": {"effects": (SlowDiffusion(r3_ohm=0.015, tau3_s=1500.0),)},
    "transfer": {"effects": (ChargeTransfer(60.0),)},
    "surface": {"effects": (SurfaceSoc(0.08, 120.0),)},
    "validity": {"validity": VALID},
}


def full_model():
    """Every effect, three temperatures."""
    model = random_model(np.random.default_rng(5))
    for effect in (
        RateDependence(0.1),
        ChargeAsymmetry(0.8),
        ChargeTransfer(40.0),
        SurfaceSoc(0.06, 200.0, 1500.0),
        SelfHeating(3.0, 300.0),
        SelfDischarge(0.01),
    ):
        model = model.with_effect(effect)
    return model


def tables_of(name, dt_s=1.0):
    """Tables by a model's name, behind it which functions beside the step: `full pack`."""
    kind, _, more = name.partition(" ")
    model = full_model() if kind == "full" else curved_cell(**CHANGED.get(kind, {}))
    asked = {"offset": kind in ("full", "offset")}
    if more:  # pack, beside
        asked |= {"power": power_asked(model), "health": True, "cells": CellSettings()}
    if more == "beside":
        asked |= {"remaining_V": cutoff_asked(model), "soh": True}
    return fixed_step_tables(model, dt_s, wide=kind != "lean", **asked)


def noisy_samples(count, seed=0):
    """Currents, voltages and temperatures of no cell in particular: every branch of the step."""
    rng = np.random.default_rng(seed)
    records = np.zeros(count, dtype=INPUT)
    records["current_A"] = np.repeat(rng.normal(0.3, 2.0, count // 100 + 1), 100)[:count]
    records["voltage_V"] = 3.6 + 0.2 * np.sin(np.arange(count) / 7000) - 0.02 * records["current_A"]
    records["voltage_V"][rng.random(count) < 0.01] = np.nan
    records["temperature_C"] = 20 + 10 * np.sin(np.arange(count) / 900)
    records["sequence"] = np.arange(count)
    return records


def cutoff_asked(model):
    """A cutoff that every model here reaches under load before it is empty."""
    return float(model.ocv_V.min()) + 0.15


def power_asked(model, horizon_s=10.0):
    """The power of a fixed step within limits that every model here reaches."""
    low, high = float(model.ocv_V.min()), float(model.ocv_V.max())
    limits = OperatingLimits(
        low + 0.1, high - 0.05, 8 * model.capacity_Ah, 3 * model.capacity_Ah, 0.05, 0.97
    )
    return power_settings(model, horizons_s=(horizon_s,), limits=limits, hold="current")


def compile_and_run(tables, folder: Path, program: str, *, flags=("-O2",), cc="gcc", run=()):
    """Compile a program with the exported sources under every warning, run it: its output."""
    for name, text in write_sources(tables, "0" * 64):
        (folder / name).write_text(text)
    (folder / "program.c").write_text(program)
    sources = [str(folder / f"{n}.c") for n in ("cellwise_ekf", "cell_table", "program")]
    command = [cc, *flags, *STRICT_FLAGS, *WARNING_FLAGS, *sources, "-o", str(folder / "program")]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr[:2000]
    done = subprocess.run(
        [str(folder / "program"), *run], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-2000:]
    return done.stdout
