"""Rows that somebody has put before a log: they stand still, and are no rest of a cell.

A cell's voltage relaxes while it rests, and answers the first current by its ohmic drop.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.logs.cell_log import CellLog

PADDED_S = 120.0  # for so long a voltage stands before it is looked at
SHOWN_V = 0.01  # a current is asked once its ohmic drop is more than any gauge's last digit
ANSWER = 0.3  # of the least drop: less is no answer


class StillRows(NamedTuple):
    """The rows so far: of the first ``current_A`` and ``voltage_V``, still for ``still_s`` seconds.

    ``still_s`` is negative where it is known what they are; ``step_A`` is the current's first step
    that the voltage has not answered, else 0; ``padded``: all rows before it were put there.
    """

    current_A: float
    voltage_V: float
    still_s: float
    step_A: float
    padded: bool


def still_rows_step(
    x: StillRows, current_A: float, voltage_V: float, dt_s: float, r0_ohm: float
) -> StillRows:
    """One more row behind the first; ``r0_ohm`` is the least ohmic resistance.

    A voltage that is logged one row late answers in the next: of that row the drop by the first
    current (a cell) and by the change of current since (rows before a log) are distinguished.
    """
    moved_A = current_A - x.current_A
    moved_V = voltage_V - x.voltage_V
    still_s = x.still_s
    step_A = x.step_A
    padded = x.padded
    if still_s >= 0.0 and step_A != 0.0:
        late_V = abs(moved_V + r0_ohm * step_A)
        padded = abs(moved_V + r0_ohm * (moved_A - step_A)) < late_V
        still_s = -1.0
    elif still_s >= 0.0:
        if r0_ohm * abs(moved_A) < SHOWN_V:
            still_s = still_s + dt_s if moved_V == 0.0 else -1.0
        elif still_s >= PADDED_S and abs(moved_V) < ANSWER * r0_ohm * abs(moved_A):
            step_A = moved_A
        else:
            still_s = -1.0
    return StillRows(x.current_A, x.voltage_V, still_s, step_A, padded)


def padded_rows(model: CellModel, log: CellLog) -> int:
    """How many rows at a log's start are no measurement: 0 where none is known to be."""
    current, voltage = log.known_current_A(), log.voltage_V
    least_ohm = float(np.min(model.r0_ohm))
    x = StillRows(float(current[0]), float(voltage[0]), 0.0, 0.0, False)
    for k in range(1, len(log)):
        x = still_rows_step(
            x, float(current[k]), float(voltage[k]), float(log.interval_s[k]), least_ohm
        )
        if x.still_s < 0.0:
            return k - 1 if x.padded else 0
    return 0
