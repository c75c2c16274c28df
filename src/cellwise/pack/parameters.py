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

    Cells of one batch: capacity 1 %, resistance 3 % (Rumpf et al., J. Energy Storage 14 (2017)
    224, and the cells of the stock models' sources); cell monitors: 1 to 2 mV, polled within
    tenths of a second; SOC as balancing leaves it, 0.5 %.
    """
    cells = np.array([0.005, 0.010, 0.030, 0.0015, 0.10, 0.10, 2e-5])
    month = np.array([0.002, 0.001, 0.002, 0.0003, 0.005, 0.005, 1e-5])
    shape = np.full(SHAPES.size, 0.001)
    return Spread(np.concatenate((cells, shape)), np.concatenate((month, 0.2 * shape)))
