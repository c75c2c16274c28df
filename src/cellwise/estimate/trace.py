"""What an estimator made of a log, row by row, and the figures that are made of it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.model_error import in_bands
from cellwise.cell.plausibility.notice import stated_error_V
from cellwise.cell.simulate import known_temperature_C
from cellwise.estimate.status import INNOVATION_REJECTED, VOLTAGE_FROZEN, VOLTAGE_INVALID
from cellwise.logs.cell_log import CellLog
from cellwise.logs.gaps import runs_of
from cellwise.plotting import Tabular
from cellwise.typing import BoolArray, FloatArray, IntArray

UNUSED = INNOVATION_REJECTED | VOLTAGE_INVALID | VOLTAGE_FROZEN  # voltages that did not count
LEAST_ROWS = 20
MINUTE_S = 60.0
LONG_S = 600.0  # as long as an error must stay small to have converged
BEYOND = 3.0  # deviations, as where a log is far off its model
STARTING = 2.0  # times the log's usual deviation: most of the variance is the start's
STEP_SOC = 0.02  # two points, within which an error has converged
TRACE_COLUMNS = (
    *("time_s", "soc", "soc_std", "voltage_V", "innovation_V", "innovation_variance_V2"),
    *("test_ratio", "status"),
)


@dataclass(frozen=True, eq=False, repr=False)
class Trace(Tabular):
    """Every array has shape (rows,).

    ``soc`` and ``soc_std`` are the estimate and its standard deviation at ``time_s``.
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


class Span(NamedTuple):
    """Rows ``first`` to ``last`` (included) whose mean innovation is ``mean_V`` [V].

    ``times`` is its median size over the deviation that the model states there.
    """

    first: int
    last: int
    mean_V: float
    times: float


def long_innovation(model: CellModel, log: CellLog, trace: Trace) -> Span | None:
    """The longest time for which the voltage stays on one side, beyond what the model states.

    Innovations are averaged over a minute, and compared with three deviations of all that the model
    states of its error: of a model that is right, three minutes of a thousand are beyond. None
    where no such time lasts ten minutes, or half of a shorter log.
    """
    rows = np.flatnonzero(trace.used)
    if rows.size < LEAST_ROWS:
        return None
    time_s, innovation_V = log.time_s[rows], np.asarray(trace.innovation_V, np.float64)[rows]
    stated_V = stated_error_V(model, log, trace.soc, trace.voltage_V)[rows]
    area = np.concatenate(([0.0], np.cumsum(innovation_V)))
    first = np.searchsorted(time_s, time_s - MINUTE_S)
    mean_V = (area[1:] - area[first]) / (np.arange(rows.size) + 1 - first)
    ratio = mean_V / np.maximum(stated_V, 1e-6)
    least_s = min(LONG_S, 0.5 * log.duration_s)
    found = None
    for side in (1.0, -1.0):
        for a, b in runs_of(side * ratio > BEYOND):
            lasts_s = time_s[b] - time_s[a]
            if lasts_s >= least_s and lasts_s > 0.0:
                least_s = lasts_s
                middle, size = np.mean(innovation_V[a : b + 1]), np.median(np.abs(ratio[a : b + 1]))
                found = Span(int(rows[a]), int(rows[b]), float(middle), float(size))
    return found


def soc_step(model: CellModel, log: CellLog, trace: Trace) -> int | None:
    """The row at which the SOC moves most in one sample beside the charge that flowed.

    None where no move is beyond two points: a filter moves the SOC bit by bit, and that far only
    where another hypothesis of the start or the sensor takes over. Not of the first minute, in
    which every start settles, nor after a gap, over which nobody knows what flowed.
    """
    flowed = log.known_current_A() * log.interval_s / (3600.0 * model.capacity_Ah)
    moved = np.diff(np.asarray(trace.soc, np.float64), prepend=trace.soc[0]) + flowed
    moved[(log.time_s - log.time_s[0] <= MINUTE_S) | log.gap_rows] = 0.0
    row = int(np.argmax(np.abs(np.nan_to_num(moved))))
    return row if abs(moved[row]) > STEP_SOC else None


def _starting(trace: Trace) -> BoolArray:
    """The first rows, as long as the start is what makes the innovation's deviation, (n,)."""
    variance = np.asarray(trace.innovation_variance_V2, dtype=np.float64)
    if not np.isfinite(variance[trace.used]).any():
        return np.zeros(len(trace), dtype=np.bool_)
    wide = variance > STARTING**2 * float(np.nanmedian(variance[trace.used]))
    return np.asarray(np.logical_and.accumulate(wide))


T = TypeVar("T", bound="Trace")


def behind_rows(trace: T, time_s: FloatArray, soc: FloatArray, soc_std: float) -> T:
    """A trace behind rows that no filter has seen: SOC counted, its start's deviation, no voltage.

    Parameters
    ----------
    trace : Trace                 of the rows behind
    time_s, soc : (n,) float      of the rows before
    """
    rows = time_s.size
    before = {"time_s": time_s, "soc": soc, "soc_std": np.full(rows, soc_std)}
    before["status"] = np.full(rows, VOLTAGE_INVALID)
    found = {}
    for field in fields(trace):
        behind = getattr(trace, field.name)
        if isinstance(behind, np.ndarray) and behind.shape[:1] == trace.time_s.shape:
            unknown = np.full((rows, *behind.shape[1:]), np.nan)
            first = before.get(field.name, unknown)
            found[field.name] = np.concatenate([first, behind]).astype(behind.dtype)
    return replace(trace, **found)


def nis_by_scale(model: CellModel, log: CellLog, trace: Trace) -> tuple[float, ...] | None:
    """Mean square innovation over the stated one in each band of time scale, shape (scales,).

    The SOC follows the slowest part of an error: of a variance e^2 an estimate whose own is
    (slope x std)^2 has taken that share of both, and e^2 / (1 + (slope x std)^2 / e^2) is left.
    A share of the polarisation that no test could show, since no load lasted, errs on the scales of
    minutes as the polarisation itself moves there.
    The first rows, whose voltage shows where the log begins rather than how good the model is, do
    not count. None where too few voltages were used.
    """
    error = model.error
    innovation, used = np.asarray(trace.innovation_V, dtype=np.float64), trace.used
    used = used & ~_starting(trace)
    if used.sum() < LEAST_ROWS:
        return None
    bands = in_bands(log.time_s[used], innovation[used], error.scales_s)
    soc = np.clip(trace.soc[used], 0.0, 1.0)
    warm = float(np.nanmedian(known_temperature_C(model, log)))
    ocv = model.ocv_at(warm)
    drop = np.interp(soc, model.soc, ocv) - (log.voltage_V - innovation)[used]
    hidden = drop * np.where(drop >= 0.0, error.hidden_share(1.0), error.hidden_share(-1.0))
    unseen = in_bands(log.time_s[used], hidden, error.scales_s)
    explained = np.interp(soc, model.soc, np.gradient(ocv, model.soc)) * trace.soc_std[used]
    found = []
    for k, band in enumerate(bands):
        share = np.where(drop >= 0.0, error.shares(1.0)[k], error.shares(-1.0)[k])
        stated = error.variance_V2(k, soc, warm) + (share * drop) ** 2
        if error.scales_s[k] > MINUTE_S:
            stated = stated + unseen[k] ** 2
        if k + 1 == len(bands):
            stated = stated**2 / (stated + explained**2 + 1e-12)
        found.append(float(np.mean(band**2) / max(float(np.mean(stated)), 1e-12)))
    return tuple(found)
