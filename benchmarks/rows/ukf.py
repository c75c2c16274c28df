"""filterpy's unscented Kalman filter over somebody's cell model of SOC and two overpotentials.

Models that have no fit of their own get cellwise's tables of OCV, R0 and two RC pairs, whose three
resistances and slower time constant are scaled by least squares on the cell's drives, since what
else cellwise found (diffusion, hysteresis) is not in their models. The model's own voltage error
over the drives, simulated open loop, is the measurement noise; process noise: a current that is off
by 1 % of 1C, overpotentials by 1 mV a step.
"""

import math

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from scipy.optimize import nnls
from serve import TABLES, at_period

PERIOD_S = 10.0
LONGEST = 1000  # steps of each drive that are simulated
SLOWER = (1.0, 2.0, 4.0, 8.0, 16.0)  # factors that are tried on the second time constant
LEAST_SCALE, LEAST_V, CURRENT_RATE, OVERPOTENTIAL_V = 0.1, 0.005, 0.01, 0.001


def branches(cell, rows, slower):
    """OCV and what the three resistances drop along a test, by the tables as they are."""
    tables = [cell.at(t) for t in rows["temperature_C"]]
    soc, current = rows["soc"], rows["current_A"]
    ocv, r0, r1, c1, r2, c2 = (
        np.array([np.interp(s, cell.soc, t[n]) for s, t in zip(soc, tables, strict=True)])
        for n in TABLES
    )
    drops = [current * r0]
    for r, tau in ((r1, r1 * c1), (r2, slower * r2 * c2)):
        drop, kept = np.zeros(soc.size), np.exp(-PERIOD_S / tau)
        for k in range(1, soc.size):
            drop[k] = kept[k] * drop[k - 1] + (1 - kept[k]) * r[k] * current[k]
        drops.append(drop)
    return ocv, np.column_stack(drops)


def scaled(cell):
    """Scale the cell's tables to its drives; (R0, R1, R2, second time constant)."""
    best = (math.inf, None)
    tests = [at_period(log, PERIOD_S) for log in cell.of("drive") or cell.of("hppc")]
    for slower in SLOWER:
        found = [(*branches(cell, rows, slower), rows["voltage_V"]) for rows in tests]
        design = np.vstack([drops for _, drops, _ in found])
        target = np.concatenate([ocv - seen for ocv, _, seen in found])
        inside = np.concatenate([(rows["soc"] > 0.05) for rows in tests])
        scale, left = nnls(design[inside], target[inside])
        if left < best[0]:
            best = left, (*np.maximum(scale, LEAST_SCALE), slower)
    k0, k1, k2, slower = best[1]
    factors = {"r0_ohm": k0, "r1_ohm": k1, "c1_F": 1 / k1, "r2_ohm": k2, "c2_F": slower / k2}
    return {name: float(value) for name, value in factors.items()}


def apply_scale(cell, factors):
    """The cell with its tables scaled."""
    for name, factor in factors.items():
        cell.tables[name] = cell.tables[name] * factor
    return cell


def fitted_to(cell, make):
    """What a row keeps: factors on the tables, and the voltage error of `make(cell)` with them."""
    factors = scaled(cell)
    return factors, residual_V(make(apply_scale(cell, factors)), cell)


def residual_V(model, cell):
    """RMS voltage error of `model.step(x, current_A, temperature_C, dt_s)` over the drives."""
    errors = []
    for log in cell.of("drive") or cell.of("hppc"):
        rows = at_period(log, PERIOD_S)
        x = np.array([rows["soc"][0], 0.0, 0.0])
        names = ("current_A", "temperature_C", "voltage_V")
        for current_A, warm, seen in list(zip(*(rows[n] for n in names), strict=True))[:LONGEST]:
            x = model.step(x, current_A, warm, PERIOD_S)
            errors.append(model.voltage(x, current_A, warm) - seen)
    return float(np.sqrt(np.nanmean(np.square(errors))))


class Ukf:
    """`start` and `step` of a row; `model` has `step` and `voltage`."""

    state_bytes = 8 * (3 + 9)

    def __init__(self, model, residual, capacity_Ah):
        self.model = model
        self.residual, self.capacity_Ah = max(residual, LEAST_V), capacity_Ah

    def start(self, soc0, soc0_std):
        points = MerweScaledSigmaPoints(3, alpha=0.5, beta=2.0, kappa=0.0)
        self.ukf = UnscentedKalmanFilter(3, 1, PERIOD_S, self._measure, self._move, points)
        self.ukf.x = np.array([soc0, 0.0, 0.0])
        self.ukf.P = np.diag([soc0_std**2, 0.01**2, 0.01**2])
        self.ukf.R = np.array([[self.residual**2]])

    def _move(self, x, dt):
        return self.model.step(self._inside(x), self.current_A, self.temperature_C, dt)

    def _measure(self, x):
        return np.array([self.model.voltage(self._inside(x), self.current_A, self.temperature_C)])

    @staticmethod
    def _inside(x):
        return np.array([min(max(x[0], 0.0), 1.0), x[1], x[2]])

    def step(self, current_A, voltage_V, temperature_C, dt_s):
        ukf, self.current_A, self.temperature_C = self.ukf, current_A, temperature_C
        drift = CURRENT_RATE * dt_s / 3600.0
        ukf.Q = np.diag([drift**2 + 1e-12, OVERPOTENTIAL_V**2, OVERPOTENTIAL_V**2])
        predicted = math.nan
        if dt_s > 0.0:
            ukf.predict(dt=dt_s)
            predicted = float(self._measure(ukf.x)[0])
            if voltage_V == voltage_V:
                ukf.update(np.array([voltage_V]))
        soc = min(max(float(ukf.x[0]), 0.0), 1.0)
        return soc, math.sqrt(max(float(ukf.P[0, 0]), 0.0)), predicted
