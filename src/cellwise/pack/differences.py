"""By what a cell of a pack may differ from the mean cell, and what that does to its voltage.

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

from cellwise.pack.mean_cell import MeanCell, OcvSlope
from cellwise.typing import BoolArray, FloatArray

SOC, CAPACITY, RESISTANCE, OFFSET, LAG, LEAD, SELF_DISCHARGE = range(7)
NAMED = 7
SHAPES = np.linspace(0.05, 0.95, 10)
SHAPE_WIDTH = 0.1
SIZE = NAMED + SHAPES.size
REFERENCE_SOC = 0.5
# Rates of the mean voltage are taken over this long or one interval: a polling delay of seconds is
# then seen whole, also where rows are closer.
RATE_S = 2.0
LONGEST_INTERVALS = 3.0  # of the usual length: over longer ones a rate says nothing


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


class Regressors(NamedTuple):
    """Derivatives of a cell's difference from the mean.

    ``rows`` (n, SIZE) [V per unit of each parameter]; ``change_V`` (n,) how far the mean voltage
    moved around a row; ``used`` (n,) rows to compare.
    """

    rows: FloatArray
    change_V: FloatArray
    used: BoolArray


def regressors(mean: MeanCell, ocv: OcvSlope, days: float) -> Regressors:
    """Derivatives of a cell's difference from the mean cell.

    Parameters
    ----------
    mean : MeanCell
    ocv : OcvSlope
    days : float      from the pack's first log to this log's start

    Returns
    -------
    Regressors        rows that are not used are zero
    """
    log, soc = mean.log, mean.soc
    voltage = log.voltage_V
    before, after, change, near = _rates(mean)
    used = mean.used & near & np.isfinite(voltage) & np.isfinite(soc)
    z = np.where(used, soc, REFERENCE_SOC)
    slope = ocv.slope_V(z)
    rows = np.empty((len(log), SIZE))
    rows[:, SOC] = slope
    rows[:, CAPACITY] = slope * (REFERENCE_SOC - z)
    rows[:, RESISTANCE] = voltage - ocv.ocv_V(z)
    rows[:, OFFSET] = 1.0
    rows[:, LAG] = -before
    rows[:, LEAD] = -after
    rows[:, SELF_DISCHARGE] = -slope * (days + log.time_s / 86_400.0)
    rows[:, SELF_DISCHARGE + 1 :] = np.clip(1.0 - np.abs(z[:, None] - SHAPES) / SHAPE_WIDTH, 0, 1)
    rows[~used] = 0.0
    return Regressors(rows, change, used)


def _rates(mean: MeanCell) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Rate of the mean voltage before and after each row [V/s], its change [V], rows with both."""
    time, voltage = mean.log.time_s, mean.log.voltage_V
    n = time.size
    interval = np.diff(time)
    usual = float(np.median(interval[interval > 0])) if np.any(interval > 0) else 1.0
    span = max(RATE_S, usual)
    known = np.isfinite(voltage)
    filled = np.interp(time, time[known], voltage[known])
    before = (filled - np.interp(time - span, time, filled)) / span
    after = (np.interp(time + span, time, filled) - filled) / span
    near = np.zeros(n, dtype=np.bool_)
    short = interval <= LONGEST_INTERVALS * max(usual, RATE_S)
    same = mean.part[1:] == mean.part[:-1]
    near[1:-1] = (short & same)[:-1] & (short & same)[1:]
    change = span * np.maximum(np.abs(before), np.abs(after))
    return before, after, change, near
