"""A log as a target sees it: samples at a fixed time step."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import known_temperature_C
from cellwise.estimate.fixed.layout import INPUT
from cellwise.logs.cell_log import CellLog
from cellwise.logs.resample import resample
from cellwise.typing import IntArray

EVEN = 0.02  # intervals that differ by less from the time step need no resampling


class Samples(NamedTuple):
    """A log as a target would see it: records of INPUT, and the sample of every row of the log."""

    records: NDArray[Any]
    row_sample: IntArray


def median_interval_s(log: CellLog) -> float:
    """The usual interval between two rows [s]."""
    interval = np.diff(log.time_s)
    return float(np.median(interval[interval > 0])) if np.any(interval > 0) else 1.0


def samples_of(model: CellModel, log: CellLog, dt_s: float) -> Samples:
    """A log as samples at a fixed time step.

    An even log is taken row by row. Any other is resampled between its gaps, charge kept; a gap is
    a jump of the sequence number, as where a target was switched off.
    """
    whole = np.round(log.interval_s / dt_s)
    gaps = log.gap_rows
    even = np.abs(log.interval_s - dt_s) <= EVEN * dt_s
    if np.all(even[1:] | gaps[1:]):
        records = _records(model, log)
        records["sequence"] = np.cumsum(whole).astype(np.uint64).astype(np.uint32)
        return Samples(records, np.arange(len(log), dtype=np.int32))
    edges = [0, *np.flatnonzero(gaps).tolist(), len(log)]
    parts, times = [], []
    for first, last in pairwise(edges):
        piece = log.part(first, last) if last - first > 1 else None
        if piece is not None and piece.duration_s >= dt_s:
            piece = resample(piece, dt_s)
            part, time = _records(model, piece), log.time_s[first] + piece.time_s - piece.time_s[0]
        else:
            alone = slice(first, first + 1)
            part, time = _records(model, log)[alone], log.time_s[alone]
        parts.append(part)
        times.append(time)
    records, time_s = np.concatenate(parts), np.concatenate(times)
    step = np.maximum(np.round((time_s - time_s[0]) / dt_s), 0.0)
    records["sequence"] = step.astype(np.uint64).astype(np.uint32)
    row = np.searchsorted(time_s, log.time_s + 1e-9, side="right") - 1
    return Samples(records, np.maximum(row, 0).astype(np.int32))


def _records(model: CellModel, log: CellLog) -> NDArray[Any]:
    records = np.zeros(len(log), dtype=INPUT)
    records["current_A"] = log.interval_current_A
    records["voltage_V"] = log.voltage_V
    records["temperature_C"] = known_temperature_C(model, log)
    return records
