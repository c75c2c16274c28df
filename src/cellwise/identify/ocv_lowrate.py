"""Open-circuit voltage from low-rate discharge and charge: both branches kept, their gap a result.

A branch carries the polarisation of its small current and, in LFP above all, half of the
hysteresis. The mean of both is free of what is symmetric, so it is taken where both branches are
whole. A charge that was cut short would tilt it: such a branch is kept, named, and not averaged in.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.half_cycles import (
    HalfCycle,
    Trace,
    find_half_cycles,
    join_logs,
    settled_end,
    steady_rows,
)
from cellwise.identify.ocv import GRID_INTERVALS, OcvCurve, curve_from_points
from cellwise.identify.ocv_functions import OcvKind
from cellwise.identify.ocv_spline import fit_monotone_spline
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray

Use = Literal["auto", "mean", "discharge", "charge"]

# 1/h of the branch's own charge: slower is a low rate; up to the second it is taken with a notice.
LOW_RATE, FASTEST_RATE = 1.0 / 9.0, 1.0 / 1.8
# A whole charge brings back this much of what the discharge took, counter errors included.
WHOLE_CHARGE = (0.95, 1.10)
# Part of the SOC range that a branch must cover to be averaged.
WHOLE_COVER = 0.75
# Part of the SOC range where the gap is what it is, and how much wider it may grow at the ends.
MIDDLE = (0.25, 0.75)
END_GAP = 1.3
OUTSIDE = 0.02
LIMIT_TOLERANCE_V = 0.01

Moved = tuple[HalfCycle, float]


class Branch(NamedTuple):
    """One low-rate half cycle over SOC.

    soc, voltage_V : (n,) rows at the constant current, by rising SOC
    grid_V : (m,) smoothed, on the uniform grid; nan where not measured
    moved_Ah : charge of the whole half cycle, positive
    rate : current over that charge [1/h]
    whole : goes from one end to the other and covers enough at the low rate
    """

    soc: FloatArray
    voltage_V: FloatArray
    grid_V: FloatArray
    moved_Ah: float
    rate: float
    whole: bool


def ocv_from_low_rate(
    logs: CellLog | Sequence[CellLog],
    *,
    capacity_Ah: float | None = None,
    resistance_ohm: float = 0.0,
    use: Use = "auto",
    kind: OcvKind | None = None,
) -> OcvCurve:
    """OCV curve from C/20 to C/30 (at most C/2) discharge, charge, or both.

    Parameters
    ----------
    logs : CellLog, or several that follow one another     discharge, its last per cent at another
                               temperature, charge, its last per cent: any of them may be missing
    capacity_Ah : float        that SOC refers to [Ah], counted from full; default what the
                               discharge took, so that 0 and 1 are its own ends
    resistance_ohm : float     takes current times this out of each branch [ohm]
    use : str                  ``auto``: the mean of the branches where both are whole, else the
                               discharge branch, else the charge branch
    kind : str                 form of the function, default the spline

    Raises
    ------
    InputError                 no low-rate half cycle, or not the branch that was asked for
    """
    trace = join_logs(logs)
    name = _names(logs)
    halves = find_half_cycles(trace)
    discharge_half, charge_half = _slowest_pair(trace, halves, name)
    capacity = capacity_Ah or next(h[1] for h in (discharge_half, charge_half) if h is not None)
    discharge = charge = None
    empty, taken = 0.0, None
    if discharge_half is not None:
        half, taken = discharge_half
        discharge = _discharge_branch(trace, half, taken, capacity, resistance_ohm)
        empty = 1.0 - taken / capacity
    if charge_half is not None:
        half, moved = charge_half
        charge = _charge_branch(trace, half, moved, capacity, taken, empty, resistance_ohm)
    soc, level, chosen = _choose(discharge, charge, use, name)
    temperature = trace.temperature_C[np.isfinite(trace.temperature_C)]
    return curve_from_points(
        soc,
        level,
        capacity_Ah=capacity,
        kind=kind,
        discharge_V=None if discharge is None else discharge.grid_V,
        charge_V=None if charge is None else charge.grid_V,
        source=f"{chosen} of {name}",
        notes=_notes(discharge, charge),
        temperature_C=float(np.median(temperature)) if temperature.size else None,
    )


def _slowest_pair(
    trace: Trace, halves: tuple[HalfCycle, ...], name: str
) -> tuple[Moved | None, Moved | None]:
    """The slowest discharge and charge with what they moved; of several alike the largest."""
    rated = []
    for k, half in enumerate(halves):
        begin = max(half.steady_start - 1, 0)
        moved = float(trace.charge_Ah[settled_end(trace, halves, k)] - trace.charge_Ah[begin])
        if abs(half.main_current_A) <= FASTEST_RATE * abs(moved):
            rated.append((abs(half.main_current_A / moved), moved, half))

    def slowest(sign: int) -> Moved | None:
        mine = [r for r in rated if r[1] * sign > 0.0]
        slow = [(abs(moved), half) for rate, moved, half in mine if rate <= 1.3 * min(mine)[0]]
        if not slow:
            return None
        moved, half = max(slow, key=lambda pair: pair[0])
        return half, moved

    discharge, charge = slowest(+1), slowest(-1)
    if discharge is None and charge is None:
        raise InputError(
            f"no discharge or charge slower than C/2 in {name}",
            "a discharge or charge at C/20 or slower over the whole range",
            "Use a low-rate log, or an HPPC log through its rests.",
        )
    return discharge, charge


def _discharge_branch(
    trace: Trace, half: HalfCycle, moved: float, capacity_Ah: float, resistance_ohm: float
) -> Branch:
    begin = max(half.steady_start - 1, 0)
    rows = _rows(trace, half)
    soc = 1.0 - (trace.charge_Ah[rows] - trace.charge_Ah[begin]) / capacity_Ah
    return _branch(trace, half, rows, soc, moved, resistance_ohm)


def _charge_branch(
    trace: Trace,
    half: HalfCycle,
    moved: float,
    capacity_Ah: float,
    discharged_Ah: float | None,
    empty: float,
    resistance_ohm: float,
) -> Branch:
    """The charge branch. A whole one is laid from empty to full by its own charge.

    The counters of charge and discharge differ (coulombic efficiency, counter gains): between
    two states that are known, the branch's own count is the better scale.
    """
    begin = max(half.steady_start - 1, 0)
    rows = _rows(trace, half)
    back = trace.charge_Ah[begin] - trace.charge_Ah[rows]
    top = np.max(trace.voltage_V[half.start : half.stop])
    ratio = 1.0 if discharged_Ah is None else moved / discharged_Ah
    whole = bool(
        top >= np.max(trace.voltage_V) - LIMIT_TOLERANCE_V
        and WHOLE_CHARGE[0] <= ratio <= WHOLE_CHARGE[1]
    )
    scale = (1.0 - empty) / moved if whole else 1.0 / capacity_Ah
    branch = _branch(trace, half, rows, empty + back * scale, moved, resistance_ohm)
    return branch._replace(whole=whole and branch.whole)


def _branch(
    trace: Trace,
    half: HalfCycle,
    rows: BoolArray,
    soc: FloatArray,
    moved: float,
    resistance_ohm: float,
) -> Branch:
    level = trace.voltage_V[rows] + resistance_ohm * trace.current_A[rows]
    inside = (soc >= -OUTSIDE) & (soc <= 1.0 + OUTSIDE)
    order = np.argsort(soc[inside], kind="stable")
    s, v = soc[inside][order], level[inside][order]
    grid = np.linspace(0.0, 1.0, GRID_INTERVALS + 1)
    smooth = fit_monotone_spline(s, v).evaluate(grid)
    near = 0.5 / GRID_INTERVALS
    smooth[(grid < s[0] - near) | (grid > s[-1] + near)] = np.nan
    return Branch(
        soc=s,
        voltage_V=v,
        grid_V=smooth,
        moved_Ah=moved,
        rate=abs(half.main_current_A) / moved,
        whole=bool(min(s[-1], 1.0) - max(s[0], 0.0) >= WHOLE_COVER),
    )


def _rows(trace: Trace, half: HalfCycle) -> BoolArray:
    """Rows of the trace at the low current, in the log in which it began."""
    rows = np.zeros(trace.charge_Ah.size, dtype=np.bool_)
    rows[half.start : half.stop] = steady_rows(trace, half)
    rows[half.steady_stop :] = False
    rows[: half.steady_start] = False
    rows[trace.log != trace.log[half.steady_start]] = False
    return rows


def _choose(
    discharge: Branch | None, charge: Branch | None, use: Use, name: str
) -> tuple[FloatArray, FloatArray, str]:
    if discharge is not None and charge is not None:
        if use == "mean" or (use == "auto" and discharge.whole and charge.whole):
            grid = np.linspace(0.0, 1.0, GRID_INTERVALS + 1)
            return grid, _mean_of_branches(discharge.grid_V, charge.grid_V), "mean of both branches"
    elif use == "mean":
        raise InputError(
            f"one low-rate branch only in {name}",
            "a discharge and a charge branch for their mean",
            "Add the other log, or use the branch that there is.",
        )
    wanted: list[tuple[str, Branch | None]] = [
        ("discharge branch", discharge if use != "charge" else None),
        ("charge branch", charge if use != "discharge" else None),
    ]
    for label, branch in wanted:
        if branch is not None:
            return branch.soc, branch.voltage_V, label
    raise InputError(
        f"no {use} branch in {name}", f"a low-rate {use}", "Add the log, or use the other branch."
    )


def _mean_of_branches(discharge_V: FloatArray, charge_V: FloatArray) -> FloatArray:
    """Mean of the branches, save where one of them bends off towards the end of its own test.

    There the gap is no longer hysteresis and ohmic drop: it is the approach to the limit. Below
    the middle of the SOC range the charge branch, above it the discharge branch, starts from rest
    and is the sound one: it is moved by half the gap of the middle. (Plett, Battery Management
    Systems vol. 1, 2015, section 2.9 takes the branches so too, with the gap at 50 % SOC.)
    """
    soc = np.linspace(0.0, 1.0, discharge_V.size)
    half = 0.5 * (charge_V - discharge_V)
    middle = (soc > MIDDLE[0]) & (soc < MIDDLE[1]) & np.isfinite(half)
    usual = float(np.median(half[middle])) if middle.any() else float(np.nanmedian(half))
    half = np.where(np.isfinite(half), np.minimum(half, END_GAP * usual), END_GAP * usual)
    share = np.clip((soc - MIDDLE[0]) / (MIDDLE[1] - MIDDLE[0]), 0.0, 1.0)
    share = np.where(np.isfinite(charge_V), share, 1.0)
    share = np.where(np.isfinite(discharge_V), share, 0.0)
    from_discharge = np.where(np.isfinite(discharge_V), discharge_V, 0.0) + half
    from_charge = np.where(np.isfinite(charge_V), charge_V, 0.0) - half
    return share * from_discharge + (1.0 - share) * from_charge


def _notes(discharge: Branch | None, charge: Branch | None) -> tuple[str, ...]:
    notes = []
    for label, branch in (("discharge", discharge), ("charge", charge)):
        if branch is not None:
            notes.append(
                f"{label} branch: {branch.moved_Ah:.4f} Ah at C/{1.0 / branch.rate:.1f},"
                f" SOC {branch.soc[0]:.3f} to {branch.soc[-1]:.3f}"
            )
            if branch.rate > LOW_RATE:
                notes.append(f"{label} branch is faster than C/10: it carries much polarisation")
    if discharge is not None and charge is not None:
        if charge.whole and discharge.whole:
            gap = 1e3 * np.nanmedian(charge.grid_V - discharge.grid_V)
            notes.append(f"gap between the branches: {gap:.1f} mV median")
        elif not charge.whole:
            notes.append(
                f"charge branch incomplete: {charge.moved_Ah:.4f} of {discharge.moved_Ah:.4f} Ah"
                " came back before the limit; not averaged in"
            )
    return tuple(notes)


def _names(logs: CellLog | Sequence[CellLog]) -> str:
    parts = [logs] if isinstance(logs, CellLog) else list(logs)
    return " + ".join(part.name or part.source or "a log" for part in parts) or "no log"
