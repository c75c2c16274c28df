"""Capacity tests: every full discharge at constant current in a log, CC and CV parts separated.

A test runs from full to the lower voltage limit. What flows at the constant current until the
limit is met is the CC part, what still flows while the tester holds the limit is the CV part.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.fit.model_error import SAME_TEMPERATURE_K
from cellwise.identify.capacity.half_cycles import LIMITS as HALF_CYCLES
from cellwise.identify.capacity.half_cycles import (
    CapacityTrace,
    HalfCycle,
    find_half_cycles,
    join_logs,
)
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Code, Notice, texts
from cellwise.typing import FloatArray
from cellwise.wording import arg, joined_texts


class _CapacityTestLimits(NamedTuple):
    """What a full discharge is."""

    at_limit_V: float = 0.01  # so near to a voltage limit is at it, ...
    at_limit: float = 0.01  # ... or as near as this share of the log's voltage range
    little: float = 0.02  # of the current: less is none; the CC part ends where it fell by it
    # Below these a discharge is a drive or an HPPC test, not a capacity test.
    steady: float = 0.95  # of the charge, at one current
    idle_s: float = 120.0
    # A rest voltage this far down the window does not follow a full charge, not even in LFP (3.35 V
    # in a window of 2.5 to 4.0 V); nor was a cell full that takes so much more to become so.
    full_rest: float = 0.5
    much_more: float = 1.15
    # More out than in: the charge was cut short, or the counters differ. Either way no efficiency.
    efficiency: float = 1.02
    # The end of a discharge where the limit is not given: slope over the last 3 % over that of the
    # middle, or a voltage that is a multiple of a round one.
    knee: float = 1.3
    round_V: float = 0.1
    tolerance_V: float = 0.004


LIMITS = _CapacityTestLimits()


@dataclass(frozen=True)
class CapacityTest:
    """One full discharge at constant current.

    Parameters
    ----------
    name : str                     of the log (the first, where several follow one another)
    rate_C : float                 current over nominal or measured capacity [1/h]
    current_A : float              the constant current [A]
    cc_Ah, cv_Ah : float           charge until the limit was met, and while it was held [Ah]
    complete : bool                from full to the lower limit
    charged_Ah : float or None     the complete charge that follows, else the one before [Ah]
    temperature_C : float or None      at which it began: median over its first tenth
    cooled : bool                  moved to a colder place meanwhile: it belongs to no temperature
    notices : tuple of Notice      what a person should know
    """

    name: str
    rate_C: float
    current_A: float
    cc_Ah: float
    cv_Ah: float
    complete: bool = True
    charged_Ah: float | None = None
    temperature_C: float | None = None
    cooled: bool = False
    notices: tuple[Notice, ...] = ()

    @property
    def total_Ah(self) -> float:
        """Charge of the CC and the CV part together [Ah]."""
        return self.cc_Ah + self.cv_Ah

    @property
    def left_out(self) -> str:
        """Why it is no capacity, for one that is not complete."""
        why = joined_texts(texts(self.notices)) or "not from full to the lower limit"
        return f"{self.name}: not used (" + why + ")"

    @property
    def coulombic_efficiency(self) -> float | None:
        """Discharged over charged, None where no complete charge stands next to it.

        The charge that follows is taken first, because it leads back to the very state the
        discharge began at; the one before began at an empty that depends on its own rate.
        """
        charged = self.charged_Ah
        if charged is None or not self.complete or self.total_Ah > LIMITS.efficiency * charged:
            return None
        return self.total_Ah / charged


class _VoltageWindow(NamedTuple):
    """Voltage limits that a set of logs shows [V]; whether more than one test met the lower one."""

    low_V: float
    high_V: float
    shared: bool


def measure_capacities(
    logs: Iterable[CellLog | Sequence[CellLog]], *, nominal_Ah: float | None = None
) -> tuple[CapacityTest, ...]:
    """Every discharge at constant current in a set of logs of one cell, with common limits.

    The limits are those that the set shows: the highest voltage, and the lowest at which a
    discharge ended.

    Parameters
    ----------
    logs : of CellLog, or of several that are one test in parts: discharge, its last per cent, ...
    nominal_Ah : float             what a rate of 1C refers to; default the largest measured

    Returns
    -------
    tuple of CapacityTest, in order of time; those that did not reach the limit are marked

    Raises
    ------
    InputError        no discharge at constant current
    """
    groups = [(entry,) if isinstance(entry, CellLog) else tuple(entry) for entry in logs]
    names = [g[0].name or g[0].source for g in groups if g]
    traces = [join_logs(group) for group in groups]
    found = [
        (name, trace, halves, k)
        for name, trace in zip(names, traces, strict=True)
        for halves in [find_half_cycles(trace)]
        for k, half in enumerate(halves)
        if _is_capacity_test(trace, half)
    ]
    if not found:
        raise InputError(
            f"no discharge at constant current in {', '.join(map(repr, names)) or 'no log'}",
            "a discharge at one current from full to the lower voltage limit",
            "Name a capacity test, or leave "
            + arg("capacity", letter="...")
            + " out: then the HPPC's or the nominal "
            "capacity is used.",
        )
    ends = [_lowest_V(trace, halves[k]) for _, trace, halves, k in found]
    high_V = max(float(np.max(trace.voltage_V)) for trace in traces)
    near = max(map(_tolerance_V, traces))
    window = _VoltageWindow(min(ends), high_V, sum(e <= min(ends) + near for e in ends) > 1)
    tests = [_measure(*one, window) for one in found]
    whole = [t.total_Ah for t in tests if t.complete] or [t.total_Ah for t in tests]
    capacity = nominal_Ah or max(whole)
    return tuple(replace(t, rate_C=t.current_A / capacity) for t in tests)


def _lowest_V(trace: CapacityTrace, half: HalfCycle) -> float:
    return float(np.min(trace.voltage_V[half.steady_start : half.stop]))


def _tolerance_V(trace: CapacityTrace) -> float:
    """How near to a limit counts as at it [V]."""
    return max(LIMITS.at_limit_V, LIMITS.at_limit * float(np.ptp(trace.voltage_V)))


def _is_capacity_test(trace: CapacityTrace, half: HalfCycle) -> bool:
    """Whether a half cycle discharges without a pause at one current, to its lowest voltage."""
    if half.charge_Ah <= 0.0:
        return False
    rows = slice(half.steady_start, _cc_stop(trace, half, _lowest_V(trace, half)))
    current, dt, main = trace.current_A[rows], trace.interval_s[rows], half.main_current_A
    off = np.abs(current - main) > HALF_CYCLES.steady * main
    idle_s = float(np.sum(dt[np.abs(current) < LIMITS.little * main]))
    moved = np.abs(current) * dt
    return bool(idle_s <= LIMITS.idle_s and moved[off].sum() <= (1.0 - LIMITS.steady) * moved.sum())


def _cc_stop(trace: CapacityTrace, half: HalfCycle, limit_V: float) -> int:
    """Row after the last one of a discharge's CC part: where it met the limit, else its end."""
    voltage = trace.voltage_V[half.steady_start : half.stop]
    at = np.flatnonzero(voltage <= limit_V + _tolerance_V(trace))
    if at.size == 0:
        return half.stop
    first, main = half.steady_start + int(at[0]), half.main_current_A
    gave_way = np.abs(trace.current_A[first : half.stop] - main) > LIMITS.little * main
    return first + max(int(np.argmax(gave_way)) if gave_way.any() else gave_way.size, 1)


def _measure(
    name: str, trace: CapacityTrace, halves: tuple[HalfCycle, ...], k: int, window: _VoltageWindow
) -> CapacityTest:
    half = halves[k]
    begin, end, first = half.begin, half.end, half.steady_start
    limit = _cc_stop(trace, half, window.low_V)
    charge, voltage = trace.charge_Ah, trace.voltage_V
    lowest = float(np.min(voltage[first : end + 1]))
    slack = abs(float(voltage[half.steady_stop - 1] - voltage[max(half.steady_stop - 2, 0)]))
    short = []
    if lowest > window.low_V + _tolerance_V(trace) + slack:
        short.append(f"stops at {lowest:.3f} V, the lower limit is {window.low_V:.3f} V")
    elif not (window.shared or _looks_like_end(trace, first, limit)):
        short.append(f"ends at {lowest:.3f} V without the look of an end: give the lower limit")
    short += _not_full(trace, halves, k, window)
    notices = [Notice(Code.CAPACITY_TEST_INCOMPLETE, text) for text in short]
    complete = not notices
    temperature = trace.temperature_C[first:limit]
    tenth = max(1, temperature.size // 10)
    first_C, last_C = _median(temperature[:tenth]), _median(temperature[-tenth:])
    # A cell warms up under load: one that cools was moved.
    cooled = first_C is not None and last_C is not None and last_C < first_C - SAME_TEMPERATURE_K
    if cooled:
        text = f"the temperature fell from {first_C:.1f} to {last_C:.1f} degC during the test"
        notices.append(Notice(Code.CAPACITY_TEST_COOLED, text))
    seconds = float(np.sum(trace.interval_s[first:limit]))
    charges = [_complete_charge(trace, halves, j, window) for j in (k + 1, k - 1)]
    return CapacityTest(
        name=name,
        rate_C=float("nan"),
        current_A=float(charge[limit - 1] - charge[begin]) * 3600.0 / max(seconds, 1e-9),
        cc_Ah=float(charge[limit - 1] - charge[begin]),
        cv_Ah=float(charge[end] - charge[limit - 1]),
        complete=complete,
        charged_Ah=next((c for c in charges if c is not None), None),
        temperature_C=first_C,
        cooled=cooled,
        notices=tuple(notices),
    )


def _not_full(
    trace: CapacityTrace, halves: tuple[HalfCycle, ...], k: int, window: _VoltageWindow
) -> tuple[str, ...]:
    """Why a discharge did not begin full; a log that begins with it is taken to begin full."""
    half, low_V, high_V = halves[k], window.low_V, window.high_V
    if k > 0:
        top = float(np.max(trace.voltage_V[halves[k - 1].start : half.begin + 1]))
        cut_short = top < high_V - _tolerance_V(trace)
        said = f"charged to {top:.3f} V before, the upper limit is {high_V:.3f} V"
        return (said,) if cut_short else ()
    start_V = float(trace.voltage_V[half.begin])
    if half.steady_start > 0 and start_V < low_V + LIMITS.full_rest * (high_V - low_V):
        return (f"begins at a rest voltage of {start_V:.3f} V, which is not full",)
    charged = _complete_charge(trace, halves, k + 1, window)
    if charged is not None and charged > LIMITS.much_more * half.charge_Ah:
        return (f"{half.charge_Ah:.3f} Ah out, then {charged:.3f} Ah in to full",)
    return ()


def _complete_charge(
    trace: CapacityTrace, halves: tuple[HalfCycle, ...], k: int, window: _VoltageWindow
) -> float | None:
    """Charge of a half cycle that goes from the lower to the upper limit, else None [Ah]."""
    if not 0 < k < len(halves):
        return None  # what is empty is known from a discharge to the limit before it
    half, near = halves[k], _tolerance_V(trace)
    before = trace.voltage_V[halves[k - 1].start : half.steady_start]
    from_empty = np.min(before) <= window.low_V + near
    to_full = np.max(trace.voltage_V[half.steady_start : half.stop]) >= window.high_V - near
    return -half.charge_Ah if from_empty and to_full else None


def _looks_like_end(trace: CapacityTrace, start: int, stop: int) -> bool:
    """Whether the discharge in rows start to stop ends as one does: bending down, or at a round V.

    For a lone test without given limits, where it is all there is. Of 49 measured discharges all
    pass; cut off at 80 % of their charge 29 are refused, at 60 % 34.
    """
    q, v = trace.charge_Ah[start:stop], trace.voltage_V[start:stop]
    if q.size < 2 or q[-1] <= q[0]:
        return False
    at_10, at_90, at_97 = np.interp((0.1, 0.9, 0.97), (q - q[0]) / (q[-1] - q[0]), v)
    bends = (at_97 - v[-1]) / 0.03 >= LIMITS.knee * (at_10 - at_90) / 0.8
    off_round = abs(float(v[-1]) - LIMITS.round_V * round(float(v[-1]) / LIMITS.round_V))
    return bool(bends or off_round <= LIMITS.tolerance_V)


def _median(values: FloatArray) -> float | None:
    return float(np.nanmedian(values)) if np.isfinite(values).any() else None
