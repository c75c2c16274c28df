"""A coulomb counter with full reset, as many packs have it: no voltage is used below full."""

import math

FULL_RATE = 0.05  # of 1C: a charge that has tapered to this at the full voltage is full


class Row:
    """Counts; full where a charge at the full voltage has tapered."""

    state_bytes = 8

    def __init__(self, cell, fitted):
        self.capacity_Ah = cell.capacity_Ah
        self.full_V = float(cell.at(cell.temperature_C)["ocv_V"][-1])

    def start(self, soc0, soc0_std):
        self.soc = soc0

    def step(self, current_A, voltage_V, temperature_C, dt_s):
        self.soc -= current_A * dt_s / (3600.0 * self.capacity_Ah)
        tapered = -FULL_RATE * self.capacity_Ah <= current_A <= 0.0
        if tapered and voltage_V >= self.full_V:
            self.soc = 1.0
        self.soc = min(max(self.soc, 0.0), 1.0)
        return self.soc, math.nan, math.nan
