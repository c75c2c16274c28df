"""The mean cell of a pack, by what a cell may differ from it, and what that does to its voltage.

The mean cell's SOC is the EKF's, started again after every pause. A cell's voltage minus the mean
cell's is, to first order,

    d = s(z) (delta + kappa (z_ref - z)) - rho U + offset
        - lag dv/dt|before - lead dv/dt|after + f(z)

with z the mean cell's SOC, s the slope of its OCV, U = OCV(z) - v the mean cell's polarisation and
f a small difference in the shape of the OCV (Plett, Battery Management Systems II, 2015, ch. 4:
bar-delta filtering; the columns for polling and offset are ours).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from typing import NamedTuple

import numpy as np

from cellwise.cell.initial_soc.gaps import stretches
from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import known_temperature_C
from cellwise.errors import InputError
from cellwise.estimate.filters.kalman import Ekf
from cellwise.logs.cell_log import CellLog
from cellwise.logs.files.times import DAY_S
from cellwise.logs.packs.pack_log import PackLog
from cellwise.logs.stated import check_order, day_of_name
from cellwise.notices import Code, Notice
from cellwise.typing import BoolArray, FloatArray, IndexArray

# Which rows of a pack's log are compared, and over how long.
FEWEST_ROWS = 10  # between two pauses that nobody counted
# Or one interval, of rates of the mean voltage: a polling delay of seconds is seen whole.
RATE_S = 2.0
LONGEST_INTERVALS = 3.0  # of the usual length: over longer ones a rate says nothing

PERIOD_DAYS = 30.0


@dataclass(frozen=True, eq=False)
class MeanCell:
    """The mean cell of a log.

    ``start`` is that of its first row, as every command finds it; ``soc``, ``soc_std``,
    ``voltage_V`` (one step ahead), shape (n,); ``part`` numbers the stretches between pauses, -1
    where one is too short to be estimated.
    """

    log: CellLog
    start: InitialSoc
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


def mean_cell(model: CellModel, log: CellLog) -> MeanCell:
    """Estimate the mean cell's SOC, from where :func:`initial_soc` finds its start."""
    n = len(log)
    soc, std, voltage = (np.full(n, np.nan) for _ in range(3))
    part: IndexArray = np.full(n, -1, dtype=np.intp)
    ekf, begun = Ekf(model), initial_soc(model, log, whole_log=True)
    long = [s for s in stretches(model, log, begun) if s.stop - s.first >= FEWEST_ROWS]
    for count, one in enumerate(long):
        trace = ekf.run(one.of(log), one.start.soc, one.start.std)
        rows = slice(one.first, one.stop)
        soc[rows], std[rows], voltage[rows] = trace.soc, trace.soc_std, trace.voltage_V
        part[rows] = count
    return MeanCell(log, begun, soc, std, voltage, part)


@dataclass(frozen=True, eq=False)
class PackDay:
    """One log, its mean cell, and on which day it was recorded (None: nobody knows)."""

    log: PackLog
    mean: MeanCell
    day: date | None

    @property
    def ordinal(self) -> float:
        """Days on a common clock; 0 where nobody knows."""
        return 0.0 if self.day is None else float(self.day.toordinal())


def pack_days(
    model: CellModel, logs: Sequence[PackLog], names: tuple[str, ...] | None = None
) -> tuple[PackDay, ...]:
    """The mean cell of every log, in order of time.

    Parameters
    ----------
    names : tuple of str or None      the cells that an earlier state knows

    Raises
    ------
    InputError        no log; other cells in half of the logs or more than in the others; none that
                      can be estimated; days that run backwards

    Notes
    -----
    What cannot serve is left out, and a notice of the first log says so.
    """
    if not logs:
        raise InputError("no log", "at least one log with cell voltages", "Name it.")
    of_most, count = Counter(log.names for log in logs).most_common(1)[0]
    expected = names or (of_most if 2 * count > len(logs) else logs[0].names)
    before = next((f"'{log.name}'" for log in logs if log.names == expected), "the saved state")
    days, refused = [], []
    for log in logs:
        try:
            _check_cells(log, expected, before)
            days.append(PackDay(log, mean_cell(model, log.mean), day_of_name(log.name)))
        except InputError as error:
            refused.append(error)
    if refused and 2 * len(refused) > len(logs) - 1:
        raise refused[0]
    check_order([(one.log.name, one.day) for one in days])
    if refused:
        left_out = (Notice(Code.LOG_LEFT_OUT, "left out: " + one.found) for one in refused)
        said = (*days[0].log.mean.notices, *left_out)
        first = replace(days[0].log, mean=days[0].log.mean.with_notices(said))
        days[0] = replace(days[0], log=first)
    return tuple(days)


def _check_cells(log: PackLog, expected: tuple[str, ...], before: str) -> None:
    """Refuse a log of other cells."""
    if log.names != expected:
        absent = [n for n in expected if n not in log.names][:3]
        added = [n for n in log.names if n not in expected][:3]
        raise InputError(
            f"{log.cells} cells in '{log.name}' and {len(expected)} in {before}"
            + (f", without {', '.join(absent)}" if absent else "")
            + (f", with {', '.join(added)}" if added else ""),
            "the same cells in every log of a pack",
            "Estimate logs with other cells by themselves, or repair the columns.",
        )


def periods(days: Sequence[PackDay]) -> tuple[tuple[PackDay, ...], ...]:
    """Logs of :data:`PERIOD_DAYS` together; all together where a day is not known."""
    if any(d.day is None for d in days):
        return (tuple(days),)
    found: list[list[PackDay]] = [[days[0]]]
    for day in days[1:]:
        if day.ordinal - found[-1][0].ordinal >= PERIOD_DAYS:
            found.append([])
        found[-1].append(day)
    return tuple(tuple(part) for part in found)


SMOOTHED_SOC = 0.02  # to each side, over which a slope is taken


class OcvSlope:
    """OCV and its slope over SOC at one temperature, smoothed over what cells may differ by."""

    def __init__(self, model: CellModel, log: CellLog) -> None:
        temperature_C = float(np.median(known_temperature_C(model, log)))
        self._soc = model.soc
        self._ocv = model.at_temperature(temperature_C).ocv_V[0]

    def ocv_V(self, soc: FloatArray) -> FloatArray:
        """OCV [V]."""
        return np.asarray(np.interp(soc, self._soc, self._ocv))

    def slope_V(self, soc: FloatArray) -> FloatArray:
        """Its slope [V per unit of SOC]."""
        low, high = np.clip(soc - SMOOTHED_SOC, 0.0, 1.0), np.clip(soc + SMOOTHED_SOC, 0.0, 1.0)
        return np.asarray((self.ocv_V(high) - self.ocv_V(low)) / (high - low))


SOC, CAPACITY, RESISTANCE, OFFSET, LAG, LEAD, SELF_DISCHARGE = range(7)
NAMED = 7
SHAPES = np.linspace(0.05, 0.95, 10)
SHAPE_WIDTH = round(float(SHAPES[1] - SHAPES[0]), 6)
SIZE = NAMED + SHAPES.size
REFERENCE_SOC = 0.5

# Usual size of each difference before a pack's own data say better, shape (SIZE,): between cells of
# a new log, and its change in thirty days. Cells of one batch: capacity 1 %, resistance 3 % (Rumpf
# et al., J. Energy Storage 14 (2017) 224, and the cells of the stock models' sources); cell
# monitors: 1 to 2 mV, polled within tenths of a second; SOC as balancing leaves it, 0.5 %.
_SHAPE = np.full(SHAPES.size, 0.001)
CELLS = np.concatenate(([0.005, 0.010, 0.030, 0.0015, 0.10, 0.10, 2e-5], _SHAPE))
MONTH = np.concatenate(([0.002, 0.001, 0.002, 0.0003, 0.005, 0.005, 1e-5], 0.2 * _SHAPE))


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
    rows[:, SELF_DISCHARGE] = -slope * (days + log.time_s / DAY_S)
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
