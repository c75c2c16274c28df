"""What a cell still holds where a load ends at its lower voltage limit.

Near empty a prior of another kind knows neither where the OCV falls nor what the resistances become
there, and one voltage cannot tell the two from a larger capacity. But empty is where the user's own
limit is: what a load leaves follows from how far it holds the voltage below the OCV.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellwise.logs.cell_log import CellLog


class LeftAtLimit(NamedTuple):
    """SOC that is left where a load ends, by how far the OCV is then above the limit.

    Parameters
    ----------
    always : float          left after any load of more than a low rate
    per_V2 : float          SOC over the square of that voltage. Measured at C/10 and less,
                            and of physics models, eight cells have 0.01 to 0.02 at 0.3 V, 0.015 to
                            0.055 at 0.5 V and 0.035 to 0.16 at 0.7 V, whatever their limit
    relative, least : float     standard deviation, of the part by that voltage and at least. After
                            1C at 25 degC eight cells have 0.00 to 0.07, half of them 0.02 to 0.03
    middle : float          SOC where the same load shows its voltage drop undisturbed by the end
    growth : float          the drop near empty over that in the middle
    near_V : float          rows this near a log's lowest voltage are its end
    above_V : float         a lowest voltage further above the limit is none: the load just ended
    """

    always: float = 0.01
    per_V2: float = 0.15
    relative: float = 0.5
    least: float = 0.006
    middle: float = 0.35
    growth: float = 2.0
    near_V: float = 0.1
    above_V: float = 0.35


LEFT = LeftAtLimit()


class EmptyEnd(NamedTuple):
    """The emptiest row at the limit, the charge until there, and its voltage above the limit."""

    log: int
    row: int
    charge_Ah: float
    above_V: float


def empty_ends(logs: Sequence[CellLog], limit_V: float) -> list[EmptyEnd]:
    """Where logs end at the lower limit: the lowest voltage of all, if it is near ``limit_V``."""
    lowest = [float(np.nanmin(log.voltage_V)) for log in logs]
    used_V = min(lowest)
    found = []
    for k, (log, low_V) in enumerate(zip(logs, lowest, strict=True)):
        if low_V <= limit_V + LEFT.above_V:
            charge = log.counted_charge_Ah()
            near = np.flatnonzero(log.voltage_V <= low_V + LEFT.near_V)
            row = int(near[np.argmax(charge[near])])
            found.append(EmptyEnd(k, row, float(charge[row]), low_V - used_V))
    return found


def left_at(end: EmptyEnd, drop_V: float) -> tuple[float, float]:
    """SOC at an end and its standard deviation, by the load's voltage drop in the middle [V]."""
    above_V = max(end.above_V + LEFT.growth * drop_V, 0.0)
    left = LEFT.always + LEFT.per_V2 * above_V**2
    return left, LEFT.relative * (left - LEFT.always) + LEFT.least
