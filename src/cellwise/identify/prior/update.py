"""The most probable model, given a prior and logs: a few Gauss-Newton steps, and what they left."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from cellwise.cell.equations import CellTables, empty_state
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import known_temperature_C, simulate_rows
from cellwise.identify.prior.corrections import Corrections
from cellwise.identify.refinement.model_error import polarisation_V
from cellwise.identify.refinement.problem import independent_samples
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray, IndexArray


class Evidence(NamedTuple):
    """How much a log says.

    Parameters
    ----------
    least_V : float         two logs of one cell are not alike within less: temperature inside,
                            relaxation, sensors [V]
    first_V : float         of the residuals before any fit [V]
    robust : float          a residual of more deviations counts linearly
    fewest : float          independent errors of a log, however short
    share : float           of the voltage drop, in the lower third of the SOC range of logs that
                            end empty: there it does not follow temperature and rate as tables do
    memory_s : float        residuals of a fit forget sooner than the model's error does: tables are
                            wrong for as long as the SOC stays near. The filters' default noise has
                            the same time [s]
    rows, most : float      where priors are compared: compared rows for one error; most of a log
    """

    least_V: float = 0.005
    first_V: float = 0.02
    robust: float = 4.0
    fewest: float = 4.0
    share: float = 0.1
    memory_s: float = 300.0
    rows: float = 20.0
    most: float = 50.0


OF_A_LOG = Evidence()
MOST_COMPARED = 1500  # rows of a log
PASSES = (8, 6, 8)  # Levenberg-Marquardt steps; after each their size is found again
STEP, SOC_STEP = 0.02, 1e-4  # of a standard normal variable and of an initial SOC, for differences


class LeftAtLimit(NamedTuple):
    """SOC that is left where a load ends, by how far the OCV is then above the limit.

    Near empty a prior of another kind knows neither where the OCV falls nor what the resistances
    become there, and one voltage cannot separate the two from a larger capacity. But empty is where
    the user's own limit is: what a load leaves follows from how far it holds the voltage below the
    OCV.

    Parameters
    ----------
    always : float          left after any load of more than a low rate
    per_V2 : float          SOC over the square of that voltage. Measured at C/10 and less,
                            and of physics models, eight cells have 0.01 to 0.02 at 0.3 V, 0.015 to
                            0.055 at 0.5 V and 0.035 to 0.16 at 0.7 V, whatever their limit
    relative, least : float     standard deviation, of the part by that voltage and at least. After
                            1C at 25 degC eight cells have 0.00 to 0.07, half of them 0.02 to 0.03
    middle : float          SOC where the same load shows its voltage drop undisturbed by the end
    growth : float          the drop near empty over that in the middle
    near_V : float          rows this near a log's lowest voltage are its end
    fall_V : float          a load in the middle of the range is this much above one at the limit;
                            with less of a fall the log just ended
    """

    always: float = 0.01
    per_V2: float = 0.15
    relative: float = 0.5
    least: float = 0.02
    middle: float = 0.35
    growth: float = 2.0
    near_V: float = 0.1
    fall_V: float = 0.3


LEFT = LeftAtLimit()


def lowest_row(log: CellLog) -> int:
    """Where a log would end empty, if it does: the emptiest row near its lowest voltage."""
    near = np.flatnonzero(log.voltage_V <= float(np.nanmin(log.voltage_V)) + LEFT.near_V)
    return int(near[np.argmax(log.counted_charge_Ah()[near])])


def left_at(
    lowest_V: FloatArray, middle_V: FloatArray, drop_V: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """SOC at the lowest rows of logs and its standard deviation, infinite where none is empty.

    Parameters
    ----------
    lowest_V : (logs,) array    the logs' lowest voltages [V]
    middle_V, drop_V : (logs,) array    voltage of the same loads at ``middle``, and what they take
                                        off the OCV there [V]
    """
    empty = lowest_V < middle_V - LEFT.fall_V
    limit_V = np.min(lowest_V, where=empty, initial=np.inf)
    above_V = np.where(empty, lowest_V - limit_V, 0.0) + LEFT.growth * np.maximum(drop_V, 0.0)
    part = LEFT.per_V2 * above_V**2
    return LEFT.always + part, np.where(empty, LEFT.relative * part + LEFT.least, np.inf)


@dataclass(frozen=True, eq=False)
class PriorLog:
    """A log to update on: SOC at its first row with its standard deviation, and what to compare.

    ``compare`` marks rows, shape (n,); None: all with a voltage. ``h0`` is its hysteresis state
    there: between the branches where nobody knows what was before.
    """

    log: CellLog
    soc0: float
    soc0_std: float
    compare: BoolArray | None = None
    h0: float = 0.0


class ComparedLog(NamedTuple):
    """A log as the simulation takes it, and which rows are compared."""

    item: PriorLog
    interval_s: FloatArray
    current_A: FloatArray
    temperature_C: FloatArray
    rows: IndexArray

    def soc(self, model: CellModel, soc0: float) -> FloatArray:
        """SOC at the compared rows."""
        charge = np.cumsum(self.current_A * self.interval_s)[self.rows] / 3600.0
        return np.asarray(soc0 - charge / model.capacity_Ah)

    def voltage_V(self, tables: CellTables, soc0: float) -> FloatArray:
        """Simulated at the compared rows [V]."""
        voltage, soc = np.empty((2, self.current_A.size))
        simulate_rows(
            tables, empty_state(soc0, self.item.h0), self.interval_s, self.current_A,
            self.temperature_C, voltage, soc,
        )  # fmt: skip
        return np.asarray(voltage[self.rows])

    def drop_V(self, model: CellModel, soc: FloatArray, voltage_V: FloatArray) -> FloatArray:
        """What the load takes off the OCV at the compared rows [V]."""
        return polarisation_V(model, soc, self.temperature_C[self.rows], voltage_V)


class FittedLog(NamedTuple):
    """What an update leaves of a log, at the compared rows: measured minus model [V]."""

    log: CellLog
    rows: IndexArray
    soc: FloatArray
    temperature_C: FloatArray
    drop_V: FloatArray
    residual_V: FloatArray


@dataclass(frozen=True, eq=False)
class Update:
    """The most probable corrections and initial SOCs.

    ``z`` (size,) with its ``covariance`` (size, size); ``soc0`` (logs,) and its standard deviation;
    ``distance`` is half the squared distance from the prior, in standard deviations.
    """

    model: CellModel
    z: FloatArray
    covariance: FloatArray
    soc0: FloatArray
    soc0_std: FloatArray
    logs: tuple[FittedLog, ...]
    distance: float

    @property
    def misfit(self) -> float:
        """Minus the log probability, up to a constant; every log counts alike by every prior."""
        total = self.distance
        for r in (log.residual_V for log in self.logs):
            number = float(np.clip(r.size / OF_A_LOG.rows, OF_A_LOG.fewest, OF_A_LOG.most))
            total += number * float(np.log(np.hypot(np.sqrt(np.mean(r * r)), OF_A_LOG.least_V)))
        return total


def update(corrections: Corrections, logs: Sequence[PriorLog]) -> Update:
    """Fit corrections and initial SOCs to the logs' voltages, held by the prior.

    Each log counts with the number of its independent residuals and their size, both found on the
    way: a model is wrong for longer than a sample, and thousands of rows are no thousand proofs.

    Parameters
    ----------
    corrections : Corrections
    logs : sequence of PriorLog       each with at least one row to compare

    Returns
    -------
    Update
    """
    problem = _Problem(corrections, logs)
    x = np.zeros(problem.size + len(logs))
    problem.judge(x, first=True)
    for steps in PASSES:
        found = least_squares(problem.weighted, x, problem.slopes, method="lm", max_nfev=steps)
        x = found.x
        problem.judge(x)
    slope = problem.slopes(x)
    covariance = np.asarray(np.linalg.inv(slope.T @ slope), dtype=np.float64)
    size = problem.size
    return Update(
        model=problem.model(x),
        z=x[:size],
        covariance=covariance[:size, :size],
        soc0=problem.soc0(x),
        soc0_std=problem.stds * np.sqrt(np.diag(covariance)[size:]),
        logs=tuple(problem.fitted(x)),
        distance=0.5 * float(x @ x),
    )


class _Problem:
    """Least squares over corrections and initial SOCs, both as standard normal variables.

    The residuals of every log follow these variables, each with the square root of what it counts.
    """

    def __init__(self, corrections: Corrections, logs: Sequence[PriorLog]) -> None:
        self.corrections, self.size = corrections, corrections.size
        self.logs = [_compared(corrections.prior, item) for item in logs]
        self.means = np.array([item.soc0 for item in logs])
        self.stds = np.array([item.soc0_std for item in logs])
        self.most = [max(i.log.duration_s / OF_A_LOG.memory_s, OF_A_LOG.fewest) for i in logs]
        self.roots: list[FloatArray] = []
        self.ends = [lowest_row(item.log) for item in logs]
        each = zip(logs, self.ends, strict=True)
        self.end_Ah = np.array([item.log.counted_charge_Ah()[row] for item, row in each])
        self.left, self.left_std = np.zeros(len(logs)), np.full(len(logs), np.inf)

    def model(self, x: FloatArray) -> CellModel:
        """The corrected model."""
        return self.corrections.model(x[: self.size])

    def soc0(self, x: FloatArray) -> FloatArray:
        """Initial SOC of every log."""
        return np.clip(self.means + self.stds * x[self.size :], 0.0, 1.0)

    def residuals(self, x: FloatArray) -> list[FloatArray]:
        """Measured minus simulated voltage of every log [V]."""
        tables = self.model(x).parameters()
        return [
            log.item.log.voltage_V[log.rows] - log.voltage_V(tables, float(soc0))
            for log, soc0 in zip(self.logs, self.soc0(x), strict=True)
        ]

    def fitted(self, x: FloatArray) -> Iterator[FittedLog]:
        """Every log with its residual."""
        model = self.model(x)
        for log, soc0, r in zip(self.logs, self.soc0(x), self.residuals(x), strict=True):
            soc = log.soc(model, float(soc0))
            drop = log.drop_V(model, soc, log.item.log.voltage_V[log.rows] - r)
            yield FittedLog(log.item.log, log.rows, soc, log.temperature_C[log.rows], drop, r)

    def judge(self, x: FloatArray, *, first: bool = False) -> None:
        """Take the size of every log's residual, and how many independent errors it holds."""
        self.roots = []
        self._look_at_ends(self.model(x))
        for k, (log, most) in enumerate(zip(self.fitted(x), self.most, strict=True)):
            r, sigma, number = log.residual_V, OF_A_LOG.first_V, most
            if not first:
                sigma = max(1.4826 * float(np.median(np.abs(r))), OF_A_LOG.least_V)
                number = min(max(independent_samples(r), OF_A_LOG.fewest), most)
            robust = np.sqrt(1.0 + (r / (OF_A_LOG.robust * sigma)) ** 2)
            share = OF_A_LOG.share * (log.soc <= LEFT.middle) * np.isfinite(self.left_std[k])
            wide = np.hypot(sigma, share * log.drop_V)
            self.roots.append(np.sqrt(number / r.size / robust) / wide)

    def weighted(self, x: FloatArray) -> FloatArray:
        """The variables and the residuals as they count."""
        each = zip(self.roots, self.residuals(x), strict=True)
        return np.concatenate((x, *(root * r for root, r in each), self._at_ends(x)))

    def _look_at_ends(self, model: CellModel) -> None:
        """Take what each load that ends at the lower limit leaves, by the model so far."""
        tables = model.parameters()
        middle, drop = [], []
        for log, row, end_Ah in zip(self.logs, self.ends, self.end_Ah, strict=True):
            # The same load, moved to where it ends in the middle of the range.
            start = LEFT.middle + end_Ah / model.capacity_Ah
            moved = log._replace(rows=np.array([row]))
            voltage_V = moved.voltage_V(tables, start)
            middle.append(float(voltage_V[0]))
            drop.append(float(moved.drop_V(model, moved.soc(model, start), voltage_V)[0]))
        lowest = np.array([np.nanmin(log.item.log.voltage_V) for log in self.logs])
        self.left, self.left_std = left_at(lowest, np.array(middle), np.array(drop))

    def _at_ends(self, x: FloatArray) -> FloatArray:
        """SOC at the ends less the usual one there; a cell differs at all of them alike.

        So all of them together count as the surest one.
        """
        weight = 1.0 / self.left_std
        if not weight.any():
            return np.zeros(weight.size)
        moved = self.end_Ah / self.corrections.capacity_Ah(x[: self.size])
        share = weight * weight.max() / np.linalg.norm(weight)
        return np.asarray(share * (self.soc0(x) - moved - self.left))

    def slopes(self, x: FloatArray) -> FloatArray:
        """Derivatives of :meth:`weighted`, by differences; an initial SOC moves its own log."""
        here = self.weighted(x)
        found = np.eye(here.size, x.size)
        for k in range(x.size):
            step = STEP
            if k >= self.size:
                inwards = 1.0 if self.soc0(x)[k - self.size] <= 0.5 else -1.0
                step = inwards * SOC_STEP / self.stds[k - self.size]
            moved = x.copy()
            moved[k] += step
            found[:, k] = (self.weighted(moved) - here) / step
        return found


def _compared(prior: CellModel, item: PriorLog) -> ComparedLog:
    """The log's columns; compared are rows with a voltage, evenly over its time."""
    log = item.log
    usable = np.isfinite(log.voltage_V)
    if item.compare is not None:
        usable &= item.compare
    known = np.flatnonzero(usable)
    if known.size > MOST_COMPARED:
        time_s = log.time_s[known]
        wanted = np.linspace(time_s[0], time_s[-1], MOST_COMPARED)
        known = np.unique(known[np.searchsorted(time_s, wanted).clip(0, known.size - 1)])
    warm = known_temperature_C(prior, log)
    return ComparedLog(item, np.array(log.interval_s), log.known_current_A(), warm, known)
