"""PyBatteryID's model in PyBatterySE's extended Kalman filter or particle filter.

Identified as their pages show it: EMF points from the low-rate test, an LPV model of overpotentials
of order 2 on drives (current positive on charge, charge in coulomb), cross-validated LASSO, then
ridge regression on what is left. Their own example's variances and initial covariance.
"""

import math

import numpy as np
from pybatteryid.identification import identify_model
from pybatteryid.modelstructure import ModelStructure
from pybatteryse import load_filter, load_statespace_representation
from serve import at_period

PERIOD_S = 10.0
ORDER = 2
BASIS = ["1/s", "log[s]", "s", "exp[0.05*sqrt[|i|]]", "d[0.01,0.99]"]
OPTIMIZERS = ["lassocv.sklearn", "ridgecv.sklearn"]
LEAST_SOC, FULL = 0.01, 0.998  # no EMF outside; 1/s and log s have no value at empty
INPUT, OUTPUT = 1e-2, 1e-3


class Row:
    """Their filter, stepped by its own `predict` and `update`."""

    def __init__(self, cell, fitted, kind="extended_kalman_filter"):
        self.space = load_statespace_representation(fitted, ["s", "overpotentials"])
        self.filter = load_filter(self.space, kind, variance_eta_u=INPUT, variance_eta_y_e=OUTPUT)
        self.state_bytes = 8 * ((1 + ORDER) + (1 + ORDER) ** 2)

    @staticmethod
    def fit(cell, seed):
        """Their `identify_model` on the cell's drives, the pulse test where there is no drive."""
        structure = ModelStructure(3600.0 * cell.capacity_Ah, PERIOD_S)
        emf = cell.at(cell.temperature_C)["ocv_V"]
        structure.add_emf_function({"soc_values": cell.soc, "voltage_values": emf})
        structure.add_basis_functions(BASIS)
        sets = []
        for log in cell.of("drive") or cell.of("hppc"):
            rows = at_period(log, PERIOD_S)
            n = int(np.argmax(rows["soc"] < LEAST_SOC)) or rows["soc"].size
            sets.append(
                {
                    "initial_soc": float(rows["soc"][0] - max(rows["soc"].max() - FULL, 0.0)),
                    "time_values": rows["time_s"][:n],
                    "current_values": -rows["current_A"][:n],
                    "voltage_values": rows["voltage_V"][:n],
                }
            )
        np.random.seed(seed)  # noqa: NPY002 (theirs draws from it)
        return identify_model(sets, structure, ORDER, 2, OPTIMIZERS)

    def start(self, soc0, soc0_std):
        self.filter.state_estimate = np.array([soc0] + [0.0] * ORDER)
        self.filter.error_covariance = np.diag([soc0_std**2] + [0.1] * ORDER)
        self.space.update_model_from_state(self.filter.state_estimate)
        self.before = None

    def step(self, current_A, voltage_V, temperature_C, dt_s):
        filt, seen = self.filter, not math.isnan(voltage_V)
        if self.before is not None:
            state, covariance = filt.predict(*self.before)
            predicted = self.space.evaluate_predicted_measurement(state, -current_A)
            if seen:
                state, covariance = filt.update(state, covariance, -current_A, voltage_V)
            filt.state_estimate, filt.error_covariance = state, covariance
        else:
            predicted = math.nan
        if seen:
            self.before = (-current_A, voltage_V)
        elif self.before is not None:  # the input is known, the voltage as predicted
            self.before = (-current_A, float(predicted))
        return (
            float(filt.state_estimate[0]),
            math.sqrt(max(float(filt.error_covariance[0, 0]), 0.0)),
            float(predicted),
        )
