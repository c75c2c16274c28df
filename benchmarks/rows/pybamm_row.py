"""PyBaMM's Thevenin model of two RC elements behind filterpy's unscented Kalman filter.

The model is built and discretised by PyBaMM and its right-hand side taken as a CasADi function;
OCV, R0 and both elements come as `ukf.py` says. Isothermal at what is measured.
"""

import casadi
import numpy as np
import pybamm
from ukf import PERIOD_S, Ukf, apply_scale, fitted_to

CURRENT = "Current function [A]"
NAMES = {"R0 [Ohm]": "r0_ohm", "R1 [Ohm]": "r1_ohm", "C1 [F]": "c1_F", "R2 [Ohm]": "r2_ohm",
         "C2 [F]": "c2_F"}  # fmt: skip
STABLE = 2.0  # of the shortest time constant, in one Runge-Kutta step


class Model:
    """PyBaMM's right-hand side, advanced by Runge-Kutta steps."""

    def __init__(self, cell):
        model = pybamm.equivalent_circuit.Thevenin(options={"number of rc elements": 2})
        values = model.default_parameter_values
        warm, soc, tables = cell.grid_C, cell.soc, cell.tables

        def over_both(name):
            axes, found = (warm, soc), tables[name]
            return lambda T, current, s: pybamm.Interpolant(axes, found, [T, s])

        values.update(
            {
                CURRENT: "[input]",
                "Cell capacity [A.h]": cell.capacity_Ah,
                "Open-circuit voltage [V]": lambda s: pybamm.Interpolant(
                    soc, cell.at(cell.temperature_C)["ocv_V"], s
                ),
                "Element-2 initial overpotential [V]": 0.0,
                "Entropic change [V/K]": 0.0,
                **{name: over_both(table) for name, table in NAMES.items()},
            },
            check_already_exists=False,
        )
        simulation = pybamm.Simulation(model, parameter_values=values)
        simulation.build()
        built = simulation.built_model
        y, u, dt = casadi.MX.sym("y", 5), casadi.MX.sym("u"), casadi.MX.sym("dt")
        t, inputs = casadi.MX.sym("t"), {CURRENT: u}
        rates = built.concatenated_rhs.to_casadi(t, y, inputs=inputs)
        told = built.get_processed_variable("Voltage [V]").to_casadi(t, y, inputs=inputs)
        rate = casadi.Function("rate", [y, u], [rates])
        shortest = float((tables["r1_ohm"] * tables["c1_F"]).min())
        steps = max(int(np.ceil(PERIOD_S / (STABLE * shortest))), 2)
        x, h = y, dt / steps
        for _ in range(steps):
            a = rate(x, u)
            b = rate(x + h / 2 * a, u)
            c = rate(x + h / 2 * b, u)
            x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, u))
        self.advance = casadi.Function("advance", [y, u, dt], [x])
        self.told = casadi.Function("told", [y, u], [told])

    def step(self, x, current_A, temperature_C, dt_s):
        """SOC and overpotentials after an interval of one current."""
        y = [x[0], -x[1], -x[2], temperature_C, temperature_C]  # theirs is negative on discharge
        after = np.array(self.advance(y, current_A, dt_s))[:, 0]
        return np.array([after[0], -after[1], -after[2]])

    def voltage(self, x, current_A, temperature_C):
        """The model's terminal voltage."""
        y = [x[0], -x[1], -x[2], temperature_C, temperature_C]
        return float(self.told(y, current_A))


class Row(Ukf):
    """The filter on the model."""

    def __init__(self, cell, fitted):
        factors, residual = fitted
        super().__init__(Model(apply_scale(cell, factors)), residual, cell.capacity_Ah)

    @staticmethod
    def fit(cell, seed):
        """Factors on the tables, and how wrong the model's voltage then is on the drives."""
        return fitted_to(cell, Model)
