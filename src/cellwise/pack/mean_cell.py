"""The mean cell's SOC over a pack's log, by the EKF, started again after every pause."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import known_temperature_C
from cellwise.estimate.filters.kalman import Ekf
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray, IndexArray

# A pause without a counter: the car may have been charged meanwhile, and nobody knows.
PAUSE_S = 300.0
FEWEST_ROWS = 10


@dataclass(frozen=True, eq=False)
class MeanCell:
    """The mean cell of a log.

    ``soc``, ``soc_std``, ``voltage_V`` (one step ahead), shape (n,); ``part`` numbers the stretches
    between pauses, -1 where one is too short to be estimated.
    """

    log: CellLog
    soc: FloatArray
    soc_std: FloatArray
    voltage_V: FloatArray
    part: IndexArray

    @property
    def used(self) -> BoolArray:
        """Rows with an estimate."""
        return np.asarray(self.part >= 0)

    @property
    def rmse_V(self) -> float:
        """Of the voltage one step ahead [V]; NaN without one."""
        error = (self.log.voltage_V - self.voltage_V)[self.used]
        error = error[np.isfinite(error)]
        return float(np.sqrt(np.mean(error**2))) if error.size else float("nan")


def mean_cell(model: CellModel, log: CellLog, soc0: float | None = None) -> MeanCell:
    """Estimate the mean cell's SOC.

    Parameters
    ----------
    soc0 : float or None      at the first row; None: as :func:`initial_soc` finds it
    """
    n = len(log)
    soc, std, voltage = (np.full(n, np.nan) for _ in range(3))
    part: IndexArray = np.full(n, -1, dtype=np.intp)
    ekf = Ekf(model)
    paused = (log.interval_s > PAUSE_S) & (log.charge_Ah is None)
    edges = [0, *np.flatnonzero(paused).tolist(), n]
    count = 0
    for first, stop in pairwise(edges):
        if stop - first < FEWEST_ROWS or not np.any(np.isfinite(log.voltage_V[first:stop])):
            continue
        one = log if stop - first == n else log.part(first, stop)
        start = initial_soc(model, one, soc0 if first == 0 else None)
        trace = ekf.run(one, start.soc, start.std)
        rows = slice(first, stop)
        soc[rows], std[rows], voltage[rows] = trace.soc, trace.soc_std, trace.voltage_V
        part[rows] = count
        count += 1
    return MeanCell(log, soc, std, voltage, part)


class OcvSlope:
    """OCV and its slope over SOC at one temperature, smoothed over what cells may differ by."""

    def __init__(self, model: CellModel, log: CellLog, half_width: float = 0.02) -> None:
        warm = float(np.median(known_temperature_C(model, log)))
        self._soc = model.soc
        self._ocv = model.at_temperature(warm).ocv_V[0]
        self._half = half_width

    def ocv_V(self, soc: FloatArray) -> FloatArray:
        """OCV [V]."""
        return np.asarray(np.interp(soc, self._soc, self._ocv))

    def slope_V(self, soc: FloatArray) -> FloatArray:
        """Its slope [V per unit of SOC]."""
        low, high = np.clip(soc - self._half, 0.0, 1.0), np.clip(soc + self._half, 0.0, 1.0)
        return np.asarray((self.ocv_V(high) - self.ocv_V(low)) / (high - low))
