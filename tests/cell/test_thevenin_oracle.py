"""PyBaMM's own Thevenin model against ours: other people's equations and solver."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.simulate import simulate
from cellwise.logs.cell_log import CellLog
from example_cells import linear_cell

pybamm = pytest.importorskip("pybamm", reason="PyBaMM is the oracle here: pip install pybamm")


def pybamm_voltage(model, soc0, current_A, dt_s):
    """Terminal voltage at the end of every interval by PyBaMM's two-branch Thevenin model."""
    thevenin = pybamm.equivalent_circuit.Thevenin(options={"number of rc elements": 2})
    values = pybamm.ParameterValues("ECM_Example")
    ocv = model.ocv_V[0]
    values.update(
        {
            "Cell capacity [A.h]": model.capacity_Ah,
            "Nominal cell capacity [A.h]": model.capacity_Ah,
            "Current function [A]": "[input]",
            "Initial SoC": soc0,
            "Open-circuit voltage [V]": lambda soc: ocv[0] + (ocv[-1] - ocv[0]) * soc,
            "R0 [Ohm]": float(model.r0_ohm[0, 0]),
            "R1 [Ohm]": float(model.r1_ohm[0, 0]),
            "R2 [Ohm]": float(model.r2_ohm[0, 0]),
            "C1 [F]": float(model.c1_F[0, 0]),
            "C2 [F]": float(model.c2_F[0, 0]),
            "Element-1 initial overpotential [V]": 0.0,
            "Element-2 initial overpotential [V]": 0.0,
            "Entropic change [V/K]": 0.0,
            "Lower voltage cut-off [V]": 0.0,
            "Upper voltage cut-off [V]": 9.0,
        },
        check_already_exists=False,
    )
    solver = pybamm.IDAKLUSolver(rtol=1e-10, atol=1e-10)
    simulation = pybamm.Simulation(thevenin, parameter_values=values, solver=solver)
    found = []
    for current, dt in zip(current_A, dt_s, strict=True):
        solution = simulation.step(dt, inputs={"Current function [A]": float(current)})
        found.append(float(solution["Voltage [V]"].entries[-1]))
    return np.array(found)


@pytest.mark.slow
def test_random_current_through_constant_branches():
    model = linear_cell()
    rng = np.random.default_rng(1)
    dt = rng.uniform(0.5, 40.0, 60)
    current = rng.uniform(-4.0, 6.0, 60)
    log = CellLog(np.append(0.0, np.cumsum(dt)), np.append(0.0, current), np.full(61, 3.7))
    ours = simulate(model, log, 0.7).voltage_V[1:]
    theirs = pybamm_voltage(model, 0.7, current, dt)
    assert np.ptp(theirs) > 0.3
    np.testing.assert_allclose(ours, theirs, atol=1e-5)
