"""The gauge that most firmware has: counting, a voltage table at rest, a slow pull under load.

The table is the measured OCV of the cell's temperature, the resistance that of the pulse test; no
state but the SOC and the time at rest.
"""

import math

import numpy as np

REST_RATE, REST_S = 0.02, 300.0  # of 1C; below it for so long the voltage is taken as the OCV
PULL_S = 1800.0  # under load the compensated voltage is followed with this time constant


class Row:
    """SOC by counting, put right by a table of voltages."""

    state_bytes = 16

    def __init__(self, cell, fitted):
        self.cell = cell

    def start(self, soc0, soc0_std):
        self.soc, self.rested_s, self.tables, self.known_C = soc0, 0.0, None, math.nan

    def step(self, current_A, voltage_V, temperature_C, dt_s):
        cell = self.cell
        if not abs(temperature_C - self.known_C) < 1.0:
            self.known_C, self.tables = temperature_C, cell.at(temperature_C)
        self.soc -= current_A * dt_s / (3600.0 * cell.capacity_Ah)
        resting = abs(current_A) < REST_RATE * cell.capacity_Ah
        self.rested_s = self.rested_s + dt_s if resting else 0.0
        if voltage_V == voltage_V:
            table = self.tables
            ohm = sum(np.interp(self.soc, cell.soc, table[n]) for n in ("r0_ohm", "r1_ohm"))
            looked_up = np.interp(voltage_V + current_A * ohm, table["ocv_V"], cell.soc)
            pull = 1.0 if self.rested_s >= REST_S else 1.0 - math.exp(-dt_s / PULL_S)
            self.soc += pull * (float(looked_up) - self.soc)
        self.soc = min(max(self.soc, 0.0), 1.0)
        return self.soc, math.nan, math.nan
