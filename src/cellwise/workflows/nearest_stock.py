"""Which stock model a log is nearest to, where it is far off another one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import NO_MODEL_V, times_stated
from cellwise.cell.simulate import simulate
from cellwise.cell.stock import named_model, stock_names
from cellwise.logs.cell_log import CellLog


class StockDistance(NamedTuple):
    """A stock model scaled to a capacity, and how far a log simulated with it is off."""

    name: str
    capacity_Ah: float
    typical_V: float


def nearest_stock(model: CellModel, log: CellLog) -> StockDistance | None:
    """The stock model that a log is nearest to; None: none is near, or ``model`` is no stock model.

    Each is scaled to the capacity that was stated, else to the model's own, and at least to the
    charge that the log moves. Near is half of the rows within what the model states of itself, if
    that says a SOC.
    """
    if not model.is_stock:
        return None
    moved_Ah = float(np.ptp(log.counted_charge_Ah()))
    found = []
    for name in stock_names():
        scaled = named_model(name, max(model.capacity_Ah, moved_Ah))
        simulated = simulate(scaled, log, initial_soc(scaled, log).soc)
        times, typical_V = times_stated(scaled, log, simulated.residual_V, simulated.soc)
        if times <= 1.0 and typical_V < NO_MODEL_V:
            found.append(StockDistance(name, scaled.capacity_Ah, typical_V))
    return min(found, key=lambda one: one.typical_V, default=None)
