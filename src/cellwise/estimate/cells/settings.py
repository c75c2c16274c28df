"""How far cells of one pack usually differ, and what their sensors add: for the fixed step."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.errors import InputError

MOST_CELLS = 1000
MONTH_S = 30.0 * 86_400.0
# Rejected voltages until a cell's SOC is taken for unknown.
FEWEST_TURNS, RECOVERY_S = 10, 60.0
# An error of a cell's voltage lasts for much longer than a sample: a cell is looked at every so
# often, and the others in between.
EVERY_S, MOST_TURNS = 30.0, 32


@dataclass(frozen=True)
class CellSettings:
    """Differences of cells from the mean cell, one standard deviation each.

    ``soc``, ``capacity``, ``resistance`` (relative) at the start, their change ``*_month`` in
    thirty days, ``sensor_V`` that two cells' sensors differ by for good, ``lag_s`` that a cell is
    polled later than the others, ``memory_s`` for how long an error of a cell's voltage lasts.

    What is known of a pack that was never seen: three times what new cells of one batch differ by
    (capacity 1 %, resistance 3 %: Rumpf et al., J. Energy Storage 14 (2017) 224), since a weak cell
    is what is looked for, and SOC as it is without balancing. Cell monitors: 1 to 2 mV, polled
    within tenths of a second.
    """

    soc: float = 0.03
    capacity: float = 0.03
    resistance: float = 0.10
    soc_month: float = 0.002
    capacity_month: float = 0.001
    resistance_month: float = 0.002
    sensor_V: float = 0.0015
    lag_s: float = 0.10
    memory_s: float = 3600.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isinstance(value, (int, float)) and np.isfinite(value) and value > 0.0):
                raise InputError(
                    f"{field.name} = {value!r} for the cells of a pack",
                    "a number above zero",
                    "Leave it out for what is usual.",
                )


def turns_of(dt_s: float) -> int:
    """Samples in which every cell is looked at once."""
    return int(min(max(EVERY_S // dt_s, 1.0), MOST_TURNS))


def cell_constants(settings: CellSettings, model: CellModel, dt_s: float) -> dict[str, Any]:
    """What the fixed step reads of the settings, by the names of its layout."""

    def walk(month: float) -> float:
        return month**2 * dt_s / MONTH_S

    ocv = model.ocv_V[0]
    slope_V = float(np.interp(0.9, model.soc, ocv) - np.interp(0.1, model.soc, ocv)) / 0.8
    single_V2 = settings.sensor_V**2
    turns = turns_of(dt_s)
    return {
        "cell_soc2": settings.soc**2,
        "cell_capacity2": settings.capacity**2,
        "cell_resistance2": settings.resistance**2,
        "cell_soc_walk": walk(settings.soc_month),
        "cell_capacity_walk": walk(settings.capacity_month),
        "cell_resistance_walk": walk(settings.resistance_month),
        "cell_V2": single_V2,
        "cell_shared": max(2.0 * settings.memory_s / (turns * dt_s), 1.0),
        "cell_lag": min(settings.lag_s / dt_s, 1.0) ** 2,
        "cell_least_soc2": single_V2 / max(slope_V, 1e-3) ** 2,
        "cell_turns": turns,
        "cell_recovery": int(max(RECOVERY_S / (turns * dt_s), FEWEST_TURNS)),
    }
