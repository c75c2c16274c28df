"""What a string of cells can give, as its weakest cells allow, and what balancing would bring."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.logs.cell_log import CellLog
from cellwise.pack.differences import OcvSlope
from cellwise.typing import FloatArray

POINTS = 101


@dataclass(frozen=True)
class Usable:
    """Charge and energy of a pack between its first full and its first empty cell.

    ``usable_Ah`` as the cells are; ``balanced_Ah`` when all are full together, so that the smallest
    cell alone decides; ``left_Ah`` until the first cell is empty; ``energy_Wh`` of ``usable_Ah``
    at open circuit.
    """

    usable_Ah: float
    balanced_Ah: float
    left_Ah: float
    usable_Wh: float

    @property
    def gain_Ah(self) -> float:
        """What balancing would bring; rounding is none."""
        return round(self.balanced_Ah - self.usable_Ah, 9)

    def to_dict(self) -> dict[str, float]:
        """JSON values, with what balancing would bring."""
        return {
            "usable_Ah": self.usable_Ah,
            "usable_Wh": self.usable_Wh,
            "left_Ah": self.left_Ah,
            "balanced_Ah": self.balanced_Ah,
            "balancing_gain_Ah": self.gain_Ah,
        }


def usable_charge(
    model: CellModel, log: CellLog, soc: FloatArray, capacity_Ah: FloatArray, parallel: int = 1
) -> Usable:
    """What cells in series give, from SOC and capacity of each, shape (cells,); NaN: unknown.

    ``parallel`` such strings give so many times as much.
    """
    capacity_Ah = parallel * capacity_Ah
    known = np.isfinite(soc) & np.isfinite(capacity_Ah)
    if not known.any():
        return Usable(np.nan, np.nan, np.nan, np.nan)
    z, q = soc[known], capacity_Ah[known]
    left = float(np.min(z * q))
    room = float(np.min((1.0 - z) * q))
    usable = left + room
    ocv = OcvSlope(model, log)
    moved = np.linspace(room, -left, POINTS)  # charge put in, from the pack's full to its empty
    volts = ocv.ocv_V(np.clip(z + moved[:, None] / q, 0.0, 1.0)).sum(axis=1)
    volts *= soc.size / z.size  # cells without a sensor are there all the same
    return Usable(usable, float(np.min(q)), left, usable * float(np.mean(volts)))
