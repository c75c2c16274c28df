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
LOADED_ROWS = 3.0  # behind a step without an answer, that say what they answer


class StillRows(NamedTuple):
    """The rows so far: of the first ``current_A`` and ``voltage_V``, still for ``still_s`` seconds.

    ``still_s`` is negative where it is known what they are; ``step_A`` is the current's first step
    that the voltage has not answered, else 0; ``padded``: all rows before it were put there. Of the
    rows behind the step: how many, the last current, and sums of squared currents and of currents
    times the drop, of a voltage that is one row late and of one that began there.
    """

    current_A: float
    voltage_V: float
    still_s: float
    step_A: float
    padded: bool
    rows: float
    last_A: float
    late_A2: float
    late_W: float
    begun_A2: float
    begun_W: float


def still_rows_step(
    x: StillRows, current_A: float, voltage_V: float, dt_s: float, r0_ohm: float
) -> StillRows:
    """One more row behind the first; ``r0_ohm`` is the least ohmic resistance.

    A voltage that is logged one row late answers in the next. So the rows behind the step are
    asked whether their drop is one by the current of the row before (a cell), or by the change of
    current since (rows before a log), each with the resistance that fits it best.
    """
    moved_A = current_A - x.current_A
    moved_V = voltage_V - x.voltage_V
    still_s = x.still_s
    step_A = x.step_A
    padded = x.padded
    rows = x.rows
    late_A2 = x.late_A2
    late_W = x.late_W
    begun_A2 = x.begun_A2
    begun_W = x.begun_W
    if still_s >= 0.0 and step_A != 0.0:
        late_A = x.last_A - x.current_A
        rows = rows + 1.0
        late_A2 = late_A2 + late_A * late_A
        late_W = late_W - late_A * moved_V
        begun_A2 = begun_A2 + (moved_A - step_A) * (moved_A - step_A)
        begun_W = begun_W - (moved_A - step_A) * moved_V
        if rows >= LOADED_ROWS:
            late_V2 = explained_V2(late_A2, late_W, r0_ohm)
            padded = explained_V2(begun_A2, begun_W, r0_ohm) > late_V2
            still_s = -1.0
    elif still_s >= 0.0:
        if r0_ohm * abs(moved_A) < SHOWN_V:
            still_s = still_s + dt_s if moved_V == 0.0 else -1.0
        elif still_s >= PADDED_S and abs(moved_V) < ANSWER * r0_ohm * abs(moved_A):
            step_A = moved_A
        else:
            still_s = -1.0
    return StillRows(
        x.current_A, x.voltage_V, still_s, step_A, padded, rows, current_A, late_A2, late_W,
        begun_A2, begun_W,
    )  # fmt: skip


def explained_V2(square_A2: float, drop_W: float, r0_ohm: float) -> float:
    """What a drop by these currents takes off the squared voltages, by ``r0_ohm`` at least."""
    ohm = r0_ohm
    if drop_W > r0_ohm * square_A2:
        ohm = drop_W / square_A2
    return 2.0 * ohm * drop_W - ohm * ohm * square_A2


def still_rows(current_A: float, voltage_V: float) -> StillRows:
    """The first row."""
    return StillRows(current_A, voltage_V, 0.0, 0.0, False, 0.0, current_A, 0.0, 0.0, 0.0, 0.0)


def padded_rows(model: CellModel, log: CellLog) -> int:
    """How many rows at a log's start are no measurement: 0 where none is known to be."""
    current, voltage = log.known_current_A(), log.voltage_V
    least_ohm = float(np.min(model.r0_ohm))
    x = still_rows(float(current[0]), float(voltage[0]))
    for k in range(1, len(log)):
        x = still_rows_step(
            x, float(current[k]), float(voltage[k]), float(log.interval_s[k]), least_ohm
        )
        if x.still_s < 0.0:
            return k - int(LOADED_ROWS) if x.padded else 0
    return 0
