"""The same 2-RC cell simulated by others: each function gives voltages and the time they took."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.logs import CellLog
from cellwise.typing import FloatArray

Answer = tuple[FloatArray, float]


def plain_loop(model: CellModel, log: CellLog, soc0: float) -> Answer:
    """What one writes first: a Python loop over the samples with np.interp for the tables."""
    current, dt, grid = log.current_A, log.interval_s, model.soc
    ocv, r0, r1, tau1, r2, tau2 = (
        getattr(model, name)[0]
        for name in ("ocv_V", "r0_ohm", "r1_ohm", "tau1_s", "r2_ohm", "tau2_s")
    )
    began = time.perf_counter()
    voltage = np.empty(len(log))
    soc, v1, v2 = soc0, 0.0, 0.0
    for k in range(len(log)):
        i, h = current[k], dt[k]
        soc -= i * h / (3600.0 * model.capacity_Ah)
        a1 = np.exp(-h / np.interp(soc, grid, tau1))
        a2 = np.exp(-h / np.interp(soc, grid, tau2))
        v1 = a1 * v1 + np.interp(soc, grid, r1) * (1.0 - a1) * i
        v2 = a2 * v2 + np.interp(soc, grid, r2) * (1.0 - a2) * i
        voltage[k] = np.interp(soc, grid, ocv) - np.interp(soc, grid, r0) * i - v1 - v2
    return voltage, time.perf_counter() - began


def pybamm_thevenin(model: CellModel, log: CellLog, soc0: float) -> Answer:
    """PyBaMM's Thevenin model, its IDAKLU solver, results at the samples (``t_interp``).

    The second of two solutions is timed: the first one also builds the model.
    """
    import pybamm

    grid = model.soc

    def of_soc(table: FloatArray, name: str) -> Callable[..., object]:
        return lambda soc: pybamm.Interpolant(grid, table, soc, name=name)

    def of_state(table: FloatArray, name: str) -> Callable[..., object]:
        return lambda temperature, current, soc: pybamm.Interpolant(grid, table, soc, name=name)

    values = pybamm.ParameterValues("ECM_Example")
    values.update(
        {
            "Cell capacity [A.h]": model.capacity_Ah,
            "Nominal cell capacity [A.h]": model.capacity_Ah,
            "Current function [A]": pybamm.Interpolant(log.time_s, log.current_A, pybamm.t),
            "Initial SoC": soc0,
            "Open-circuit voltage [V]": of_soc(model.ocv_V[0], "ocv"),
            "R0 [Ohm]": of_state(model.r0_ohm[0], "r0"),
            "R1 [Ohm]": of_state(model.r1_ohm[0], "r1"),
            "R2 [Ohm]": of_state(model.r2_ohm[0], "r2"),
            "C1 [F]": of_state(model.c1_F[0], "c1"),
            "C2 [F]": of_state(model.c2_F[0], "c2"),
            "Element-1 initial overpotential [V]": 0.0,
            "Element-2 initial overpotential [V]": 0.0,
            "Entropic change [V/K]": 0.0,
            "Lower voltage cut-off [V]": 0.0,
            "Upper voltage cut-off [V]": 9.0,
        },
        check_already_exists=False,
    )
    simulation = pybamm.Simulation(
        pybamm.equivalent_circuit.Thevenin(options={"number of rc elements": 2}),
        parameter_values=values,
        solver=pybamm.IDAKLUSolver(),
    )
    simulation.solve([0.0, 10.0], t_interp=np.arange(11.0))
    began = time.perf_counter()
    solution = simulation.solve([0.0, float(log.time_s[-1])], t_interp=log.time_s)
    voltage = np.asarray(solution["Voltage [V]"](log.time_s))
    return voltage, time.perf_counter() - began


def thevenin_prediction(model: CellModel, log: CellLog, soc0: float) -> Answer:
    """The thevenin package, sample by sample (its ``Prediction``)."""
    import thevenin

    cell = thevenin.Prediction(_thevenin_parameters(model, soc0))
    began = time.perf_counter()
    state = thevenin.TransientState(soc0, 298.15, 0.0, np.zeros(2))
    voltage = np.full(len(log), model.ocv_V[0][-1])
    dt = log.interval_s
    for k in range(1, len(log)):
        state = cell.take_step(state, float(log.current_A[k]), float(dt[k]))
        voltage[k] = state.voltage
    return voltage, time.perf_counter() - began


def thevenin_simulation(model: CellModel, log: CellLog, soc0: float) -> Answer:
    """The thevenin package, the whole profile as one step (its ``Simulation``)."""
    import thevenin

    cell = thevenin.Simulation(_thevenin_parameters(model, soc0))
    experiment = thevenin.Experiment()
    experiment.add_step(
        "current_A",
        lambda t: np.interp(t, log.time_s, log.current_A),
        (float(log.time_s[-1]), float(log.interval_s[1])),
    )
    began = time.perf_counter()
    solution = cell.run(experiment)
    voltage = np.interp(log.time_s, solution.vars["time_s"], solution.vars["voltage_V"])
    return voltage, time.perf_counter() - began


def _thevenin_parameters(model: CellModel, soc0: float) -> dict[str, object]:
    grid = model.soc

    def of_state(table: FloatArray) -> Callable[..., float]:
        return lambda soc, temperature: np.interp(soc, grid, table)

    return {
        "num_RC_pairs": 2,
        "soc0": soc0,
        "capacity": model.capacity_Ah,
        "ce": 1.0,
        "gamma": 0.0,
        "mass": 0.05,
        "isothermal": True,
        "Cp": 1000.0,
        "T_inf": 298.15,
        "h_therm": 10.0,
        "A_therm": 0.01,
        "ocv": lambda soc: np.interp(soc, grid, model.ocv_V[0]),
        "M_hyst": lambda soc: 0.0,
        "R0": of_state(model.r0_ohm[0]),
        "R1": of_state(model.r1_ohm[0]),
        "R2": of_state(model.r2_ohm[0]),
        "C1": of_state(model.c1_F[0]),
        "C2": of_state(model.c2_F[0]),
    }
