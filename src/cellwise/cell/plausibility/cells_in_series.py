"""A pack read as one cell, or one cell read as a pack."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.logs.measured_log import MeasuredLog

# No cell's median voltage is this far above its full one, or this small a share of its empty one,
# whatever the load and temperature.


class OneCell(NamedTuple):
    """Between which voltages the median of a single cell lies, whatever load and temperature."""

    above_full_V: float = 1.0
    share_of_empty: float = 0.65  # of the OCV at empty_soc
    empty_soc: float = 0.05
    overcharged_V: float = 0.15  # above full that a cell in a pack may be
    full_V: float = 4.2
    full_lfp_V: float = 3.65
    largest_V: float = 6.0  # of any chemistry
    millivolt_from: float = 1000.0  # a number like this is no voltage of a pack


ONE_CELL = OneCell()


def check_cells_in_series(model: CellModel, log: MeasuredLog) -> None:
    """Refuse a log whose voltage is no single cell's of the model's kind.

    Raises
    ------
    InputError        names the voltages and the number of cells in series that would fit
    """
    typical = log.typical_voltage_V
    full = float(np.max(model.ocv_V))
    empty = float(np.min([np.interp(ONE_CELL.empty_soc, model.soc, row) for row in model.ocv_V]))
    if ONE_CELL.share_of_empty * empty <= typical <= full + ONE_CELL.above_full_V:
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
    if typical > ONE_CELL.largest_V:
        raise InputError(
            f"a voltage of typically {typical:.4g} V in log '{log.name}'",
            f"the voltage of one cell, at most {ONE_CELL.largest_V:g} V",
            _question(log, ONE_CELL.full_V),
        )


def cells_in_series(log: MeasuredLog, full_V: float) -> int:
    """The fewest cells of which none is above full at the log's highest voltage."""
    return math.ceil(float(np.nanmax(log.voltage_V)) / (full_V + ONE_CELL.overcharged_V))


def _question(log: MeasuredLog, full_V: float) -> str:
    if log.typical_voltage_V > ONE_CELL.millivolt_from:
        return "Millivolts? Name the column voltage_mV."
    cells = cells_in_series(log, full_V)
    others = cells_in_series(log, ONE_CELL.full_lfp_V)
    also = f" (LFP: {others})" if full_V == ONE_CELL.full_V and others != cells else ""
    return f"{cells} cells in series{also}? Give `series={cells}`."
