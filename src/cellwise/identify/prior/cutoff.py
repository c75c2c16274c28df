"""What a cell still holds where a load ends at its lower voltage limit.

Near empty a prior of another kind knows neither where the OCV falls nor what the resistances become
there, and one voltage cannot separate the two from a larger capacity. But empty is where the user's
own limit is: what a load leaves follows from how far it holds the voltage below the OCV.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray


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
    fall_V : float          a load in the middle of the range is this much above one at the limit;
                            with less of a fall the log just ended
    """

    always: float = 0.01
    per_V2: float = 0.15
    relative: float = 0.5
    least: float = 0.02
    middle: float = 0.35
    growth: float = 2.0
    near_V: float = 0.1
    fall_V: float = 0.3


LEFT = LeftAtLimit()


class LowestRow(NamedTuple):
    """The emptiest row near a log's lowest voltage, the charge until there, and that voltage."""

    row: int
    charge_Ah: float
    voltage_V: float


def lowest_row(log: CellLog) -> LowestRow:
    """Where a log would end empty, if it does."""
    low_V = float(np.nanmin(log.voltage_V))
    charge = log.counted_charge_Ah()
    near = np.flatnonzero(log.voltage_V <= low_V + LEFT.near_V)
    row = int(near[np.argmax(charge[near])])
    return LowestRow(row, float(charge[row]), low_V)


def left_at(
    lowest_V: FloatArray, middle_V: FloatArray, drop_V: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """SOC at the lowest rows of logs and its standard deviation, infinite where none is empty.

    Parameters
    ----------
    lowest_V : (logs,) array    the logs' lowest voltages [V]
    middle_V, drop_V : (logs,) array    voltage of the same loads at ``middle``, and what they take
                                        off the OCV there [V]
    """
    empty = lowest_V < middle_V - LEFT.fall_V
    limit_V = np.min(lowest_V, where=empty, initial=np.inf)
    above_V = np.where(empty, lowest_V - limit_V, 0.0) + LEFT.growth * np.maximum(drop_V, 0.0)
    part = LEFT.per_V2 * above_V**2
    return LEFT.always + part, np.where(empty, LEFT.relative * part + LEFT.least, np.inf)
