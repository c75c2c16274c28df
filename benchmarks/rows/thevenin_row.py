"""NREL's thevenin (its `Prediction` interface) behind filterpy's unscented Kalman filter.

thevenin has no fit of its own: OCV, R0 and two RC pairs come as `ukf.py` says.
"""

import numpy as np
import thevenin
from ukf import Ukf, apply_scale, fitted_to

ROUGH = {"rtol": 1e-4, "atol": 1e-6}


class Model:
    """thevenin at a measured temperature: SOC and two overpotentials."""

    def __init__(self, cell):
        self.cell, self.known_C = cell, np.nan
        over = {"ocv": "ocv_V", "R0": "r0_ohm", "R1": "r1_ohm", "C1": "c1_F", "R2": "r2_ohm"}
        parts = {k: self._table(v) for k, v in {**over, "C2": "c2_F"}.items()}
        self.own = thevenin.Prediction(
            {
                "num_RC_pairs": 2, "soc0": 0.5, "capacity": cell.capacity_Ah, "ce": 1.0,
                "gamma": 0.0, "mass": 0.05, "isothermal": True, "Cp": 1000.0, "T_inf": 298.15,
                "h_therm": 10.0, "A_therm": 0.01, "M_hyst": lambda soc: 0.0 * soc, **parts,
            }
        )  # fmt: skip
        self.own.set_options(**ROUGH)

    def _table(self, name):
        return lambda soc, *_: np.interp(soc, self.cell.soc, self.tables[name])

    def _warm(self, temperature_C):
        if not abs(temperature_C - self.known_C) < 0.5:
            self.known_C, self.tables = temperature_C, self.cell.at(temperature_C)

    @property
    def tables(self):
        """At the temperature in force."""
        if not hasattr(self, "_tables"):
            self._tables = self.cell.at(self.cell.temperature_C)
        return self._tables

    @tables.setter
    def tables(self, found):
        self._tables = found

    def step(self, x, current_A, temperature_C, dt_s):
        """Their prediction."""
        self._warm(temperature_C)
        state = thevenin.TransientState(float(x[0]), 298.15, 0.0, np.array(x[1:]))
        after = self.own.take_step(state, float(current_A), float(dt_s))
        return np.array([after.soc, *after.eta_j])

    def voltage(self, x, current_A, temperature_C):
        """Their voltage, as `take_step` makes it of a state."""
        self._warm(temperature_C)
        return float(self.own.ocv(x[0]) - x[1] - x[2] - current_A * self.own.R0(x[0], 298.15))


class Row(Ukf):
    """The filter on the model."""

    def __init__(self, cell, fitted):
        factors, residual = fitted
        super().__init__(Model(apply_scale(cell, factors)), residual, cell.capacity_Ah)

    @staticmethod
    def fit(cell, seed):
        """Factors on the tables, and how wrong the model's voltage then is on the drives."""
        return fitted_to(cell, Model)
