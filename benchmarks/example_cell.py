"""The cell and the load that every simulator and filter is timed on."""

from __future__ import annotations

import numpy as np

from cellwise.cell.effects import SlowDiffusion
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.logs import CellLog

SAMPLES = 36_000
START_SOC = 0.95
NOISE_V = 1e-3


def two_branches() -> CellModel:
    """A 3 Ah cell, tables of 201 points that change with SOC."""
    soc = np.linspace(0.0, 1.0, 201)
    return CellModel(
        capacity_Ah=3.0,
        ocv_V=3.45 + 0.62 * soc + 0.09 * soc**6 - 0.75 * np.exp(-24.0 * soc),
        r0_ohm=0.030 + 0.012 * np.exp(-9.0 * soc),
        r1_ohm=0.014 + 0.020 * np.exp(-8.0 * soc),
        tau1_s=3.0 + 2.0 * soc,
        r2_ohm=0.022 + 0.030 * np.exp(-7.0 * soc),
        tau2_s=45.0 + 30.0 * soc,
    )


def three_branches() -> CellModel:
    """The same with the slow branch, as identification gives it."""
    return two_branches().with_effect(SlowDiffusion(r3_ohm=0.02, tau3_s=1500.0))


def load_log(samples: int = SAMPLES, seed: int = 0) -> CellLog:
    """A load at 1 Hz that changes every second as driving does; its voltage is the model's.

    It takes the cell from 95 % to about 15 % in ten hours.
    """
    rng = np.random.default_rng(seed)
    current = np.empty(SAMPLES)
    value = 0.0
    for k, push in enumerate(rng.standard_normal(SAMPLES)):
        value = 0.9 * value + push
        current[k] = 0.24 + 0.6 * value
    time_s = np.arange(SAMPLES, dtype=np.float64)
    blank = CellLog(time_s, current, np.full(SAMPLES, 3.7), name="load")
    voltage = simulate(three_branches(), blank, START_SOC).voltage_V
    whole = CellLog(time_s, current, voltage + NOISE_V * rng.standard_normal(SAMPLES), name="load")
    return whole.part(0, samples)
