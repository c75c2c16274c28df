"""progpy's BatteryElectroChemEOD (Daigle and Kulkarni 2013) in its own UKF or particle filter.

Identified in their order: the charge, the positive electrode's equilibrium potential on the OCV
(its Redlich-Kister coefficients are linear in the model's own output), then ohmic resistance,
kinetics and diffusion by the model's own `estimate_params` on a drive. SOC is the charge of the
electrode that their `EOD` event looks at. Noise of both filters as in their particle filter
example, the voltage's no less than what the fit leaves.
"""

import math
import warnings

import numpy as np
from progpy.models import BatteryElectroChemEOD
from progpy.state_estimators import ParticleFilter, UnscentedKalmanFilter
from progpy.uncertain_data import MultivariateNormalDist
from serve import at_period

warnings.simplefilter("ignore")
STEP_S, POINTS, PARTICLES = 10.0, 60, 100
STABLE_S = 5.0  # their Euler steps swing beyond: the ohmic lag is 6 s
SIGMAS = 3.3  # how far their sigma points reach, and a little: none may leave the electrode
TERMS, RIDGE = 13, 1e-4  # of the Redlich-Kister expansion; of its least squares
KINETIC = {"Ro": (1e-3, 1.0), "tDiffusion": (1e6, 2e7), "kn": (10.0, 1e7), "kp": (10.0, 1e7)}
DRIVE_ROWS, TRIES = 240, 100  # 40 min of a drive; simulations of their search
PROCESS = {"tb": 1.0, "Vo": 0.01, "Vsn": 0.01, "Vsp": 0.01, "qnB": 1.0, "qnS": 1.0, "qpB": 1.0,
           "qpS": 1.0}  # fmt: skip
MEASURED = {"t": 2.0, "v": 0.02}  # both from their particle filter example


def at_soc(model, soc, temperature_C):
    """The model's state at equilibrium."""
    p, x = model.parameters, {"tb": temperature_C + 273.15, "Vo": 0.0, "Vsn": 0.0, "Vsp": 0.0}
    negative, positive = soc * p["qnMax"], p["qMax"] - soc * p["qnMax"]
    for name, share in (("S", p["VolSFraction"]), ("B", 1.0 - p["VolSFraction"])):
        x[f"qn{name}"], x[f"qp{name}"] = share * negative, share * positive
    return x


class Row:
    """Their estimator, a sample at a time."""

    def __init__(self, cell, fitted, kind="ukf"):
        self.cell, self.kind = cell, kind
        residual, parameters = fitted
        self.model = BatteryElectroChemEOD(**parameters)
        self.measured = {**MEASURED, "v": max(MEASURED["v"], residual)}
        self.model.parameters["process_noise"] = PROCESS if kind == "pf" else 0.0
        self.state_bytes = 8 * (8 * PARTICLES if kind == "pf" else 8 + 64)

    @staticmethod
    def fit(cell, seed):
        """Parameters of the model that differ from its defaults."""
        warm = cell.temperature_C
        found = {"qMobile": 3600.0 * cell.capacity_Ah, "VEOD": 2.5}
        soc = np.linspace(0.02, 0.98, POINTS)
        ocv = np.interp(soc, cell.soc, cell.at(warm)["ocv_V"])

        def potential(u0p, coefficients):
            model = BatteryElectroChemEOD(**found, U0p=u0p, Ap=list(coefficients))
            states = (model.StateContainer(at_soc(model, s, warm)) for s in soc)
            return np.array([float(np.ravel(model.output(x)["v"])[0]) for x in states])

        none = np.zeros(TERMS)
        base, unit = potential(0.0, none), 1e5  # J/mol
        parts = [potential(1.0, none), *(potential(0.0, row) for row in unit * np.eye(TERMS))]
        design = np.column_stack([part - base for part in parts])
        square = design.T @ design + RIDGE * np.eye(TERMS + 1)
        solved = np.linalg.solve(square, design.T @ (ocv - base))
        found |= {"U0p": float(solved[0]), "Ap": [float(v) for v in unit * solved[1:]]}
        model = BatteryElectroChemEOD(**found)
        rows = at_period((cell.of("drive") or cell.of("hppc"))[0], STEP_S)
        rows = {name: values[:DRIVE_ROWS] for name, values in rows.items()}
        seen = zip(rows["temperature_C"], rows["voltage_V"], strict=True)
        model.estimate_params(
            times=list(rows["time_s"]),
            inputs=[{"i": float(i)} for i in rows["current_A"]],
            outputs=[{"t": float(t), "v": float(v)} for t, v in seen],
            keys=list(KINETIC),
            bounds=KINETIC,
            x0=model.StateContainer(at_soc(model, 0.999, warm)),
            dt=STABLE_S,
            options={"maxfev": TRIES, "fatol": 1e-7},
        )
        x, wrong = model.StateContainer(at_soc(model, 0.999, warm)), []
        for current_A, seen_V in zip(rows["current_A"], rows["voltage_V"], strict=True):
            for _ in range(round(STEP_S / STABLE_S)):
                x = model.next_state(x, model.InputContainer({"i": current_A}), STABLE_S)
            wrong.append(float(np.ravel(model.output(x)["v"])[0]) - seen_V)
        residual = float(np.sqrt(np.nanmean(np.square(wrong))))
        return residual, found | {name: float(model.parameters[name]) for name in KINETIC}

    def start(self, soc0, soc0_std):
        self.soc0, self.std0, self.filter, self.time_s = soc0, soc0_std, None, 0.0

    def _begin(self, temperature_C):
        x0 = at_soc(self.model, min(max(self.soc0, 0.02), 0.98), temperature_C)
        slope = {n: (at_soc(self.model, 0.6, 20)[n] - at_soc(self.model, 0.5, 20)[n]) / 0.1
                 for n in x0}  # fmt: skip
        along = np.array([slope[n] for n in x0])
        small = np.array([0.5, 0.01, 0.01, 0.01, 5.0, 1.0, 5.0, 1.0])
        keys = list(x0)
        where = dict(zip(PROCESS, small, strict=True))
        std = min(self.std0, self.soc0 / SIGMAS, (1.0 - self.soc0) / SIGMAS)
        spread = np.diag([where[k] ** 2 for k in keys]) + std**2 * np.outer(along, along)
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
            q = np.diag([(PROCESS[k] * 0.1) ** 2 for k in keys])
            r = np.diag([self.measured[k] ** 2 for k in ("t", "v")])
            self.filter = UnscentedKalmanFilter(self.model, start, Q=q, R=r, dt=STABLE_S)

    def step(self, current_A, voltage_V, temperature_C, dt_s):
        if self.filter is None:
            self._begin(temperature_C)
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
