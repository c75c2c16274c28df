"""One pulse fitted by scipy's general optimisers, all seven parameters at once."""

from __future__ import annotations

from typing import Literal

import numpy as np

from cellwise.identify.pulse_fit.pulse_data import PulseData, row_weights
from cellwise.typing import FloatArray

Optimiser = Literal["lm", "trf", "curve_fit"]
LOW = np.array([1.0, 0.0, 0.0, 0.0, 0.05, 0.0, 5.0])
HIGH = np.array([5.0, 50.0, 1.0, 1.0, 15.0, 1.0, 600.0])


class ScipyPulse:
    """A pulse at constant current after a rest: OCV, its slope, R0, R1, tau1, R2, tau2.

    The branches are closed expressions in time, so an evaluation is a handful of array operations.
    """

    def __init__(self, data: PulseData) -> None:
        edge, end = data.time_s[data.start - 1], data.time_s[data.stop - 1]
        self.current = data.pulse_current_A
        self.on = np.clip(data.time_s - edge, 0.0, end - edge)
        self.off = np.clip(data.time_s - end, 0.0, None)
        self.flowing = (data.time_s > edge) & (data.time_s <= end)
        self.charge = data.charge_fraction - data.pulse_centre
        self.voltage = data.voltage_V
        self.root = np.sqrt(row_weights(data))
        drop = abs(data.voltage_V[data.start] - data.voltage_V[data.start - 1])
        r0 = max(float(drop / abs(self.current)), 1e-4)
        self.start = np.array(
            [float(data.voltage_V[data.start - 1]), 0.5, r0, 0.5 * r0, 3.0, 0.5 * r0, 40.0]
        )

    def model(self, p: FloatArray) -> FloatArray:
        """Terminal voltage of every row [V]."""
        ocv, slope, r0, r1, tau1, r2, tau2 = p
        v1 = r1 * -np.expm1(-self.on / tau1) * np.exp(-self.off / tau1)
        v2 = r2 * -np.expm1(-self.on / tau2) * np.exp(-self.off / tau2)
        return ocv - slope * self.charge - self.current * (r0 * self.flowing + v1 + v2)

    def residual(self, p: FloatArray) -> FloatArray:
        """Weighted residual of every row [V]."""
        return self.root * (self.voltage - self.model(p))

    def rmse_V(self, p: FloatArray) -> float:
        """Weighted root mean square residual, as the package's own fits state it."""
        return float(np.sqrt(np.sum(self.residual(p) ** 2) / np.sum(self.root**2)))

    def fit(self, optimiser: Optimiser) -> FloatArray:
        """The seven parameters."""
        from scipy.optimize import curve_fit, least_squares

        if optimiser == "curve_fit":
            used = self.root > 0.0
            found, _ = curve_fit(
                lambda _, *p: self.model(np.array(p))[used],
                self.on[used],
                self.voltage[used],
                self.start,
                sigma=1.0 / self.root[used],
                bounds=(LOW, HIGH),
            )
            return np.asarray(found)
        bounds = (LOW, HIGH) if optimiser == "trf" else (-np.inf, np.inf)
        found = least_squares(
            self.residual, self.start, bounds=bounds, method=optimiser, x_scale="jac"
        )
        return np.asarray(found.x)
