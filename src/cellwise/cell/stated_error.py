"""What a model states of its own voltage error along a log."""

from __future__ import annotations

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.logs.measured_log import MeasuredLog
from cellwise.typing import FloatArray


def stated_error_V(
    model: CellModel,
    log: MeasuredLog,
    soc: FloatArray,
    voltage_V: FloatArray,
    *,
    other_resistance: float = 0.0,
) -> FloatArray:
    """Standard deviation of the voltage that the model states at every row, all time scales [V].

    Parameters
    ----------
    soc, voltage_V : (n,) float      the model's, simulated or predicted
    other_resistance : float         share by which the cell's resistance may differ besides

    Returns
    -------
    (n,) float      at the log's median temperature
    """
    measured = log.temperature_C
    known = measured is not None and bool(np.any(np.isfinite(measured)))
    warm = float(np.nanmedian(measured)) if known else None  # type: ignore[arg-type]
    return stated_error_at(model, soc, voltage_V, warm, other_resistance=other_resistance)


def stated_error_at(
    model: CellModel,
    soc: FloatArray | float,
    voltage_V: FloatArray | float,
    warm: float | None,
    *,
    other_resistance: float = 0.0,
) -> FloatArray:
    """The same at one temperature, None where it is not known [degC]."""
    at, error = np.clip(soc, 0.0, 1.0), model.error
    ocv = model.ocv_at(float(model.temperature_C[0]) if warm is None else warm)
    drop = np.interp(at, model.soc, ocv) - voltage_V
    share = np.where(drop >= 0.0, error.whole_share(1.0), error.whole_share(-1.0))
    share = np.hypot(share, other_resistance)
    slow = model.slow_error_V(at, warm)
    return np.asarray(np.sqrt(slow**2 + error.white_V**2 + (share * drop) ** 2))
