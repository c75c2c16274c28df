"""Is the current in amperes? By the charge that it moves, beside what the cell holds."""

from __future__ import annotations

import math

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.faults import possible_part
from cellwise.typing import FloatArray

# Of the capacity: half-way, in logarithm, between a whole discharge and the same in milliamperes.
# It is beyond a dozen discharges whose recharges nobody logged.
MOST_MOVED = math.sqrt(1000.0)
# Parts of equal length, and how many of them a sensor that fails for a while may reach into.
PARTS, PARTS_OF_FAULT = 10, 3


def check_current(log: CellLog, capacity_Ah: float) -> None:
    """Refuse a current that no cell of this capacity can have given: it is in another unit.

    It is one that moves more than ``MOST_MOVED`` times the capacity one way, and that at more than
    1C from the log's first row to its last: the offset of a sensor, which adds up to any charge
    over months, is far below. A sensor that fails for a part of the log is no other unit.

    Parameters
    ----------
    log : CellLog
    capacity_Ah : float    of the model that the log is given to

    Raises
    ------
    InputError        with the line that converts it
    """
    hours = log.duration_s / 3600.0
    most_Ah = capacity_Ah * max(MOST_MOVED, hours)
    if float(np.sum(np.abs(_steps_Ah(log)))) <= most_Ah:
        return
    moved_Ah = _surely_moved_Ah(possible_part(log))
    if moved_Ah > most_Ah:
        raise InputError(
            f"a current that moves {moved_Ah / capacity_Ah:.0f} times the model's capacity of "
            f"{capacity_Ah:g} Ah within {hours:.2g} h in log '{log.name}'",
            "amperes, and the log of a cell of this size",
            "Of cells in parallel, divide the current by their number. Milliamperes? A column of "
            "a file is then named current_mA. Write "
            "dataclasses.replace(log, current_A=log.current_A / 1000).",
        )


def _surely_moved_Ah(log: CellLog) -> float:
    """Charge moved one way within the parts of the log, those that move most left out."""
    counted = np.cumsum(_steps_Ah(log))
    ends = np.searchsorted(log.time_s, np.linspace(log.time_s[0], log.time_s[-1], PARTS + 1)[1:-1])
    moved = sorted(float(np.ptp(part)) for part in np.split(counted, ends) if part.size)
    return sum(moved[:-PARTS_OF_FAULT])


def _steps_Ah(log: CellLog) -> FloatArray:
    """What the current moves in the interval of each row; nothing over gaps, (n,)."""
    current = np.nan_to_num(log.interval_current_A)
    steps: FloatArray = np.where(log.gap_rows, 0.0, current * log.interval_s) / 3600.0
    return steps
