"""The SOC of a rested cell from its voltage, through the OCV."""

from __future__ import annotations

import math

import numpy as np

from cellwise.cell.effects import Hysteresis
from cellwise.cell.model import CellModel

REST_RATE = 0.01  # below C/100 a cell counts as resting
SHORT_REST_V = 0.010  # what may be left of an unknown past when the rest seen is short
RELAXED_S = 1800.0
EVERY_SOC = np.linspace(0.0, 1.0, 2001)


def soc_of_ocv(
    model: CellModel, voltage_V: float, std_V: float, temperature_C: float
) -> tuple[float, float]:
    """SOC at which the OCV is a given voltage, and its standard deviation.

    On a flat OCV every SOC within ``std_V`` is as good: the mean and the spread of all of them.
    """
    soc, table = EVERY_SOC, model.ocv_at(temperature_C)
    gap = np.abs(model.effect_at(Hysteresis, temperature_C).m_V)
    ocv = np.interp(soc, model.soc, table)
    known = np.hypot(std_V, model.slow_error_V(soc, temperature_C))
    spread = np.hypot(known, np.interp(soc, model.soc, np.broadcast_to(gap, (1, table.size))[0]))
    # Beyond the table's ends the nearest end is the answer, not an unlikely one.
    target = min(max(voltage_V, float(ocv[0])), float(ocv[-1]))
    # A density: where the model claims little, a voltage says little for the SOC, too.
    weight = np.exp(-0.5 * ((ocv - target) / spread) ** 2) / spread
    total = weight.sum()
    mean = float((soc * weight).sum() / total)
    std = math.sqrt(float(((soc - mean) ** 2 * weight).sum() / total))
    best = float(soc[int(np.argmin(np.abs(ocv - target)))])
    return (best, std) if abs(best - mean) < std else (mean, std)
