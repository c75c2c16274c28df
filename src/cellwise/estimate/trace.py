"""What an estimator made of a log, row by row, and the figures that are made of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import rows
from cellwise.cell.model import CellModel
from cellwise.cell.model_error import in_bands
from cellwise.cell.simulate import known_temperature_C
from cellwise.estimate.status import INNOVATION_REJECTED, VOLTAGE_FROZEN, VOLTAGE_INVALID
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray, IntArray

UNUSED = INNOVATION_REJECTED | VOLTAGE_INVALID | VOLTAGE_FROZEN  # voltages that did not count
LEAST_ROWS = 20


@dataclass(frozen=True, eq=False, repr=False)
class Trace:
    """Every array has shape (rows,).

    ``voltage_V`` is the voltage predicted before the row's own voltage was used; ``innovation_V``
    is measured minus predicted, ``innovation_variance_V2`` its variance, ``test_ratio`` its square
    over gate squared times variance; ``status`` are the bits of
    :class:`cellwise.estimate.status.Status`. Figures that an estimator does not have are NaN.
    """

    time_s: FloatArray
    soc: FloatArray
    soc_std: FloatArray
    voltage_V: FloatArray
    innovation_V: FloatArray
    innovation_variance_V2: FloatArray
    test_ratio: FloatArray
    status: IntArray

    def __len__(self) -> int:
        return self.time_s.size

    def __repr__(self) -> str:
        soc, band = self.soc[-1], 2.0 * self.soc_std[-1]
        return f"Trace({len(self)} rows, final SOC {soc:.4f} +- {band:.4f})"


class TraceSums(NamedTuple):
    """What is known of the innovations, which NIS were used, what the status said.

    ``squares_V2`` is the sum of the known innovations' squares, ``nis`` that of the NIS of voltages
    that were used, ``rejected`` counts rows, ``status`` has every bit that was ever set.
    """

    known: int
    squares_V2: float
    used: int
    nis: float
    rejected: int
    status: int


@rows
def trace_sums(
    innovation_V: FloatArray,
    variance_V2: FloatArray,
    status: IntArray,
) -> TraceSums:
    """Sums over the rows."""
    known, used, rejections, bits = 0, 0, 0, 0
    squares, nis = 0.0, 0.0
    for k in range(innovation_V.size):
        bits |= status[k]
        if status[k] & INNOVATION_REJECTED:
            rejections += 1
        square = innovation_V[k] * innovation_V[k]
        if not math.isfinite(square):
            continue
        known += 1
        squares += square
        if status[k] & UNUSED:
            continue
        ratio = square / variance_V2[k]
        if math.isfinite(ratio):
            used += 1
            nis += ratio
    return TraceSums(known, squares, used, nis, rejections, bits)


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
