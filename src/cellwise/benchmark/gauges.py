"""Two gauges that most firmware has, to compare with: a compensated table, an EKF of SOC alone.

Both see the model's OCV and resistances at the temperature, and nothing else of it.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import NamedTuple

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.estimate.estimators import FilterOutput
from cellwise.estimate.noise import noise_for

SHORTEST_S = 1e-3  # of a step: the first has none
NEAR_K = 1.0  # a table is taken again where the temperature has moved by so much


class GaugePoint(NamedTuple):
    """The tables at a SOC: OCV and its slope over SOC [V], its stated error [V], resistances.

    ``ohm`` is R0 with the branches', ``slow_ohm`` theirs alone; ``tau_s`` is the slow one's.
    """

    ocv_V: float
    slope_V: float
    error_V: float
    ohm: float
    slow_ohm: float
    tau_s: float


class _OcvAndResistance:
    """A model's OCV and resistances at the temperature of the sample."""

    def __init__(self, model: CellModel) -> None:
        self.model = model
        self.charge_As = 3600.0 * model.capacity_Ah
        self._follow(model.usual_temperature_C)

    def _follow(self, temperature_C: float) -> None:
        cell = self.model.at_temperature(temperature_C)
        slow = cell.r1_ohm[0] + cell.r2_ohm[0]
        error = self.model.slow_error_V(cell.soc, temperature_C)
        slope = np.gradient(cell.ocv_V[0], cell.soc)
        columns = (cell.ocv_V[0], slope, error, cell.r0_ohm[0] + slow, slow, cell.tau2_s[0])
        self.temperature_C = temperature_C
        self.ocv_V: list[float] = cell.ocv_V[0].tolist()
        self.rows: list[list[float]] = np.stack(columns, axis=1).tolist()

    def sensed(self, temperature_C: float) -> None:
        """Other tables where the temperature [degC] has moved; a missing one changes nothing."""
        if abs(temperature_C - self.temperature_C) > NEAR_K:
            self._follow(temperature_C)

    def at(self, soc: float) -> GaugePoint:
        """The tables at a SOC from 0 to 1, linear between points."""
        place = soc * (len(self.rows) - 1)
        k = min(int(place), len(self.rows) - 2)
        part = place - k
        pairs = zip(self.rows[k], self.rows[k + 1], strict=True)
        return GaugePoint(*(low + part * (high - low) for low, high in pairs))

    def soc_of(self, ocv_V: float) -> float:
        """The SOC from 0 to 1 of an OCV [V]."""
        k = min(max(bisect_right(self.ocv_V, ocv_V), 1), len(self.ocv_V) - 1)
        low, high = self.ocv_V[k - 1 : k + 1]
        return min(max((k - 1 + (ocv_V - low) / (high - low)) / (len(self.ocv_V) - 1), 0.0), 1.0)


class TableGauge(_OcvAndResistance):
    """SOC where the OCV table has the voltage with the drop of all resistances put back, smoothed.

    Piller, Perrin and Jossen 2001, section 2.3, doi:10.1016/S0378-7753(01)00560-2; the smoothing's
    time constant is the slow branch's. It states no deviation and does not count.
    """

    state_bytes = 8

    def start(self, soc0: float, soc0_std: float) -> None:
        """Begin at ``soc0``."""
        self.estimate = soc0

    def step(
        self, current_A: float, voltage_V: float, temperature_C: float, dt_s: float
    ) -> FilterOutput:
        """Take a sample; one without voltage or current leaves the estimate."""
        self.sensed(temperature_C)
        here = self.at(self.estimate)
        ocv_V = voltage_V + current_A * here.ohm
        if math.isfinite(ocv_V):
            new = 1.0 - math.exp(-dt_s / here.tau_s)
            self.estimate += new * (self.soc_of(ocv_V) - self.estimate)
        return FilterOutput(self.estimate)


class OneStateEkf(_OcvAndResistance):
    """An extended Kalman filter whose only state is SOC.

    The simple model of Plett 2004, part 2, y = OCV(z) - R i (doi:10.1016/j.jpowsour.2004.02.032),
    in the filter of part 3 (doi:10.1016/j.jpowsour.2004.02.033). What the branches would hold is an
    error of the voltage that lasts as long as the slow one: white noise of the same density at low
    frequency, of variance 2 sigma^2 tau / dt.
    """

    state_bytes = 16

    def __init__(self, model: CellModel) -> None:
        super().__init__(model)
        self.noise = noise_for(model, None)
        self.walk_per_sqrt_s = self.noise.soc_per_sqrt_h / 60.0

    def start(self, soc0: float, soc0_std: float) -> None:
        """Begin at ``soc0``, known to ``soc0_std``."""
        self.estimate, self.variance = soc0, soc0_std**2

    def step(
        self, current_A: float, voltage_V: float, temperature_C: float, dt_s: float
    ) -> FilterOutput:
        """Take a sample; over a gap the SOC stays and becomes less sure."""
        self.sensed(temperature_C)
        known = math.isfinite(current_A)
        current = current_A if known else 0.0
        self.variance += self.walk_per_sqrt_s**2 * dt_s + (0.0 if known else self.noise.gap_soc**2)
        soc = min(max(self.estimate - current * dt_s / self.charge_As, 0.0), 1.0)
        here = self.at(soc)
        expected = here.ocv_V - current * here.ohm
        density = 2.0 * here.tau_s / max(dt_s, SHORTEST_S)
        unknown = here.error_V**2 + (current * here.slow_ohm) ** 2
        white = self.noise.voltage_V**2 + density * unknown
        slope = here.slope_V
        innovation = slope**2 * self.variance + white
        if known and math.isfinite(voltage_V):
            gain = self.variance * slope / innovation
            soc = min(max(soc + gain * (voltage_V - expected), 0.0), 1.0)
            self.variance *= 1.0 - gain * slope
        self.estimate = soc
        return FilterOutput(soc, math.sqrt(self.variance), expected, math.sqrt(innovation))
