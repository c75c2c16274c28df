"""A cell made of physics: PyBaMM's Doyle-Fuller-Newman model under current or voltage control.

One discretised model serves both controls. The applied current is an algebraic unknown closed by

    mode * (V - V_set) + (1 - mode) * (I - I_set) = 0,

so a constant-current phase runs into a constant-voltage phase without a change of state vector.
Every call of the solver covers one interval of constant set point: it restarts at each edge of
the current and can never step over a short burst, and the current between two edges is exactly
constant (zero-order hold).
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
import pybamm
from numpy.typing import NDArray

from .cells import CellSetup

FloatArray = NDArray[np.float64]
EndedBy = Literal["time", "limit", "cutoff"]

SEPARATOR_POINTS = 8
PARTICLE_POINTS = 24
SOLVER_RTOL = 1e-6
SOLVER_ATOL = 1e-8

# How long a set current flows before the voltage regulator of the tester takes over.
REGULATOR_DELAY_S = 0.005
# Limits that no cell reaches: "do not look".
FAR_BELOW_V, FAR_ABOVE_V = -50.0, 50.0


class Stretch(NamedTuple):
    """What happened at the asked instants of one interval, all arrays of shape (n,).

    `time_s` [s] counts from the interval's start; the last row is the interval's end. `charge_Ah`
    [Ah] is the discharged charge since the cell was built. n is zero where the limit was already
    exceeded at the first instant.
    """

    time_s: FloatArray
    voltage_V: FloatArray
    temperature_C: FloatArray
    charge_Ah: FloatArray
    ended_by: EndedBy


_NOTHING = np.zeros(0)


def _control(variables: dict[str, pybamm.Symbol]) -> pybamm.Symbol:
    """External circuit: constant current where `mode` is 0, constant voltage where it is 1."""
    mode = pybamm.InputParameter("mode")
    voltage_error = variables["Voltage [V]"] - pybamm.InputParameter("V_set")
    current_error = variables["Current [A]"] - pybamm.InputParameter("I_set")
    return mode * voltage_error + (1 - mode) * current_error


def _events(variables: dict[str, pybamm.Symbol]) -> list[pybamm.Event]:
    """Stops of the tester; the cell's own cut-offs are replaced by them."""
    voltage, current = variables["Voltage [V]"], variables["Current [A]"]
    sign, cutoff = pybamm.InputParameter("sign"), pybamm.InputParameter("I_cut")
    return [
        pybamm.Event("limit low", voltage - pybamm.InputParameter("V_low")),
        pybamm.Event("limit high", pybamm.InputParameter("V_high") - voltage),
        pybamm.Event("cutoff", sign * current - cutoff),
    ]


class PhysicsCell:
    """A cell that remembers its state between intervals.

    Parameters
    ----------
    setup : CellSetup        which parameter set, which window
    soc : float              state of charge at the start, in equilibrium, 0..1
    ambient_C : float        temperature of the chamber and of the cell at the start [degC]

    Attributes
    ----------
    ambient_C : float        temperature of the chamber from now on; may be changed [degC]
    capacity_Ah : float      charge between the window's two open-circuit voltages [Ah]
    """

    def __init__(self, setup: CellSetup, soc: float = 0.9, ambient_C: float = 25.0) -> None:
        options = {
            "operating mode": _control,
            "thermal": setup.thermal,
            "calculate discharge energy": "true",
        }
        model = pybamm.lithium_ion.DFN(options)
        model.events = _events(model.variables)
        parameters = _parameters(setup, ambient_C)
        self.capacity_Ah = _window_capacity(parameters)
        parameters.set_initial_state(soc)
        parameters.update({"Ambient temperature [K]": "[input]"})
        self.ambient_C = ambient_C
        self._solver = pybamm.IDAKLUSolver(rtol=SOLVER_RTOL, atol=SOLVER_ATOL)
        simulation = pybamm.Simulation(
            model,
            parameter_values=parameters,
            submesh_types=_refined_particles(model, setup.stretch),
            var_pts={
                "x_n": setup.electrode_points,
                "x_s": SEPARATOR_POINTS,
                "x_p": setup.electrode_points,
                "r_n": PARTICLE_POINTS,
                "r_p": PARTICLE_POINTS,
            },
            solver=self._solver,
        )
        simulation.build()
        self._model = simulation.built_model
        self._start_soc = soc
        self._solution: Any = None
        self.charge_Ah = 0.0
        self.voltage_V = float("nan")
        self.temperature_C = ambient_C
        self.constant_current(0.0, np.array([1.0]), FAR_BELOW_V, FAR_ABOVE_V)

    @property
    def soc(self) -> float:
        """State of charge by lithium inventory: 1 and 0 at the open-circuit limits."""
        return self._start_soc - self.charge_Ah / self.capacity_Ah

    def constant_current(
        self, current_A: float, rows_s: FloatArray, lower_V: float, upper_V: float
    ) -> Stretch:
        """Hold a current until the last row or until the limit it drives towards.

        Parameters
        ----------
        current_A : float            set current, positive on discharge [A]
        rows_s : (n,) array          instants wanted, from the interval's start, increasing [s]
        lower_V, upper_V : float     limits; a discharge looks at the lower, a charge at the upper
        """
        inputs = {
            "mode": 0.0,
            "I_set": current_A,
            "V_set": 0.0,
            "V_low": lower_V if current_A > 0 else FAR_BELOW_V,
            "V_high": upper_V if current_A < 0 else FAR_ABOVE_V,
            "sign": 0.0,
            "I_cut": -1.0,
        }
        return self._advance(inputs, rows_s, "limit")

    def constant_voltage(
        self, voltage_V: float, rows_s: FloatArray, sign: float, cutoff_A: float
    ) -> Stretch:
        """Hold a voltage until the last row or until the current has fallen to the cut-off.

        Parameters
        ----------
        voltage_V : float      set voltage [V]
        rows_s : (n,) array    instants wanted [s]
        sign : float           +1 where the cell is being discharged, -1 where charged
        cutoff_A : float       magnitude of the current that ends the phase [A]
        """
        inputs = {
            "mode": 1.0,
            "I_set": 0.0,
            "V_set": voltage_V,
            "V_low": FAR_BELOW_V,
            "V_high": FAR_ABOVE_V,
            "sign": sign,
            "I_cut": cutoff_A,
        }
        return self._advance(inputs, rows_s, "cutoff")

    def current_within(self, request_A: float, lower_V: float, upper_V: float) -> float:
        """Return the largest share of a requested current that respects the limits at once [A].

        Needed where the request exceeds a limit in its first instant; found by bisection on
        trial steps of `REGULATOR_DELAY_S` that leave the cell as it was.
        """
        low, high = 0.0, 1.0
        for _ in range(12):
            share = 0.5 * (low + high)
            if self._allows(share * request_A, lower_V, upper_V):
                low = share
            else:
                high = share
        return low * request_A

    def _allows(self, current_A: float, lower_V: float, upper_V: float) -> bool:
        saved = (self._solution, self.charge_Ah, self.voltage_V, self.temperature_C)
        try:
            rows = np.array([REGULATOR_DELAY_S])
            return self.constant_current(current_A, rows, lower_V, upper_V).ended_by == "time"
        except pybamm.SolverError:
            return False
        finally:
            self._solution, self.charge_Ah, self.voltage_V, self.temperature_C = saved

    def _advance(self, inputs: dict[str, float], rows_s: FloatArray, stop: EndedBy) -> Stretch:
        duration = float(rows_s[-1])
        if self._solution is not None:
            # PyBaMM refuses to go on after an event; a tester goes on with its next step.
            self._solution.termination = "final time"
        try:
            solution = self._solver.step(
                self._solution,
                self._model,
                duration,
                t_interp=np.concatenate(([0.0], rows_s)),
                inputs={**inputs, "Ambient temperature [K]": 273.15 + self.ambient_C},
                save=False,
            )
        except pybamm.SolverError as error:
            if "non-positive at initial conditions" not in str(error):
                raise
            return Stretch(_NOTHING, _NOTHING, _NOTHING, _NOTHING, stop)
        start = 0.0 if self._solution is None else float(self._solution.t[-1])
        self._solution = solution
        ended_by: EndedBy = "time" if solution.termination == "final time" else stop
        stretch = Stretch(
            np.asarray(solution.t[1:] - start, dtype=np.float64),
            solution["Voltage [V]"].entries[1:],
            solution["Volume-averaged cell temperature [K]"].entries[1:] - 273.15,
            solution["Discharge capacity [A.h]"].entries[1:],
            ended_by,
        )
        self.voltage_V = float(stretch.voltage_V[-1])
        self.temperature_C = float(stretch.temperature_C[-1])
        self.charge_Ah = float(stretch.charge_Ah[-1])
        return stretch


def _parameters(setup: CellSetup, ambient_C: float) -> pybamm.ParameterValues:
    """Published set with the changes and loans that `CellSetup` names."""
    parameters = pybamm.ParameterValues(setup.parameter_set)
    if setup.borrowed is not None:
        other, names = setup.borrowed
        lender = pybamm.ParameterValues(other)
        parameters.update({name: lender[name] for name in names})
    kelvin = 273.15 + ambient_C
    parameters.update({"Ambient temperature [K]": kelvin, "Initial temperature [K]": kelvin})
    parameters.update(dict(setup.changes))
    return parameters


def _window_capacity(parameters: pybamm.ParameterValues) -> float:
    """Charge between the open-circuit voltages that bound the window [Ah]."""
    low, high, _, _ = pybamm.lithium_ion.get_min_max_stoichiometries(parameters)
    electrode_Ah = parameters.evaluate(pybamm.LithiumIonParameters().n.prim.Q_init)
    return float(electrode_Ah * (high - low))


def _refined_particles(model: pybamm.BaseModel, stretch: float) -> dict[str, Any]:
    """Particle meshes refined towards the surface, where a 0.1 s response is decided."""
    submeshes = dict(model.default_submesh_types)
    refined = pybamm.MeshGenerator(
        pybamm.Exponential1DSubMesh, submesh_params={"side": "right", "stretch": stretch}
    )
    submeshes["negative particle"] = refined
    submeshes["positive particle"] = refined
    return submeshes
