"""Innovations against the model's statement of its error, on every time scale."""

from __future__ import annotations

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.model_error import in_bands
from cellwise.cell.simulate import known_temperature_C
from cellwise.estimate.status import INNOVATION_REJECTED, VOLTAGE_FROZEN, VOLTAGE_INVALID
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog

UNUSED = INNOVATION_REJECTED | VOLTAGE_INVALID | VOLTAGE_FROZEN
LEAST_ROWS = 20


def nis_by_scale(model: CellModel, log: CellLog, trace: Trace) -> tuple[float, ...] | None:
    """Mean square innovation over the stated one in each band of time scale, shape (scales,).

    The SOC follows the slowest part of an error: of a variance e^2 an estimate whose own is
    (slope x std)^2 has taken that share of both, and e^2 / (1 + (slope x std)^2 / e^2) is left.
    None where too few voltages were used.
    """
    error = model.error
    innovation = np.asarray(trace.innovation_V, dtype=np.float64)
    used = np.isfinite(innovation) & (np.asarray(trace.status, dtype=np.int64) & UNUSED == 0)
    if used.sum() < LEAST_ROWS:
        return None
    bands = in_bands(log.time_s[used], innovation[used], error.scales_s)
    soc = np.clip(trace.soc[used], 0.0, 1.0)
    warm = float(np.nanmedian(known_temperature_C(model, log)))
    ocv = model.ocv_at(warm)
    drop = np.interp(soc, model.soc, ocv) - (log.voltage_V - innovation)[used]
    explained = np.interp(soc, model.soc, np.gradient(ocv, model.soc)) * trace.soc_std[used]
    found = []
    for k, band in enumerate(bands):
        share = np.where(drop >= 0.0, error.shares(1.0)[k], error.shares(-1.0)[k])
        stated = error.variance_V2(k, soc, warm) + (share * drop) ** 2
        if k + 1 == len(bands):
            stated = stated**2 / (stated + explained**2 + 1e-12)
        found.append(float(np.mean(band**2) / max(float(np.mean(stated)), 1e-12)))
    return tuple(found)
