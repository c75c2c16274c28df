"""Open-circuit voltage from low-rate discharge and charge: both branches kept, their gap a result.

A branch carries the polarisation of its small current and, in LFP above all, half of the
hysteresis. The mean of both is free of what is symmetric, so it is taken where both branches are
whole. A charge that was cut short would tilt it: such a branch is kept, named, and not averaged in.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.capacity.half_cycles import (
    HalfCycle,
    Trace,
    find_half_cycles,
    join_logs,
    looks_like_end,
    settled_end,
    steady_rows,
)
from cellwise.identify.ocv.curve import GRID_INTERVALS, OcvCurve, curve_from_points
from cellwise.identify.ocv.ocv_function import fit_monotone_spline
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray


class _Limits(NamedTuple):
    """What makes a branch whole, and two branches fit for a mean."""

    low_rate: float = 1.0 / 9.0  # [1/h] of the branch's own charge: faster is said
    fastest_rate: float = 1.0 / 1.8  # [1/h]: faster is no low rate
    cover: float = 0.75  # of the SOC range that a branch must cover
    # A whole charge brings back this much of what the discharge took, counter errors included;
    # nearly all is whole whatever voltage its last row shows.
    least_back: float = 0.95
    nearly_all: float = 0.99
    most_back: float = 1.10
    at_limit_V: float = 0.01
    alike_rate: float = 2.0  # factor between the rates of branches that are averaged
    # Between these parts of the SOC range the gap is what it is; towards the ends it may grow by
    # the factor that follows.
    middle: tuple[float, float] = (0.25, 0.75)
    end_gap: float = 1.3
    rested_s: float = 600.0  # a voltage after so long without current gives the SOC
    no_current: float = 0.02  # of the main current
    outside: float = 0.02  # of the SOC range: rows beyond the ends that are still taken


LIMITS = _Limits()


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


class _Moved(NamedTuple):
    """A half cycle, the charge it moved until it settled [Ah, positive], the row where it had."""

    half: HalfCycle
    charge_Ah: float
    end: int


def ocv_from_low_rate(
    logs: CellLog | Sequence[CellLog], *, capacity_Ah: float | None = None
) -> OcvCurve:
    """OCV curve from C/20 to C/30 (at most C/2) discharge, charge, or both.

    The mean of the branches where both are whole, else the discharge branch, else the charge one.

    Parameters
    ----------
    logs : CellLog, or several that follow one another     discharge, its last per cent at another
                               temperature, charge, its last per cent: any of them may be missing
    capacity_Ah : float        that SOC refers to [Ah], counted from full; default what the
                               discharge took, so that 0 and 1 are its own ends

    Raises
    ------
    InputError                 no low-rate half cycle
    """
    trace = join_logs(logs)
    name = _names(logs)
    halves = find_half_cycles(trace)
    taken, returned = _slowest_pair(trace, halves, name)
    capacity = capacity_Ah or next(m.charge_Ah for m in (taken, returned) if m is not None)
    discharge = charge = None
    if taken is not None:
        discharge = _discharge_branch(trace, taken, capacity)
    if returned is not None:
        charge = _charge_branch(trace, returned, taken, discharge, capacity)
    soc, level, chosen = _choose(discharge, charge)
    cut_short: tuple[str, ...] = ()
    if taken is not None and capacity_Ah is None and not _ends(trace, taken.half):
        cut_short = ("the discharge does not look as if it reached its limit: give capacity_Ah",)
    temperature = trace.temperature_C[np.isfinite(trace.temperature_C)]
    return curve_from_points(
        soc,
        level,
        capacity_Ah=capacity,
        discharge_V=None if discharge is None else discharge.grid_V,
        charge_V=None if charge is None else charge.grid_V,
        source=f"{chosen} of {name}",
        notes=(*_notes(discharge, charge), *cut_short),
        temperature_C=float(np.median(temperature)) if temperature.size else None,
    )


def _slowest_pair(
    trace: Trace, halves: tuple[HalfCycle, ...], name: str
) -> tuple[_Moved | None, _Moved | None]:
    """The slowest discharge and charge; of several alike the one that moved most."""
    found: dict[bool, list[_Moved]] = {True: [], False: []}
    for k, half in enumerate(halves):
        end = settled_end(trace, halves, k)
        moved = abs(float(trace.charge_Ah[end] - trace.charge_Ah[_begin(half)]))
        if abs(half.main_current_A) <= LIMITS.fastest_rate * moved:
            found[half.charge_Ah > 0.0].append(_Moved(half, moved, end))

    def slowest(among: list[_Moved]) -> _Moved | None:
        if not among:
            return None
        rates = [abs(m.half.main_current_A) / m.charge_Ah for m in among]
        slow = [m for m, rate in zip(among, rates, strict=True) if rate <= 1.3 * min(rates)]
        return max(slow, key=lambda m: m.charge_Ah)

    if not found[True] and not found[False]:
        raise InputError(
            f"no discharge or charge slower than C/2 in {name}",
            "a discharge or charge at C/20 or slower over the whole range",
            "Use a low-rate log, or an HPPC log through its rests.",
        )
    return slowest(found[True]), slowest(found[False])


def _discharge_branch(trace: Trace, taken: _Moved, capacity_Ah: float) -> Branch:
    rows = _rows(trace, taken.half)
    soc = 1.0 - (trace.charge_Ah[rows] - trace.charge_Ah[_begin(taken.half)]) / capacity_Ah
    return _branch(trace, taken, rows, soc)


def _charge_branch(
    trace: Trace,
    returned: _Moved,
    taken: _Moved | None,
    discharge: Branch | None,
    capacity_Ah: float,
) -> Branch:
    """The charge branch. A whole one is laid from empty to full by its own charge.

    The counters of charge and discharge differ (coulombic efficiency, counter gains): between
    two states that are known, the branch's own count is the better scale.
    """
    half = returned.half
    rows = _rows(trace, half)
    back = trace.charge_Ah[_begin(half)] - trace.charge_Ah[rows]
    top = float(np.max(trace.voltage_V[half.start : half.stop]))
    whole = top >= float(np.max(trace.voltage_V)) - LIMITS.at_limit_V
    empty, full = 0.0, 1.0
    if taken is not None and discharge is not None:
        ratio = returned.charge_Ah / taken.charge_Ah
        whole = whole or ratio >= LIMITS.nearly_all
        whole = whole and LIMITS.least_back <= ratio <= LIMITS.most_back
        empty = 1.0 - taken.charge_Ah / capacity_Ah
        full = 1.0 - (1.0 - _filled_to(trace, returned, taken, discharge, ratio)) * (1.0 - empty)
    scale = (full - empty) / returned.charge_Ah if whole else 1.0 / capacity_Ah
    branch = _branch(trace, returned, rows, empty + back * scale)
    alike = (
        discharge is None
        or 1.0 / LIMITS.alike_rate <= branch.rate / discharge.rate <= LIMITS.alike_rate
    )
    return branch._replace(whole=whole and alike and branch.whole)


def _filled_to(
    trace: Trace, returned: _Moved, taken: _Moved, discharge: Branch, ratio: float
) -> float:
    """How full a charge left the cell; 1 is the state in which the discharge began.

    By the count, which coulombic losses only lower and which cannot make the cell fuller than full;
    and by the voltages at rest after the one and before the other, laid on the discharge branch,
    which bends down too steeply at its onset. The larger is nearer in both cases.
    """
    if returned.end < taken.half.steady_start:
        return 1.0
    counted = min(ratio, 1.0)
    before, after = _begin(taken.half), returned.end
    rested = np.abs(trace.current_A) <= LIMITS.no_current * abs(returned.half.main_current_A)
    moving = np.flatnonzero(~rested[: after + 1])
    rest_s = float(np.sum(trace.interval_s[moving[-1] + 1 : after + 1])) if moving.size else 0.0
    if rest_s < LIMITS.rested_s or not rested[before]:
        return counted
    known = np.isfinite(discharge.grid_V)
    grid, level = np.linspace(0.0, 1.0, GRID_INTERVALS + 1)[known], discharge.grid_V[known]
    missing_V = float(trace.voltage_V[before] - trace.voltage_V[after])
    short = grid[-1] - float(np.interp(level[-1] - missing_V, level, grid))
    return float(np.clip(1.0 - short, counted, 1.0))


def _ends(trace: Trace, half: HalfCycle) -> bool:
    return looks_like_end(trace, half.steady_start, half.steady_stop)


def _begin(half: HalfCycle) -> int:
    """Last row before the main current flows."""
    return max(half.steady_start - 1, 0)


def _branch(trace: Trace, moved: _Moved, rows: BoolArray, soc: FloatArray) -> Branch:
    level = trace.voltage_V[rows]
    inside = (soc >= -LIMITS.outside) & (soc <= 1.0 + LIMITS.outside)
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
        moved_Ah=moved.charge_Ah,
        rate=abs(moved.half.main_current_A) / moved.charge_Ah,
        whole=bool(min(s[-1], 1.0) - max(s[0], 0.0) >= LIMITS.cover),
    )


def _cover(branch: Branch) -> float:
    """Part of the SOC range in which a branch has rows at the low current."""
    return float(min(branch.soc[-1], 1.0) - max(branch.soc[0], 0.0))


def _rows(trace: Trace, half: HalfCycle) -> BoolArray:
    """Rows of the trace at the low current, in the log in which it began."""
    rows = np.zeros(trace.charge_Ah.size, dtype=np.bool_)
    rows[half.start : half.stop] = steady_rows(trace, half)
    rows[half.steady_stop :] = False
    rows[: half.steady_start] = False
    rows[trace.log != trace.log[half.steady_start]] = False
    return rows


def _choose(discharge: Branch | None, charge: Branch | None) -> tuple[FloatArray, FloatArray, str]:
    """SOC, voltage and name of what is taken for the OCV; one branch there is."""
    if discharge is not None and charge is not None and discharge.whole and charge.whole:
        grid = np.linspace(0.0, 1.0, GRID_INTERVALS + 1)
        return grid, _mean_of_branches(discharge.grid_V, charge.grid_V), "mean of both branches"
    if discharge is not None:
        return discharge.soc, discharge.voltage_V, "discharge branch"
    if charge is None:  # a half cycle was found, in one direction or the other
        raise AssertionError
    return charge.soc, charge.voltage_V, "charge branch"


def _mean_of_branches(discharge_V: FloatArray, charge_V: FloatArray) -> FloatArray:
    """Mean of the branches, save where one of them bends off towards the end of its own test.

    There the gap is no longer hysteresis and ohmic drop: it is the approach to the limit. Below
    the middle of the SOC range the charge branch, above it the discharge branch, starts from rest
    and is the sound one: it is moved by half the gap of the middle. (Plett, Battery Management
    Systems vol. 1, 2015, section 2.9 takes the branches so too, with the gap at 50 % SOC.)
    """
    soc = np.linspace(0.0, 1.0, discharge_V.size)
    half = 0.5 * (charge_V - discharge_V)
    middle = (soc > LIMITS.middle[0]) & (soc < LIMITS.middle[1]) & np.isfinite(half)
    usual = float(np.median(half[middle])) if middle.any() else float(np.nanmedian(half))
    half = np.where(
        np.isfinite(half), np.minimum(half, LIMITS.end_gap * usual), LIMITS.end_gap * usual
    )
    share = np.clip((soc - LIMITS.middle[0]) / (LIMITS.middle[1] - LIMITS.middle[0]), 0.0, 1.0)
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
            if branch.rate > LIMITS.low_rate:
                notes.append(f"{label} branch is faster than C/10: it carries much polarisation")
    if discharge is not None and charge is not None:
        if charge.whole and discharge.whole:
            gap = 1e3 * np.nanmedian(charge.grid_V - discharge.grid_V)
            notes.append(f"gap between the branches: {gap:.1f} mV median")
        elif not 1.0 / LIMITS.alike_rate <= charge.rate / discharge.rate <= LIMITS.alike_rate:
            notes.append("charge branch at another rate than the discharge: not averaged in")
        else:
            notes.append(
                f"incomplete: charge brought back {charge.moved_Ah:.4f} of"
                f" {discharge.moved_Ah:.4f} Ah; at the low rate the branches cover"
                f" {_cover(charge):.0%} and {_cover(discharge):.0%}. Not averaged"
            )
    return tuple(notes)


def _names(logs: CellLog | Sequence[CellLog]) -> str:
    parts = [logs] if isinstance(logs, CellLog) else list(logs)
    return " + ".join(part.name or part.source or "a log" for part in parts) or "no log"
