"""export --pybamm: PyBaMM runs what is written, within 1 mV of `simulate`."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import (
    ChargeAsymmetry,
    Hysteresis,
    RateDependence,
    SelfHeating,
    SlowDiffusion,
    TemperatureDependence,
)
from cellwise.cell.simulate import simulate
from cellwise.cell.stock import named_model
from cellwise.data import load_dataset
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell

EFFECTS = (
    SlowDiffusion(r3_ohm=0.015, tau3_s=1500.0),
    RateDependence(0.05),
    ChargeAsymmetry(0.8),
    SelfHeating(3.0, 300.0),
    TemperatureDependence(activation_K=2000.0, reference_C=25.0),
)


def run(pybamm, values, branches, log, soc0):
    """Voltage at every row of a log by PyBaMM, the current of a row held before it."""
    options = {"number of rc elements": branches}
    model = pybamm.equivalent_circuit.Thevenin(options=options)
    model.events = []
    time, current = log.time_s, log.current_A
    values.update({"Initial SoC": soc0, "Current function [A]": "[input]"})
    solver = pybamm.IDAKLUSolver(rtol=1e-8, atol=1e-8)
    simulation = pybamm.Simulation(model, parameter_values=values, solver=solver)
    found = [np.nan]
    for k in range(1, len(log)):
        dt = float(time[k] - time[k - 1])
        solution = simulation.step(
            dt, inputs={"Current function [A]": float(current[k])}, save=False
        )
        found.append(float(solution["Voltage [V]"].entries[-1]))
    return np.array(found)


def drive(capacity_Ah, warm_C, rows=250):
    """An hour of a drive at 10 s, scaled to a cell."""
    log = load_dataset("nmc_drive_b")
    current = log.current_A[2000 : 2000 + 10 * rows].reshape(rows, -1).mean(axis=1)
    current *= 0.8 * capacity_Ah / np.abs(current).max()
    time_s = 10.0 * np.arange(rows)
    return CellLog(time_s, current, np.full(rows, 3.7), np.full(rows, warm_C))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("which", "suffix", "warm_C"),
    [
        ("plain", "py", 25.0),
        ("effects", "py", 7.0),
        ("effects", "json", 25.0),
        ("nmc-18650", "py", -7.3),  # one temperature and activation energies
        ("nmc-18650", "json", 25.0),
        ("nca-18650", "py", 4.2),  # between rows of a temperature axis, OCV too
    ],
)
def test_pybamm_is_within_a_millivolt_of_simulate(export, tmp_path, which, suffix, warm_C):
    pybamm = pytest.importorskip("pybamm", reason="no PyBaMM: pip install pybamm")
    if which.endswith("18650"):
        model = named_model(which)
        kept = tuple(e for e in model.effects if not isinstance(e, Hysteresis))
        omitted = ["--without", "hysteresis"] if len(kept) < len(model.effects) else []
        written, model = model, replace(model, effects=kept)
    else:
        written = model = curved_cell(effects=EFFECTS if which == "effects" else ())
        omitted = []
    place = tmp_path / f"cell.{suffix}"
    export("--pybamm", place, *omitted, model=written)
    if suffix == "json":
        values = pybamm.ParameterValues.from_json(str(place))
        assert values["Ambient temperature [K]"] == pytest.approx(warm_C + 273.15)
    else:
        spec = importlib.util.spec_from_file_location("cell", place)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        values = module.get_parameter_values(warm_C)
    branches = 3 if "R3 [Ohm]" in values else 2
    log = drive(model.capacity_Ah, warm_C)
    theirs = run(pybamm, values, branches, log, 0.8)
    ours = simulate(model, log, 0.8).voltage_V
    assert np.ptp(theirs[1:]) > 0.1
    assert np.max(np.abs(theirs - ours)[1:]) < 1e-3


def test_what_is_left_out_is_said(export, tmp_path):
    told = export("--pybamm", tmp_path / "cell.py", model=curved_cell(charge_efficiency=0.99))
    assert "charge_efficiency 0.99" in told["notices"][0]
    compile((tmp_path / "cell.py").read_text(), "cell.py", "exec")
