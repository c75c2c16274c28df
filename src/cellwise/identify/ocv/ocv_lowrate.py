"""Open-circuit voltage from low-rate discharge and charge: both branches kept, their gap a result.

A branch carries the polarisation of its small current and, in LFP above all, half of the
hysteresis. The mean of both is free of what is symmetric, so it is taken where both branches are
whole. A charge that was cut short would tilt it: such a branch is kept, named, and not averaged in.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.capacity.half_cycles import (
    HalfCycle,
    Trace,
    find_half_cycles,
    join_logs,
)
from cellwise.identify.ocv.curve import (
    GRID_INTERVALS,
    OcvCurve,
    curve_from_points,
    fit_monotone_spline,
)
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Code, Notice
from cellwise.typing import FloatArray


class _Limits(NamedTuple):
    """What makes a branch whole, and two branches fit for a mean."""

    low_rate: float = 1.0 / 9.0  # [1/h] of the branch's own charge: faster is said
    fastest_rate: float = 1.0 / 1.8  # [1/h]: faster is no low rate
    alike: float = 1.3  # times the slowest: of these the one that moved most
    cover: float = 0.75  # of the SOC range that a branch must cover
    # A whole charge brings back this much of what the discharge took, counter errors included;
    # nearly all is whole whatever voltage its last row shows.
    back: tuple[float, float] = (0.95, 1.10)
    nearly_all: float = 0.99
    at_limit_V: float = 0.01
    alike_rate: float = 2.0  # factor between the rates of branches that are averaged
    # Between these parts of the SOC range the gap is what it is; towards the ends it may grow by
    # the factor that follows.
    middle: tuple[float, float] = (0.25, 0.75)
    end_gap: float = 1.3
    outside: float = 0.02  # of the SOC range: rows beyond the ends that are still taken


LIMITS = _Limits()
BOTH = "mean of both branches"


class Branch(NamedTuple):
    """One low-rate half cycle over SOC.

    soc, voltage_V : (n,) rows at the constant current, by rising SOC
    grid_V : (m,) smoothed, on the uniform grid; nan where not measured
    moved_Ah : charge of the whole half cycle, positive
    rate : current over that charge [1/h]
    cover : part of the SOC range in which it has rows
    """

    soc: FloatArray
    voltage_V: FloatArray
    grid_V: FloatArray
    moved_Ah: float
    rate: float
    cover: float


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
    parts = [logs] if isinstance(logs, CellLog) else list(logs)
    name = " + ".join(part.name or part.source or "a log" for part in parts)
    taken, returned = (_slowest(find_half_cycles(trace), sign) for sign in (1.0, -1.0))
    first = taken or returned
    if first is None:
        raise InputError(
            f"no discharge or charge slower than C/2 in {name}",
            "a discharge or charge at C/20 or slower over the whole range",
            "Use a low-rate log, or an HPPC log through its rests.",
        )
    capacity = capacity_Ah or abs(first.charge_Ah)
    discharge = charge = None
    averaged = False
    if taken is not None:
        discharge = _branch(trace, taken, 1.0, capacity)
    if returned is not None:
        back_Ah, empty = -returned.charge_Ah, 0.0
        top_V = np.max(trace.voltage_V[returned.start : returned.stop])
        whole = bool(top_V >= np.max(trace.voltage_V) - LIMITS.at_limit_V)
        scale_Ah = back_Ah if whole else capacity
        if taken is not None:
            ratio, empty = back_Ah / taken.charge_Ah, 1.0 - taken.charge_Ah / capacity
            whole = whole or ratio >= LIMITS.nearly_all
            averaged = whole and LIMITS.back[0] <= ratio <= LIMITS.back[1]
            # Charge that is lost on the way cannot make the cell fuller than full.
            scale_Ah = capacity * (max(ratio, 1.0) if averaged else 1.0)
        charge = _branch(trace, returned, empty, scale_Ah)
    first_branch = next(b for b in (discharge, charge) if b is not None)
    soc, level = first_branch.soc, first_branch.voltage_V
    chosen = "charge branch" if discharge is None else "discharge branch"
    if averaged and discharge is not None and charge is not None:
        covered = min(discharge.cover, charge.cover) >= LIMITS.cover
        if covered and _alike(discharge, charge):
            soc, chosen = np.linspace(0.0, 1.0, GRID_INTERVALS + 1), BOTH
            level = _mean_of_branches(discharge.grid_V, charge.grid_V)
    return curve_from_points(
        soc,
        level,
        capacity_Ah=capacity,
        discharge_V=None if discharge is None else discharge.grid_V,
        charge_V=None if charge is None else charge.grid_V,
        source=f"{chosen} of {name}",
        notes=_notes(discharge, charge, chosen == BOTH),
    )


def _slowest(halves: Sequence[HalfCycle], sign: float) -> HalfCycle | None:
    """The slowest discharge (sign 1) or charge (-1); of several alike the one that moved most."""
    rates = {
        h: abs(h.main_current_A / h.charge_Ah)
        for h in halves
        if sign * h.charge_Ah > 0.0
        and abs(h.main_current_A) <= LIMITS.fastest_rate * abs(h.charge_Ah)
    }
    slow = [h for h, rate in rates.items() if rate <= LIMITS.alike * min(rates.values())]
    return max(slow, key=lambda h: abs(h.charge_Ah), default=None)


def _branch(trace: Trace, half: HalfCycle, soc_begin: float, scale_Ah: float) -> Branch:
    """Rows at the low current, in the log in which it began, from the SOC at which it did."""
    rows = half.at_main_current(trace) & (trace.log == trace.log[half.steady_start])
    soc = soc_begin - (trace.charge_Ah[rows] - trace.charge_Ah[half.begin]) / scale_Ah
    inside = (soc >= -LIMITS.outside) & (soc <= 1.0 + LIMITS.outside)
    order = np.argsort(soc[inside], kind="stable")
    s, v = soc[inside][order], trace.voltage_V[rows][inside][order]
    grid = np.linspace(0.0, 1.0, GRID_INTERVALS + 1)
    smooth = fit_monotone_spline(s, v).evaluate(grid)
    near = 0.5 / GRID_INTERVALS
    smooth[(grid < s[0] - near) | (grid > s[-1] + near)] = np.nan
    moved_Ah = abs(half.charge_Ah)
    cover = float(min(s[-1], 1.0) - max(s[0], 0.0))
    return Branch(s, v, smooth, moved_Ah, abs(half.main_current_A) / moved_Ah, cover)


def _alike(discharge: Branch, charge: Branch) -> bool:
    """Whether both were measured at about one rate."""
    return 1.0 / LIMITS.alike_rate <= charge.rate / discharge.rate <= LIMITS.alike_rate


def _mean_of_branches(discharge_V: FloatArray, charge_V: FloatArray) -> FloatArray:
    """Mean of the branches, save where one of them bends off towards the end of its own test.

    There the gap is no longer hysteresis and ohmic drop: it is the approach to the limit. Below
    the middle of the SOC range the charge branch, above it the discharge branch, starts from rest
    and is the sound one: it is moved by half the gap of the middle. (Plett, Battery Management
    Systems vol. 1, 2015, section 2.9 takes the branches so too, with the gap at 50 % SOC.)
    """
    soc = np.linspace(0.0, 1.0, discharge_V.size)
    low, high = LIMITS.middle
    half = 0.5 * (charge_V - discharge_V)
    most = LIMITS.end_gap * float(np.nanmedian(half[(soc > low) & (soc < high)]))
    half = np.fmin(half, most)  # the usual one, too, where a branch is not known
    share = np.clip((soc - low) / (high - low), 0.0, 1.0)
    share = np.where(np.isfinite(charge_V), share, 1.0)
    share = np.where(np.isfinite(discharge_V), share, 0.0)
    from_discharge, from_charge = np.nan_to_num(discharge_V) + half, np.nan_to_num(charge_V) - half
    return np.asarray(share * from_discharge + (1.0 - share) * from_charge)


def _notes(discharge: Branch | None, charge: Branch | None, averaged: bool) -> tuple[Notice, ...]:
    notes = []
    for label, branch in (("discharge", discharge), ("charge", charge)):
        if branch is not None:
            notes.append(
                f"{label} branch: {branch.moved_Ah:.4f} Ah at C/{1.0 / branch.rate:.1f},"
                f" SOC {branch.soc[0]:.3f} to {branch.soc[-1]:.3f}"
            )
            if branch.rate > LIMITS.low_rate:
                notes.append(f"{label} branch is faster than C/10: it carries much polarisation")
    if discharge is None or charge is None:
        return _as_notices(notes)
    if averaged:
        gap = 1e3 * np.nanmedian(charge.grid_V - discharge.grid_V)
        notes.append(f"gap between the branches: {gap:.1f} mV median")
    elif not _alike(discharge, charge):
        notes.append("charge branch at another rate than the discharge: not averaged in")
    else:
        notes.append(
            f"incomplete: charge brought back {charge.moved_Ah:.4f} of {discharge.moved_Ah:.4f} Ah;"
            f" at the low rate the branches cover {charge.cover:.0%} and {discharge.cover:.0%}. "
            "Not averaged"
        )
    return _as_notices(notes)


def _as_notices(notes: Iterable[str]) -> tuple[Notice, ...]:
    return tuple(Notice(Code.OCV_SOURCE, text) for text in notes)
