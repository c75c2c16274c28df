"""By what a cell of a pack may differ from the mean cell, and how much cells usually do.

A cell's voltage minus the mean cell's is, to first order,

    d = s(z) (delta + kappa (z_ref - z)) - rho U + offset
        - lag dv/dt|before - lead dv/dt|after + f(z)

with z the mean cell's SOC, s the slope of its OCV, U = OCV(z) - v the mean cell's polarisation and
f a small difference in the shape of the OCV (Plett, Battery Management Systems II, 2015, ch. 4:
bar-delta filtering; the columns for polling and offset are ours).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.estimate.cells.settings import CellSettings
from cellwise.typing import FloatArray

SOC, CAPACITY, RESISTANCE, OFFSET, LAG, LEAD, SELF_DISCHARGE = range(7)
NAMED = 7
SHAPES = np.linspace(0.05, 0.95, 10)
SHAPE_WIDTH = 0.1
SIZE = NAMED + SHAPES.size
REFERENCE_SOC = 0.5


class Spread(NamedTuple):
    """Usual size of each difference: between cells of a new log, and its change in thirty days."""

    cells: FloatArray
    month: FloatArray


def usual_spread() -> Spread:
    """Standard deviations before a pack's own data say better, shape (SIZE,) each.

    Those of the fixed step (:class:`CellSettings`, with their source), and 2e-5 a day that cells'
    self-discharge differs by.
    """
    u = CellSettings()
    cells = np.array([u.soc, u.capacity, u.resistance, u.sensor_V, u.lag_s, u.lag_s, 2e-5])
    month = np.array(
        [u.soc_month, u.capacity_month, u.resistance_month, 0.0003, 0.005, 0.005, 1e-5]
    )
    shape = np.full(SHAPES.size, 0.001)
    return Spread(np.concatenate((cells, shape)), np.concatenate((month, 0.2 * shape)))
