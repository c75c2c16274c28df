"""A pack read as one cell, or one cell read as a pack."""

from __future__ import annotations

import math

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.logs.measured_log import MeasuredLog

# No cell's median voltage is this far above its full one, or this small a share of its empty one,
# whatever the load and temperature.
ABOVE_FULL_V = 1.0
SHARE_OF_EMPTY = 0.65
EMPTY_SOC = 0.05
OVERCHARGED_V = 0.15
FULL_V = 4.2
FULL_LFP_V = 3.65
LARGEST_CELL_V = 6.0
MILLIVOLT_FROM = 1000.0


def check_cells_in_series(model: CellModel, log: MeasuredLog) -> None:
    """Refuse a log whose voltage is no single cell's of the model's kind.

    Raises
    ------
    InputError        names the voltages and the number of cells in series that would fit
    """
    typical = log.typical_voltage_V
    full = float(np.max(model.ocv_V))
    empty = float(np.min([np.interp(EMPTY_SOC, model.soc, row) for row in model.ocv_V]))
    if SHARE_OF_EMPTY * empty <= typical <= full + ABOVE_FULL_V:
        return
    expected = f"the voltage of one cell, {np.min(model.ocv_V):.2f} to {full:.2f} V by the model"
    if typical > full:
        raise InputError(
            f"a voltage of typically {typical:.4g} V in log '{log.name}'",
            expected,
            _question(log, full),
        )
    raise InputError(
        f"a voltage of typically {typical:.3g} V in log '{log.name}'",
        expected,
        "Fewer cells in series? Correct `series=...`; or it is another kind of cell.",
    )


def check_one_cell(log: MeasuredLog) -> None:
    """Refuse a log whose voltage is above that of any cell.

    Raises
    ------
    InputError        names the voltage and the number of cells in series that would fit
    """
    typical = log.typical_voltage_V
    if typical > LARGEST_CELL_V:
        raise InputError(
            f"a voltage of typically {typical:.4g} V in log '{log.name}'",
            f"the voltage of one cell, at most {LARGEST_CELL_V:g} V",
            _question(log, FULL_V),
        )


def cells_in_series(log: MeasuredLog, full_V: float) -> int:
    """The fewest cells of which none is above full at the log's highest voltage."""
    return math.ceil(float(np.nanmax(log.voltage_V)) / (full_V + OVERCHARGED_V))


def _question(log: MeasuredLog, full_V: float) -> str:
    if log.typical_voltage_V > MILLIVOLT_FROM:
        return "Millivolts? Name the column voltage_mV."
    cells = cells_in_series(log, full_V)
    others = cells_in_series(log, FULL_LFP_V)
    also = f" (LFP: {others})" if full_V == FULL_V and others != cells else ""
    return f"{cells} cells in series{also}? Give `series={cells}`."
