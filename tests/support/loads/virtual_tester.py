"""The virtual tester: a log of a cell that a model describes, under any current.

Every made log whose truth is a model is run by it; a cell that no model of the package describes,
and whose equations are summed apart from its kernels, is in `synthetic` and `rich_cell`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.logs.cell_log import CellLog

BLANK_V = 3.7  # where nothing was measured yet


def planned(current_A, *, dt_s: float = 1.0, temperature_C=None, counter: bool = False) -> CellLog:
    """A current at an even step, before its voltage is measured; a temperature, or each row's."""
    current = np.asarray(current_A, dtype=np.float64)
    rows = current.size
    warm = None if temperature_C is None else np.broadcast_to(temperature_C, rows).astype(float)
    charge = np.cumsum(current) * dt_s / 3600.0 if counter else None
    return CellLog(dt_s * np.arange(rows), current, np.full(rows, BLANK_V), warm, charge)


def logged(cell: CellModel, log: CellLog, soc0: float, noise_V=0.0) -> CellLog:
    """The log with the voltage of a cell that begins at ``soc0``, and the sensor's noise."""
    return replace(log, voltage_V=simulate(cell, log, soc0).voltage_V + noise_V)
