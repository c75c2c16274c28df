"""A log made ready for refinement: few rows, known SOC, splines laid out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwise.cell.equations import ZERO_CELSIUS_K
from cellwise.errors import InputError
from cellwise.identify.refinement.refine_kernels import choose_rows
from cellwise.identify.refinement.splines import SplineRows, spline_rows
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray

EDGE_SHARE = 0.005  # of the largest current: smaller changes are noise
SHORTEST_S = 0.95
GROWTH = 0.03


@dataclass(frozen=True, eq=False)
class RefineLog:
    """One log for refinement.

    ``soc`` is known at every row (the tester's counter over the capacity, from a known start);
    ``skewed`` logs share the fitted skew between current and voltage; ``h0`` is the hysteresis
    state at the first row.
    """

    log: CellLog
    soc: FloatArray
    skewed: bool = False
    h0: float = 1.0
    weight: float = 1.0


@dataclass(frozen=True, eq=False)
class PreparedLog:
    """What the kernel reads: merged rows; ``error``-relevant arrays cover compared rows only."""

    name: str
    dt_s: FloatArray
    current_A: FloatArray
    inverse_K: FloatArray
    rows: SplineRows
    ocv_rows: SplineRows
    soc: FloatArray
    evaluate: BoolArray
    measured_V: FloatArray
    time_s: FloatArray
    skewed: bool
    h0: float
    weight: float

    @property
    def compared(self) -> int:
        """Number of rows that are compared with the measurement."""
        return int(self.measured_V.size)


def prepare_log(
    item: RefineLog,
    knots: FloatArray,
    ocv_knots: FloatArray,
    reference_C: float,
    soc_low: float = 0.0,
) -> PreparedLog:
    """Merge rows of equal current, choose the rows to compare, lay out the splines.

    Raises
    ------
    InputError        no voltage to compare with
    """
    log = item.log
    current = log.known_current_A()
    n = len(log)
    keep = np.zeros(n, dtype=np.bool_)
    evaluate = np.zeros(n, dtype=np.bool_)
    threshold = EDGE_SHARE * float(np.max(np.abs(current)))
    choose_rows(log.time_s, current, threshold, SHORTEST_S, GROWTH, keep, evaluate)
    gaps = log.gap_rows
    keep |= gaps
    keep[:-1] |= gaps[1:]
    evaluate &= np.isfinite(log.voltage_V) & np.isfinite(item.soc) & (item.soc >= soc_low)
    if not evaluate.any():
        raise InputError(
            f"no row with a voltage above SOC {soc_low:g} in log '{log.name}'",
            "at least some measured voltages in the SOC range of the model",
            "Leave the log out, or check where its SOC starts.",
        )
    kept = np.flatnonzero(keep)
    time_s = log.time_s[kept]
    dt = np.diff(time_s, prepend=time_s[0])
    moved = np.cumsum(current * log.interval_s)[kept]
    merged = np.diff(moved, prepend=moved[0])
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(dt > 0, merged / dt, current[kept])
    soc = np.interp(
        np.arange(n), np.flatnonzero(np.isfinite(item.soc)), item.soc[np.isfinite(item.soc)]
    )
    soc = soc[kept]
    shown = evaluate[kept]
    return PreparedLog(
        name=log.name,
        dt_s=dt,
        current_A=mean,
        inverse_K=_inverse_kelvin(log, reference_C)[kept],
        rows=spline_rows(soc, knots),
        ocv_rows=spline_rows(soc, ocv_knots),
        soc=soc,
        evaluate=shown,
        measured_V=log.voltage_V[kept][shown],
        time_s=time_s[shown],
        skewed=item.skewed,
        h0=item.h0,
        weight=item.weight,
    )


def _inverse_kelvin(log: CellLog, reference_C: float) -> FloatArray:
    """1/T - 1/T_ref of every row [1/K]; zero where it was not measured."""
    if log.temperature_C is None:
        return np.zeros(len(log))
    measured = log.temperature_C
    good = np.isfinite(measured)
    if not good.any():
        return np.zeros(len(log))
    held = np.interp(np.arange(len(log)), np.flatnonzero(good), measured[good])
    return np.asarray(1.0 / (held + ZERO_CELSIUS_K) - 1.0 / (reference_C + ZERO_CELSIUS_K))
