"""Start, state, sample and info of the Kalman filters, as the kernels carry them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import kernel
from cellwise.cell.equations import CellState, at_rest
from cellwise.estimate.evidence_kernels import stated_deviation
from cellwise.estimate.filters.covariance_kernels import Covariance, no_branches, uncorrelated
from cellwise.estimate.filters.offset_kernels import Drift, drift_variance, no_drift
from cellwise.estimate.sensing_kernels import SensorMonitor, first_watch
from cellwise.typing import BoolArray, FloatArray, IntArray


class EkfStart(NamedTuple):
    """Where a state begins, and is re-initialised when it is no longer finite."""

    soc: float
    variance: float
    hysteresis_variance: float
    temperature_C: float  # where nobody measured


class EkfState(NamedTuple):
    """What must be carried: the cell, P, how the model has done, the sensors' past.

    ``p`` is the upper triangle of the covariance, ``watch`` the sensors' last readings and how long
    each has been missing. ``rejections`` counts voltages rejected in a row, those under load less;
    ``mismatch`` is the running mean of the squared innovations over the variance that the model
    alone explains; ``persistent`` is what a persistent error of the model may have brought into the
    SOC, one standard deviation; ``contradicted`` the SOC that the voltages have lately said is
    missing; ``drift`` what a current that is off would have moved, and how far that is believed.
    """

    cell: CellState
    p: Covariance
    rejections: float
    mismatch: float
    persistent: float
    contradicted: float
    drift: Drift
    watch: SensorMonitor

    @property
    def soc(self) -> float:
        """State of charge."""
        return self.cell.soc

    @property
    def current_A(self) -> float:
        """The last valid current [A]."""
        return self.watch.current_A

    @property
    def soc_std(self) -> float:
        """Standard deviation of the state of charge."""
        known = self.p.ss + drift_variance(self.drift)
        return stated_deviation(known, self.mismatch, self.persistent, self.contradicted)

    def row(self) -> FloatArray:
        """Its numbers in order, shape (numbers,): what the compiled step takes."""
        # fmt: off
        return np.array((
            *self.cell, *self.p, self.rejections, self.mismatch, self.persistent,
            self.contradicted, *self.drift, *self.watch,
        ))
        # fmt: on

    @classmethod
    def of_row(cls, row: FloatArray) -> EkfState:
        """The state whose numbers these are."""
        v = row.tolist()
        # fmt: off
        return cls._make((
            CellState._make(v[:P_AT]), Covariance._make(v[P_AT:COUNTS_AT]),
            *v[COUNTS_AT:DRIFT_AT], Drift._make(v[DRIFT_AT:WATCH_AT]),
            SensorMonitor._make(v[WATCH_AT:]),
        ))
        # fmt: on


# Where its records begin in such a row.
P_AT = len(CellState._fields)
COUNTS_AT = P_AT + len(Covariance._fields)
DRIFT_AT = COUNTS_AT + 4
WATCH_AT = DRIFT_AT + len(Drift._fields)


class EkfInfo(NamedTuple):
    """What may be looked at after a step.

    ``soc`` and ``soc_std`` are the estimate and its deviation. ``voltage_V`` is predicted before
    the sample's own voltage is used; ``innovation_V`` is measured minus predicted,
    ``innovation_variance_V2`` its variance for one sample; ``test_ratio`` above 1 means that the
    gate rejected it; ``status`` are the bits of :class:`cellwise.estimate.status.Status`.
    """

    soc: float
    soc_std: float
    voltage_V: float
    innovation_V: float
    innovation_variance_V2: float
    test_ratio: float
    status: int


class LogArrays(NamedTuple):
    """The rows of a log as a filter reads them, shape (rows,) each."""

    current_A: FloatArray
    voltage_V: FloatArray
    temperature_C: FloatArray
    dt_s: FloatArray
    gap: BoolArray


class TraceArrays(NamedTuple):
    """What a filter writes: ``values`` of shape (OUTPUTS, rows), ``status`` (rows,)."""

    values: FloatArray
    status: IntArray


# Rows of ``values``: the fields of EkfInfo but the status.
OUT_SOC, OUT_STD, OUT_VOLTAGE, OUT_INNOVATION, OUT_VARIANCE, OUT_RATIO = range(6)
OUTPUTS = 6
# Of the adaptive filter behind them: mean and deviation of each number, probabilities, whether the
# load moves enough to show a resistance, variance of the SOC.
OUT_OFFSET, OUT_OFFSET_STD, OUT_CHARGE, OUT_CHARGE_STD = range(OUTPUTS, OUTPUTS + 4)
OUT_RESISTANCE, OUT_RESISTANCE_STD = range(OUTPUTS + 4, OUTPUTS + 6)
OUT_OFFSET_FREE, OUT_CHARGE_FREE, OUT_MOVES, OUT_SOC_VARIANCE = range(OUTPUTS + 6, OUTPUTS + 10)
ADAPTIVE_OUTPUTS = OUTPUTS + 10


@kernel
def ekf_start(start: EkfStart, current_A: float) -> EkfState:
    """A cell known as ``start`` says; its branches are guessed at the first sample."""
    h = 1.0 if start.soc > 0.5 else -1.0
    p = uncorrelated(start.variance, no_branches(), start.hysteresis_variance)
    cell, watch = at_rest(start.soc, h), first_watch(current_A)
    return EkfState(cell, p, 0.0, 1.0, 0.0, 0.0, no_drift(), watch)
