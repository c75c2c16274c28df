"""What an estimator made of a log, row by row, and the figures that are made of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.model_error import in_bands
from cellwise.cell.simulate import known_temperature_C
from cellwise.estimate.status import INNOVATION_REJECTED, VOLTAGE_FROZEN, VOLTAGE_INVALID
from cellwise.logs.cell_log import CellLog
from cellwise.plotting import Tabular
from cellwise.typing import BoolArray, FloatArray, IntArray

UNUSED = INNOVATION_REJECTED | VOLTAGE_INVALID | VOLTAGE_FROZEN  # voltages that did not count
LEAST_ROWS = 20
TRACE_COLUMNS = (
    *("time_s", "soc", "soc_std", "voltage_V", "innovation_V", "innovation_variance_V2"),
    *("test_ratio", "status"),
)


@dataclass(frozen=True, eq=False, repr=False)
class Trace(Tabular):
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

    def columns(self) -> dict[str, Any]:
        """The arrays, which every estimator has."""
        return {name: getattr(self, name) for name in TRACE_COLUMNS}

    @property
    def used(self) -> BoolArray:
        """Rows whose voltage was used, and whose innovation is known."""
        counted = np.asarray(self.status, dtype=np.int64) & UNUSED == 0
        return np.asarray(counted & np.isfinite(self.innovation_V))

    @property
    def nis_mean(self) -> float | None:
        """Mean of innovation squared over its variance, over the voltages that were used."""
        nis = self.innovation_V[self.used] ** 2 / self.innovation_variance_V2[self.used]
        nis = nis[np.isfinite(nis)]
        return float(np.mean(nis)) if nis.size else None

    @property
    def voltage_rmse_V(self) -> float:
        """RMSE of the voltage predicted before each measurement was used [V]; NaN: none was."""
        known = self.innovation_V[np.isfinite(self.innovation_V)]
        return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")

    @property
    def rejected(self) -> float:
        """Share of the rows that the gate rejected."""
        return float(np.mean(np.asarray(self.status) & INNOVATION_REJECTED != 0))

    def __repr__(self) -> str:
        soc, band = self.soc[-1], 2.0 * self.soc_std[-1]
        return f"Trace({len(self)} rows, final SOC {soc:.4f} +- {band:.4f})"


def nis_by_scale(model: CellModel, log: CellLog, trace: Trace) -> tuple[float, ...] | None:
    """Mean square innovation over the stated one in each band of time scale, shape (scales,).

    The SOC follows the slowest part of an error: of a variance e^2 an estimate whose own is
    (slope x std)^2 has taken that share of both, and e^2 / (1 + (slope x std)^2 / e^2) is left.
    None where too few voltages were used.
    """
    error = model.error
    innovation, used = np.asarray(trace.innovation_V, dtype=np.float64), trace.used
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
