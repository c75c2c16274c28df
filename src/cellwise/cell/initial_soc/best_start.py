"""The initial SOC from which a simulation fits a log best."""

from __future__ import annotations

import math

import numpy as np

from cellwise.cell.compiled import for_kernel
from cellwise.cell.initial_soc.start_kernels import MeasuredRows, Starts, best_start
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import UPPER_HALF, known_temperature_C
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray


def best_start_soc(model: CellModel, log: CellLog, soc0: FloatArray) -> tuple[float, float]:
    """The initial SOC from which `simulate` fits a log's voltage best, of those given.

    Parameters
    ----------
    model : CellModel
    log : CellLog
    soc0 : (m,) float     SOC at the first row, each within 0..1

    Returns
    -------
    float, float          the SOC, and the root mean square of the voltage error from there [V]
    """
    return best_start_of(model, rows_to_fit(model, log), soc0)


def rows_to_fit(model: CellModel, log: CellLog) -> MeasuredRows:
    """What the search for a start needs of a log."""
    return MeasuredRows(
        log.interval_s,
        log.known_current_A(),
        known_temperature_C(model, log),
        for_kernel(log.voltage_V),
    )


def best_start_of(model: CellModel, rows: MeasuredRows, soc0: FloatArray) -> tuple[float, float]:
    """:func:`best_start_soc` of rows that are prepared."""
    starts = np.array(soc0, dtype=np.float64)
    h0 = np.where(starts > UPPER_HALF, 1.0, -1.0)
    number, total = best_start(model.parameters(), Starts(starts, h0), rows)
    known = max(int(np.count_nonzero(np.isfinite(rows.voltage_V))), 1)
    return float(starts[number]), math.sqrt(total / known)
