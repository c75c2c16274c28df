"""Capacity tests: every full discharge at constant current in a log, CC and CV parts separated.

A test runs from full to the lower voltage limit. What flows at the constant current until the
limit is met is the CC part, what still flows while the tester holds the limit is the CV part.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.capacity.half_cycles import (
    LIMITS as HALF_CYCLES,
)
from cellwise.identify.capacity.half_cycles import (
    HalfCycle,
    Trace,
    find_half_cycles,
    join_logs,
    looks_like_end,
    settled_end,
)
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

Full = Literal["charged", "assumed", "no"]


class _Limits(NamedTuple):
    """What a full discharge is."""

    at_limit_V: float = 0.01  # so near to a voltage limit is at it, ...
    at_limit: float = 0.01  # ... or as near as this share of the log's voltage range
    given_way: float = 0.02  # of the current: the CC part goes on at the limit until it fell by it
    # Below these a discharge is a drive or an HPPC test, not a capacity test.
    steady: float = 0.95  # of the charge, at one current
    idle_s: float = 120.0
    # A rest voltage this far down the window does not follow a full charge, not even in LFP (3.35 V
    # in a window of 2.5 to 4.0 V); nor was a cell full that takes so much more to become so.
    full_rest: float = 0.5
    much_more: float = 1.15
    cooling_C: float = 5.0  # a cell warms up under load: one that cools by more was moved
    # More out than in: the charge was cut short, or the counters differ. Either way no efficiency.
    efficiency: float = 1.02


LIMITS = _Limits()


@dataclass(frozen=True)
class CapacityTest:
    """One full discharge at constant current.

    Parameters
    ----------
    name : str                     of the log (the first, where several follow one another)
    rate_C : float                 current over nominal or measured capacity [1/h]
    current_A : float              the constant current [A]
    cc_Ah, cv_Ah : float           charge until the limit was met, and while it was held [Ah]
    voltage_start_V, voltage_end_V : float     before the first and at the last row under load [V]
    reached_limit : bool           the lower limit was met
    full_at_start : str            ``charged``: a charge to the upper limit precedes in the log;
                                   ``assumed``: the log begins here; ``no``: it was not full
    charge_before_Ah, charge_after_Ah : float or None    complete charges next to it [Ah], positive
    temperature_start_C, temperature_C : float or None   medians over the first tenth and over all
    duration_s : float             from first to last row [s]
    start, stop : int              its rows in the log (in the joined logs)
    notices : tuple of str         what a person should know
    """

    name: str
    rate_C: float
    current_A: float
    cc_Ah: float
    cv_Ah: float
    voltage_start_V: float
    voltage_end_V: float
    reached_limit: bool
    full_at_start: Full
    charge_before_Ah: float | None = None
    charge_after_Ah: float | None = None
    temperature_start_C: float | None = None
    temperature_C: float | None = None
    duration_s: float = 0.0
    start: int = 0
    stop: int = 0
    notices: tuple[str, ...] = ()

    @property
    def total_Ah(self) -> float:
        """Charge of the CC and the CV part together [Ah]."""
        return self.cc_Ah + self.cv_Ah

    @property
    def complete(self) -> bool:
        """From full to the limit."""
        return self.reached_limit and self.full_at_start != "no"

    @property
    def left_out(self) -> str:
        """Why it is no capacity, for one that is not complete."""
        why = "; ".join(self.notices) or "not from full to the lower limit"
        return f"{self.name}: not used ({why})"

    @property
    def cooled(self) -> bool:
        """The test was moved to a colder place while it ran: it belongs to no temperature."""
        if self.temperature_C is None or self.temperature_start_C is None:
            return False
        return self.temperature_C < self.temperature_start_C - LIMITS.cooling_C

    @property
    def coulombic_efficiency(self) -> float | None:
        """Discharged over charged, None where no complete charge stands next to it.

        The charge that follows is taken first, because it leads back to the very state the
        discharge began at; the one before began at an empty that depends on its own rate.
        """
        charged = self.charge_before_Ah if self.charge_after_Ah is None else self.charge_after_Ah
        if charged is None or not self.complete or self.total_Ah > LIMITS.efficiency * charged:
            return None
        return self.total_Ah / charged


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
    traces = [join_logs(group) for group in groups]
    names = [group[0].name or group[0].source for group in groups]
    cycles = [find_half_cycles(trace) for trace in traces]
    ends = [
        float(np.min(trace.voltage_V[h.steady_start : h.stop]))
        for trace, halves in zip(traces, cycles, strict=True)
        for h in halves
        if _is_capacity_test(trace, h)
    ]
    if not ends:
        raise InputError(
            f"no discharge at constant current in {', '.join(map(repr, names)) or 'no log'}",
            "a discharge at one current from full to the lower voltage limit",
            "Name a capacity test, or leave `capacity=...` out: then the HPPC's or the nominal "
            "capacity is used.",
        )
    v_min, v_max = min(ends), max(float(np.max(trace.voltage_V)) for trace in traces)
    near = max(map(_tolerance_V, traces))
    shared = sum(e <= v_min + near for e in ends) > 1
    tests = [
        _measure(trace, halves, k, name, v_min, v_max, shared)
        for trace, halves, name in zip(traces, cycles, names, strict=True)
        for k, half in enumerate(halves)
        if _is_capacity_test(trace, half)
    ]
    whole = [t.total_Ah for t in tests if t.complete] or [t.total_Ah for t in tests]
    capacity = nominal_Ah or max(whole)
    return tuple(replace(t, rate_C=t.current_A / capacity) for t in tests)


def _is_capacity_test(trace: Trace, half: HalfCycle) -> bool:
    """Whether a half cycle discharges without a pause at one current, to its lowest voltage."""
    if half.charge_Ah <= 0.0:
        return False
    lowest = float(np.min(trace.voltage_V[half.steady_start : half.stop]))
    stop = _cc_stop(trace, half, lowest)
    rows = slice(half.steady_start, stop)
    current, dt = trace.current_A[rows], trace.interval_s[rows]
    off = np.abs(current - half.main_current_A) > HALF_CYCLES.steady * half.main_current_A
    idle_s = float(np.sum(dt[np.abs(current) < 0.02 * half.main_current_A]))
    moved = np.abs(current) * dt
    return bool(idle_s <= LIMITS.idle_s and moved[off].sum() <= (1.0 - LIMITS.steady) * moved.sum())


def _cc_stop(trace: Trace, half: HalfCycle, v_min: float) -> int:
    """Row after the last one of a discharge's CC part: where it met the limit, else its end."""
    rows = slice(half.steady_start, half.stop)
    at = np.flatnonzero(trace.voltage_V[rows] <= v_min + _tolerance_V(trace))
    if at.size == 0:
        return half.stop
    current = trace.current_A[half.steady_start + int(at[0]) : half.stop]
    gave_way = np.abs(current - half.main_current_A) > LIMITS.given_way * half.main_current_A
    held = int(np.argmax(gave_way)) if gave_way.any() else current.size
    return half.steady_start + int(at[0]) + max(held, 1)


def _tolerance_V(trace: Trace) -> float:
    """How near to a limit counts as at it [V]."""
    return max(LIMITS.at_limit_V, LIMITS.at_limit * float(np.ptp(trace.voltage_V)))


def _measure(
    trace: Trace,
    halves: tuple[HalfCycle, ...],
    k: int,
    name: str,
    v_min: float,
    v_max: float,
    limit_known: bool,
) -> CapacityTest:
    half = halves[k]
    begin = max(half.steady_start - 1, 0)
    end = settled_end(trace, halves, k)
    limit = _cc_stop(trace, half, v_min)
    charge, voltage = trace.charge_Ah, trace.voltage_V
    lowest = float(np.min(voltage[half.steady_start : end + 1]))
    slack = abs(float(voltage[half.steady_stop - 1] - voltage[max(half.steady_stop - 2, 0)]))
    reached = lowest <= v_min + _tolerance_V(trace) + slack
    notices = []
    held = (charge[end] - charge[limit - 1]) > 0.002 * (charge[end] - charge[begin])
    if reached and not (limit_known or held or looks_like_end(trace, half.steady_start, limit)):
        reached = False
        notices.append(f"ends at {lowest:.3f} V without the look of an end: give the lower limit")
    elif not reached:
        notices.append(f"stops at {lowest:.3f} V, the lower limit is {v_min:.3f} V")
    full, why = _full_at_start(trace, halves, k, v_min, v_max)
    temperature = trace.temperature_C[half.steady_start : limit]
    tenth = max(1, temperature.size // 10)
    first_C, last_C = _median_or_none(temperature[:tenth]), _median_or_none(temperature[-tenth:])
    if first_C is not None and last_C is not None and last_C < first_C - LIMITS.cooling_C:
        why = [
            *why,
            f"the temperature fell from {first_C:.1f} to {last_C:.1f} degC during the test",
        ]
    return CapacityTest(
        name=name,
        rate_C=float("nan"),
        current_A=_mean_current(trace, half.steady_start, limit),
        cc_Ah=float(charge[limit - 1] - charge[begin]),
        cv_Ah=float(charge[end] - charge[limit - 1]),
        voltage_start_V=float(voltage[begin]),
        voltage_end_V=float(voltage[limit - 1]),
        reached_limit=bool(reached),
        full_at_start=full,
        charge_before_Ah=_complete_charge(trace, halves, k - 1, v_max, v_min),
        charge_after_Ah=_complete_charge(trace, halves, k + 1, v_max, v_min),
        temperature_start_C=first_C,
        temperature_C=_median_or_none(temperature),
        duration_s=float(np.sum(trace.interval_s[half.steady_start : half.stop])),
        start=half.steady_start,
        stop=end + 1,
        notices=(*notices, *why),
    )


def _full_at_start(
    trace: Trace, halves: tuple[HalfCycle, ...], k: int, v_min: float, v_max: float
) -> tuple[Full, list[str]]:
    begin = max(halves[k].steady_start - 1, 0)
    start_V = float(trace.voltage_V[begin])
    if k > 0:
        top = float(np.max(trace.voltage_V[halves[k - 1].start : begin + 1]))
        if top >= v_max - _tolerance_V(trace):
            return "charged", []
        return "no", [f"charged to {top:.3f} V before, the upper limit is {v_max:.3f} V"]
    at_rest = halves[k].steady_start > 0
    if at_rest and start_V < v_min + LIMITS.full_rest * (v_max - v_min):
        return "no", [f"begins at a rest voltage of {start_V:.3f} V, which is not full"]
    charged = _complete_charge(trace, halves, k + 1, v_max, v_min)
    if charged is not None and charged > LIMITS.much_more * halves[k].charge_Ah:
        return "no", [f"{halves[k].charge_Ah:.3f} Ah out, then {charged:.3f} Ah in to full"]
    return "assumed", []


def _complete_charge(
    trace: Trace, halves: tuple[HalfCycle, ...], k: int, v_max: float, v_min: float
) -> float | None:
    """Charge of a half cycle that goes from the lower to the upper limit, else None [Ah]."""
    if not 0 <= k < len(halves):
        return None
    half, near = halves[k], _tolerance_V(trace)
    below = trace.voltage_V[: half.steady_start]
    # What is empty is known from a discharge to the limit before it.
    from_empty = k > 0 and np.min(below[halves[k - 1].start :]) <= v_min + near
    rows = slice(half.steady_start, half.stop)
    to_full = np.max(trace.voltage_V[rows]) >= v_max - near
    return -half.charge_Ah if from_empty and to_full else None


def _mean_current(trace: Trace, start: int, stop: int) -> float:
    dt = trace.interval_s[start:stop]
    current = trace.current_A[start:stop]
    return float(np.average(current, weights=dt) if dt.sum() > 0.0 else np.mean(current))


def _median_or_none(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else None
