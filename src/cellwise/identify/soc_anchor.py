"""Where on the SOC axis a log begins: by its rests on the OCV, full or empty where it says so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwise.cell.initial_soc.initial_soc import STATED_STD
from cellwise.errors import InputError
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.ocv.ocv_rests import find_ocv_rests
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray

FULL_FROM = 0.97  # a log that seems to begin above this begins full: charging does not stop at 98 %
EMPTY_TO = 0.02
OCV_ERROR_V = 0.005
CAPACITY_ERROR = 0.03
LATER_RESTS = 2.0
LARGEST_ASSUMED = 0.1
PLAUSIBLE = 2.0  # standard deviations within which a log may still have begun full
REST_SHARE = 0.01  # below C/100 a cell counts as resting
FIRST_S = 60.0
LIKELY_FULL = 0.8  # a capacity test that begins above it begins full
REST_MOVES = 0.01  # of the capacity: what a test may move before its discharge begins
FULL_STD = 0.01


@dataclass(frozen=True)
class SocAnchor:
    """SOC at a log's first row, its standard deviation, and how it was found."""

    soc: float
    std: float
    how: str


def anchor_soc(
    log: CellLog,
    ocv: OcvCurve,
    capacity_Ah: float,
    resistance_ohm: float,
) -> SocAnchor:
    """SOC at the first row: as stated of the log, else what fits the rests of the whole log best.

    Every rest says where the log stood on the OCV, the counter says how far that is from the
    start; on a steep OCV a rest counts more than on a flat one. Without a rest, the first minute
    under load counts with its ohmic drop taken out.

    Parameters
    ----------
    ocv : OcvCurve            a gap between its branches widens what a rest may read
    capacity_Ah : float       that SOC refers to
    resistance_ohm : float    rough resistance of the cell, for a start under load

    Raises
    ------
    InputError        a log without a single voltage
    """
    if log.soc0 is not None:
        return SocAnchor(log.soc0, STATED_STD, "stated")
    grid = np.linspace(0.0, 1.0, 1001)
    level = np.maximum.accumulate(ocv.function.evaluate(grid))
    half = _half_gap(ocv, grid)
    slope = np.gradient(level, grid)
    charge, voltage, error, how = _evidence(log, capacity_Ah, resistance_ohm)
    voltage = np.clip(voltage, level[0], level[-1])  # beyond an end that end is meant
    cost = np.zeros(grid.size)
    # Later rests share one capacity and one OCV, and are wrong together: they count as two.
    later = np.abs(charge) > 1e-3 * capacity_Ah
    share = np.where(later, min(1.0, LATER_RESTS / max(int(later.sum()), 1)), 1.0)
    for q, v, e, w in zip(charge, voltage, error, share, strict=True):
        at = grid - q / capacity_Ah
        expected = np.interp(at, grid, level)
        wide = np.hypot(e, np.interp(at, grid, half))
        # The further from the start, the more a capacity of another temperature or age matters.
        wide = np.hypot(wide, np.interp(at, grid, slope) * CAPACITY_ERROR * abs(q) / capacity_Ah)
        outside = np.maximum(0.0, np.maximum(at - 1.0, -at))  # beyond full or empty is unlikely
        cost += w * np.minimum(((v - expected) / wide) ** 2, 25.0) + (outside / 0.01) ** 2
    weight = np.exp(-0.5 * (cost - cost.min()))
    mean = float(np.average(grid, weights=weight))
    std = float(np.sqrt(np.average((grid - mean) ** 2, weights=weight)))
    reached = mean - float(np.min(log.counted_charge_Ah())) / capacity_Ah
    if mean >= FULL_FROM or mean + PLAUSIBLE * std >= 1.0:
        # Nothing speaks against full, and that is how tests begin; a voltage that says nothing at
        # all is no reason to believe it.
        sure = 0.01 if std <= LARGEST_ASSUMED else std
        return SocAnchor(1.0, min(max(std, 0.005), sure), f"{how}: full")
    if reached >= FULL_FROM and reached <= 1.0 + 2 * max(std, 0.01):
        full = 1.0 + float(np.min(log.counted_charge_Ah())) / capacity_Ah
        return SocAnchor(min(max(full, 0.0), 1.0), max(std, 0.005), f"{how}: charged full later")
    if mean <= EMPTY_TO:
        return SocAnchor(0.0, max(std, 0.005), f"{how}: empty")
    return SocAnchor(mean, max(std, 0.002), how)


def full_before(
    log: CellLog, discharge: BoolArray, capacity_Ah: float, anchor: SocAnchor
) -> SocAnchor:
    """The start of a test that begins full: what SOC means is that its discharge begins at 1.

    Parameters
    ----------
    discharge : (n,) bool     rows of its discharge
    anchor : SocAnchor        where it would begin by its voltages
    """
    before = float(log.counted_charge_Ah()[int(np.argmax(discharge))]) / capacity_Ah
    if anchor.soc < LIKELY_FULL or abs(before) > REST_MOVES:
        return anchor
    return SocAnchor(1.0, min(anchor.std, FULL_STD), "a test of the capacity: full")


def _half_gap(ocv: OcvCurve, grid: FloatArray) -> FloatArray:
    """Half the gap between the low-rate branches where both are known, else zero [V]."""
    gap = ocv.gap_V
    if gap is None or not np.any(np.isfinite(gap)):
        return np.zeros(grid.size)
    known = np.isfinite(gap)
    return np.asarray(0.5 * np.abs(np.interp(grid, ocv.soc[known], gap[known])))


def _evidence(
    log: CellLog, capacity_Ah: float, resistance_ohm: float
) -> tuple[FloatArray, FloatArray, FloatArray, str]:
    """Charge since the start, voltage at rest and its error, of every rest worth using."""
    current = log.known_current_A()
    charge = log.counted_charge_Ah()
    finite = np.isfinite(log.voltage_V)
    if not finite.any():
        raise InputError(
            f"no voltage in log '{log.name}'", "measured voltages", "Check the column."
        )
    try:
        rests = [r for r in find_ocv_rests(log, min_rest_s=600.0) if r.duration_s >= 600.0]
    except InputError:
        rests = []
    found = [(r.charge_Ah, r.final_V, OCV_ERROR_V + 0.5 * abs(r.remaining_V)) for r in rests]
    first = int(np.flatnonzero(finite)[0])
    if abs(current[first]) < REST_SHARE * capacity_Ah:
        found.append((float(charge[first]), float(log.voltage_V[first]), 2 * OCV_ERROR_V))
    if found:
        q, v, e = np.array(found).T
        return q, v, e, f"{len(found)} rest(s) on the OCV"
    head = finite & (log.time_s <= log.time_s[0] + FIRST_S)
    lifted = log.voltage_V[head] + resistance_ohm * current[head]
    drop = resistance_ohm * float(np.mean(np.abs(current[head])))
    return (
        np.array([float(np.mean(charge[head]))]),
        np.array([float(np.mean(lifted))]),
        # In the cold the drop after seconds is several times the one after milliseconds.
        np.array([2 * OCV_ERROR_V + 1.5 * drop]),
        "first minute under load",
    )
