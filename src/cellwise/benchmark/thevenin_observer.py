"""Another package's model in the benchmark: thevenin's ``Prediction``, its voltage error fed back.

The example of an adapter. `thevenin <https://pypi.org/project/thevenin/>`_ advances the states; an
observer of fixed gain gives the SOC what the OCV's slope makes of the voltage error, slowly.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import thevenin

from cellwise.benchmark.adapter import FilterOutput
from cellwise.cell.model import CellModel
from cellwise.typing import FloatArray

ROOM_K = 298.15
SLOW_S = 120.0
SHORTEST_S = 1e-3
FLATTEST_V = 0.2  # on a plateau a voltage error says little of the SOC


class TheveninObserver:
    """thevenin's step interface under an observer; both branches and R0 from a CellModel."""

    state_bytes = 5 * 8

    def __init__(self, model: CellModel) -> None:
        self.grid, self.ocv = model.soc, model.at_temperature(ROOM_K - 273.15).ocv_V[0]
        self.cell = thevenin.Prediction(parameters(model.at_temperature(ROOM_K - 273.15)))
        self.start(0.5, 0.15)

    def start(self, soc0: float, soc0_std: float) -> None:
        """A cell at rest."""
        self.state = thevenin.TransientState(soc0, ROOM_K, 0.0, np.zeros(2))
        self.held_A = 0.0

    def step(
        self, current_A: float, voltage_V: float, temperature_C: float, dt_s: float
    ) -> FilterOutput:
        """Their prediction, then a share of its error."""
        self.held_A = current_A if math.isfinite(current_A) else self.held_A
        self.state = self.cell.take_step(self.state, self.held_A, max(dt_s, SHORTEST_S))
        predicted = float(self.state.voltage)
        if math.isfinite(voltage_V):
            soc = float(np.clip(self.state.soc, 0.0, 1.0))
            ends = np.interp(np.clip([soc - 0.01, soc + 0.01], 0.0, 1.0), self.grid, self.ocv)
            slope = max(float(ends[1] - ends[0]) / 0.02, FLATTEST_V)
            share = 1.0 - math.exp(-dt_s / SLOW_S)
            self.state.soc = float(np.clip(soc + share * (voltage_V - predicted) / slope, 0.0, 1.0))
        return FilterOutput(self.state.soc, voltage_V=predicted)


def parameters(model: CellModel) -> dict[str, object]:
    """A model of one temperature as thevenin takes it."""

    def over_soc(values: FloatArray) -> Callable[..., float]:
        return lambda soc, *_: np.interp(soc, model.soc, values)

    return {
        "num_RC_pairs": 2, "soc0": 0.5, "capacity": model.capacity_Ah, "ce": 1.0, "gamma": 0.0,
        "mass": 0.05, "isothermal": True, "Cp": 1000.0, "T_inf": ROOM_K, "h_therm": 10.0,
        "A_therm": 0.01, "ocv": over_soc(model.ocv_V[0]), "M_hyst": over_soc(0.0 * model.soc),
        "R0": over_soc(model.r0_ohm[0]), "R1": over_soc(model.r1_ohm[0]),
        "C1": over_soc(model.c1_F[0]), "R2": over_soc(model.r2_ohm[0]),
        "C2": over_soc(model.c2_F[0]),
    }  # fmt: skip
