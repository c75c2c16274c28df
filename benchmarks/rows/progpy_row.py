"""progpy's BatteryElectroChemEOD (Daigle and Kulkarni 2013) in its own UKF or particle filter.

Identified as `progpy_fit.py` says. SOC is the charge of the electrode that their `EOD` event looks
at. Noise of both filters as in their particle filter example, the voltage's no less than what the
fit leaves. Starts are as wrong as the suite states.
"""

import math
import warnings

import numpy as np
from progpy.state_estimators import ParticleFilter, UnscentedKalmanFilter
from progpy.uncertain_data import MultivariateNormalDist
from progpy_fit import STABLE_S, Inside, at_soc, fitted_to

warnings.simplefilter("ignore")
PARTICLES = 500
BEFORE = 24  # steps of the first current before the start: nobody knows what flowed
PROCESS = {"tb": 1.0, "Vo": 0.01, "Vsn": 0.01, "Vsp": 0.01, "qnB": 1.0, "qnS": 1.0, "qpB": 1.0,
           "qpS": 1.0}  # fmt: skip
MEASURED = {"t": 2.0, "v": 0.02}  # both from their particle filter example


class Row:
    """Their estimator, a sample at a time."""

    def __init__(self, cell, fitted, kind="ukf"):
        self.cell, self.kind = cell, kind
        residual, parameters = fitted
        self.model = Inside(**parameters)
        self.measured = {**MEASURED, "v": max(MEASURED["v"], residual)}
        self.model.parameters["process_noise"] = PROCESS if kind == "pf" else 0.0
        self.state_bytes = 8 * (8 * PARTICLES if kind == "pf" else 8 + 64)

    @staticmethod
    def fit(cell, seed):
        """Their own search for the parameters."""
        return fitted_to(cell)

    def start(self, soc0, soc0_std):
        self.soc0, self.std0, self.filter, self.time_s = soc0, soc0_std, None, 0.0

    def _begin(self, current_A, temperature_C):
        inside = np.linspace(0.02, 0.98, 97)  # what a start beyond full or empty is as moments
        weight = np.exp(-0.5 * ((inside - self.soc0) / self.std0) ** 2)
        soc0 = np.average(inside, weights=weight)
        std0 = np.sqrt(np.average((inside - soc0) ** 2, weights=weight))
        x0 = at_soc(self.model, soc0, temperature_C)
        x, u = self.model.StateContainer(dict(x0)), self.model.InputContainer({"i": current_A})
        for _ in range(BEFORE):
            x = self.model.next_state(x, u, STABLE_S)
        lags = {n: float(np.ravel(x[n])[0]) for n in ("Vo", "Vsn", "Vsp")}
        x0 = {n: lags.get(n, value) for n, value in x0.items()}
        slope = {n: (at_soc(self.model, 0.6, 20)[n] - at_soc(self.model, 0.5, 20)[n]) / 0.1
                 for n in x0}  # fmt: skip
        along = np.array([slope[n] for n in x0])
        volts = (max(0.01, 0.5 * abs(lag)) for lag in lags.values())
        small = np.array([0.5, *volts, 5.0, 1.0, 5.0, 1.0])
        keys = list(x0)
        where = dict(zip(PROCESS, small, strict=True))
        spread = np.diag([where[k] ** 2 for k in keys]) + std0**2 * np.outer(along, along)
        start = MultivariateNormalDist(keys, [x0[k] for k in keys], spread)
        if self.kind == "pf":
            np.random.seed(1)  # noqa: NPY002 (theirs draws from it)
            self.filter = ParticleFilter(
                self.model,
                start,
                num_particles=PARTICLES,
                measurement_noise=self.measured,
                dt=STABLE_S,
            )
        else:
            q = np.diag([PROCESS[k] ** 2 for k in keys])
            r = np.diag([self.measured[k] ** 2 for k in ("t", "v")])
            self.filter = UnscentedKalmanFilter(self.model, start, Q=q, R=r, dt=STABLE_S)

    def step(self, current_A, voltage_V, temperature_C, dt_s):
        if self.filter is None:
            self._begin(current_A, temperature_C)
            self.last_V = voltage_V
            return self.soc0, self.std0, math.nan
        self.last_V = voltage_V if voltage_V == voltage_V else self.last_V
        self.time_s += dt_s
        u = self.model.InputContainer({"i": current_A})
        z = self.model.OutputContainer({"t": temperature_C, "v": self.last_V})
        self.filter.estimate(self.time_s, u, z)
        full = self.model.parameters["qnMax"]
        if self.kind == "pf":
            charge = self.filter.particles["qnS"] + self.filter.particles["qnB"]
            return float(np.mean(charge) / full), float(np.std(charge) / full), math.nan
        keys, own = list(self.filter.x0.keys()), self.filter.filter
        pick = np.array([k in ("qnS", "qnB") for k in keys], dtype=float)
        return (
            float(pick @ own.x / full),
            math.sqrt(max(float(pick @ own.P @ pick), 0.0)) / full,
            math.nan,
        )
