"""The SOC of a rested cell from its voltage, through the OCV."""

from __future__ import annotations

import math

import numpy as np

from cellwise.cell.effects import Hysteresis, SlowDiffusion
from cellwise.cell.initial_soc.unseen_past import Branches, Rested, rested_ocv, usual_load
from cellwise.cell.model import CellModel
from cellwise.typing import FloatArray

REST_RATE = 0.01  # below C/100 a cell counts as resting
SHORT_REST_V = 0.010  # what may be left of an unknown past when the rest seen is short
RELAXED_S = 1800.0
EVERY_SOC = np.linspace(0.0, 1.0, 2001)


def rest_ocv(
    model: CellModel,
    time_s: FloatArray,
    voltage_V: FloatArray,
    temperature_C: float,
    load: tuple[FloatArray, FloatArray],
) -> Rested:
    """The OCV under a rest whose past nobody saw, by the branches of the model.

    Parameters
    ----------
    time_s, voltage_V : (n,) float      of the rest, from its first row
    load : (interval_s, current_A)      rows of a use of the cell, (m,) each; there may be none
    """
    cell = model.at_temperature(temperature_C)
    slow = cell.effect(SlowDiffusion)
    pairs = ((cell.r1_ohm, cell.tau1_s), (cell.r2_ohm, cell.tau2_s), (slow.r3_ohm, slow.tau3_s))
    r, tau = np.array([(np.median(a), np.median(b)) for a, b in pairs]).T
    usual = usual_load(*load, tau, model.capacity_Ah)
    return rested_ocv(time_s, voltage_V, model.error.white_V, Branches(r, tau), usual)


def soc_of_ocv(
    model: CellModel, voltage_V: float, std_V: float, temperature_C: float
) -> tuple[float, float]:
    """SOC at which the OCV is a given voltage, and its standard deviation.

    On a flat OCV every SOC within ``std_V`` is as good: the mean and the spread of all of them.
    """
    soc = EVERY_SOC
    likely = ln_likelihood_of_ocv(model, soc, voltage_V, std_V, temperature_C)
    weight = np.exp(likely - likely.max())
    weight /= weight.sum()
    mean = float((soc * weight).sum())
    std = math.sqrt(float(((soc - mean) ** 2 * weight).sum()))
    ocv = np.interp(soc, model.soc, model.ocv_at(temperature_C))
    best = float(soc[int(np.argmin(np.abs(ocv - voltage_V)))])
    return (best, std) if abs(best - mean) < std else (mean, std)


def ln_likelihood_of_ocv(
    model: CellModel, soc: FloatArray, voltage_V: float, std_V: float, temperature_C: float
) -> FloatArray:
    """Ln likelihood of every SOC, given the voltage of a rested cell.

    Parameters
    ----------
    soc : (n,) float
    std_V : float       of what remains of the past; the model's own error is added [V]
    """
    table = model.ocv_at(temperature_C)
    gap = np.broadcast_to(np.abs(model.effect_at(Hysteresis, temperature_C).m_V), (1, table.size))
    ocv = np.interp(soc, model.soc, table)
    known = np.hypot(std_V, model.slow_error_V(soc, temperature_C))
    spread = np.hypot(known, np.interp(soc, model.soc, gap[0]))
    # Beyond the table's ends the nearest end is the answer, not an unlikely one.
    target = min(max(voltage_V, float(table[0])), float(table[-1]))
    # A density: where the model claims little, a voltage says little for the SOC, too.
    return np.asarray(-0.5 * ((ocv - target) / spread) ** 2 - np.log(spread))
