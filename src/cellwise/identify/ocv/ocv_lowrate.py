"""Open-circuit voltage from low-rate discharge and charge: both branches kept, their gap a result.

A branch carries the polarisation of its small current and, in LFP above all, half of the
hysteresis. The curve is the discharge branch, which begins full; the charge one without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.fit.splines import SOC_GRID
from cellwise.identify.capacity.half_cycles import (
    CapacityTrace,
    HalfCycle,
    find_half_cycles,
    join_logs,
)
from cellwise.identify.ocv.curve import (
    OUTSIDE,
    OcvCurve,
    curve_from_points,
    fit_monotone_spline,
)
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Code, Notice
from cellwise.typing import FloatArray


class _LowRateLimits(NamedTuple):
    """What a low rate is."""

    low_rate: float = 1.0 / 9.0  # [1/h] of the branch's own charge: faster is said
    fastest_rate: float = 1.0 / 1.8  # [1/h]: faster is no low rate
    alike: float = 1.3  # times the slowest: of these the one that moved most


LIMITS = _LowRateLimits()


class Branch(NamedTuple):
    """One low-rate half cycle over SOC.

    soc, voltage_V : (n,) rows at the constant current, by rising SOC
    grid_V : (m,) smoothed, on the uniform grid; nan where not measured
    moved_Ah : charge of the whole half cycle, positive
    rate : current over that charge [1/h]
    """

    soc: FloatArray
    voltage_V: FloatArray
    grid_V: FloatArray
    moved_Ah: float
    rate: float


def ocv_from_low_rate(
    logs: CellLog | Sequence[CellLog], *, capacity_Ah: float | None = None
) -> OcvCurve:
    """OCV curve from C/20 to C/30 (at most C/2) discharge, charge, or both.

    The discharge branch, else the charge one.

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
    if returned is not None:
        empty, scale_Ah = 0.0, -returned.charge_Ah
        if taken is not None:
            # Charge that is lost on the way cannot make the cell fuller than full.
            scale_Ah = capacity * max(scale_Ah / taken.charge_Ah, 1.0)
            empty = 1.0 - taken.charge_Ah / capacity
        used, chosen = (charge := _branch(trace, returned, empty, scale_Ah)), "charge branch"
    if taken is not None:
        used, chosen = (discharge := _branch(trace, taken, 1.0, capacity)), "discharge branch"
    return curve_from_points(
        used.soc,
        used.voltage_V,
        capacity_Ah=capacity,
        discharge_V=None if discharge is None else discharge.grid_V,
        charge_V=None if charge is None else charge.grid_V,
        source=f"{chosen} of {name}",
        notes=_notes(discharge, charge),
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


def _branch(trace: CapacityTrace, half: HalfCycle, soc_begin: float, scale_Ah: float) -> Branch:
    """Rows at the low current, in the log in which it began, from the SOC at which it did."""
    rows = half.at_main_current(trace) & (trace.log == trace.log[half.steady_start])
    soc = soc_begin - (trace.charge_Ah[rows] - trace.charge_Ah[half.begin]) / scale_Ah
    inside = (soc >= -OUTSIDE) & (soc <= 1.0 + OUTSIDE)
    order = np.argsort(soc[inside], kind="stable")
    s, v = soc[inside][order], trace.voltage_V[rows][inside][order]
    smooth = fit_monotone_spline(s, v).evaluate(SOC_GRID)
    near = 0.5 * SOC_GRID[1]
    smooth[(s[0] - near > SOC_GRID) | (s[-1] + near < SOC_GRID)] = np.nan
    moved_Ah = abs(half.charge_Ah)
    return Branch(s, v, smooth, moved_Ah, abs(half.main_current_A) / moved_Ah)


def _notes(discharge: Branch | None, charge: Branch | None) -> tuple[Notice, ...]:
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
        gap_V = float(np.nanmedian(charge.grid_V - discharge.grid_V))
        notes.append(f"gap between the branches: {1e3 * gap_V:.1f} mV median")
    return tuple(Notice(Code.OCV_SOURCE, text) for text in notes)
