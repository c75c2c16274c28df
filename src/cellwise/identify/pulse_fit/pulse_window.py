"""Cutting pulses out of a log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.errors import InputError
from cellwise.identify.hppc.pulses import Pulse
from cellwise.identify.pulse_fit.pulse_data import (
    LEAST_SETTLED_ROWS,
    MINIMUM_ROWS,
    PulseData,
    check_channel,
    row_weights,
)
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray


class _Limits(NamedTuple):
    """How much of a log belongs to a pulse."""

    rest_s: float = 60.0  # of rest before it that is shown, if there is as much
    rest_rows: int = 3  # at least
    quiet: float = 0.02  # less than this part of the pulse's current is no current
    switch_rows: int = 2  # on either side that may hold part of a switch
    # Of a long step the first minutes are a pulse: over hours two branches go to what is slow, and
    # R0 takes in all that is fast. What is slow is for the refinement on the whole log.
    step_s: float = 300.0
    step_rows: int = 25
    late_row_s: float = 2.5  # a drive changes its current every second or two


LIMITS = _Limits()
OcvTable = Callable[[FloatArray], FloatArray]


def pulse_from_arrays(
    time_s: FloatArray,
    current_A: FloatArray,
    voltage_V: FloatArray,
    start: int,
    stop: int,
    capacity_Ah: float,
    *,
    soc_start: float = float("nan"),
    rest_before_s: float | None = None,
    ocv: OcvTable | None = None,
    name: str = "",
) -> PulseData:
    """One pulse from plain arrays; rows without a finite voltage are dropped.

    The charge that flowed up to a dropped row stays in the interval of the row that follows.

    Parameters
    ----------
    time_s, current_A, voltage_V : (n,) float     as in `PulseData`; voltage may hold NaN
    start, stop : int         first row of the pulse; first row after it
    capacity_Ah : float       [Ah]
    soc_start : float         SOC at the first row [0..1]; needed with ``ocv``
    rest_before_s : float     rest before the pulse [s]; by default what the rows show
    ocv : callable            tabulated OCV: SOC array -> voltage array [V]
    name : str                for people

    Raises
    ------
    InputError        as `PulseData`; an OCV table without a SOC
    """
    time = np.asarray(time_s, dtype=np.float64)
    current = np.asarray(current_A, dtype=np.float64)
    voltage = np.asarray(voltage_V, dtype=np.float64)
    where = f"pulse '{name}'" if name else "the pulse"
    check_channel(time, time.size, f"time_s of {where}")
    check_channel(current, time.size, f"current_A of {where}")
    check_channel(np.where(np.isfinite(voltage), voltage, 0.0), time.size, f"voltage_V of {where}")
    keep = np.flatnonzero(np.isfinite(voltage))
    dt = np.diff(time, prepend=time[0]) if time.size else time
    charge = np.cumsum(current * dt) / 3600.0
    if keep.size < time.size:
        current = _merged_current(time, current, charge, keep)
        start, stop = (int(np.searchsorted(keep, row)) for row in (start, stop))
        time, voltage, charge = time[keep], voltage[keep], charge[keep]
        charge = charge - charge[0] if charge.size else charge
    if rest_before_s is None:
        rest_before_s = float(time[start - 1] - time[0]) if 0 < start < time.size else 0.0
    change = None
    if ocv is not None:
        if not np.isfinite(soc_start):
            raise InputError(
                f"an OCV table but no SOC for {where}",
                "soc_start, the SOC at the window's first row",
                "Give soc_start, or leave the OCV slope to the fit.",
            )
        table = np.asarray(ocv(soc_start - charge / capacity_Ah), dtype=np.float64)
        change = table - table[0]
    return PulseData(
        time, current, voltage, charge, start, stop, capacity_Ah,
        soc_start, rest_before_s, change, name,
    )  # fmt: skip


def cut_pulse(
    log: CellLog,
    start: int,
    stop: int,
    capacity_Ah: float,
    *,
    soc_start: float = float("nan"),
    ocv: OcvTable | None = None,
    rest_shown_s: float = LIMITS.rest_s,
    relaxation_s: float = float("inf"),
    name: str = "",
) -> PulseData:
    """Cut the pulse in rows ``start`` to ``stop`` (not included) out of a log.

    The window begins up to ``rest_shown_s`` before the pulse and ends before the next current, a
    gap, or ``relaxation_s`` after the pulse.

    Parameters
    ----------
    log : CellLog
    start, stop : int         first row whose interval carries the pulse; first row after it
    capacity_Ah : float       [Ah]
    soc_start : float         SOC right before the pulse [0..1]
    ocv : callable            tabulated OCV: SOC array -> voltage array [V]
    rest_shown_s, relaxation_s : float    longest rest before, longest relaxation [s]
    name : str                for people

    Raises
    ------
    InputError        as `pulse_from_arrays`
    """
    time, current, voltage = log.time_s, log.known_current_A(), log.voltage_V
    gaps = log.gap_rows
    if not 0 <= start < stop <= time.size:
        raise InputError(
            f"edges at rows {start} and {stop} of a log of {time.size} rows",
            "0 <= start < stop <= number of rows",
            "Give the first row of the pulse and the first row after it.",
        )
    limit = LIMITS.quiet * float(np.max(np.abs(current[start:stop])))
    begin = start
    while begin > max(start - LIMITS.switch_rows, 1) and abs(current[begin - 1]) > limit:
        begin -= 1
    after = stop
    while after < min(stop + LIMITS.switch_rows, time.size) and abs(current[after]) > limit:
        after += 1
    # The row that ends a current, or a gap, is the rest's first: its voltage is read after it.
    busy = np.flatnonzero((np.abs(current) > limit) | gaps)
    earlier, later = busy[busy < begin], busy[busy >= after]
    rest = int(earlier[-1]) if earlier.size else 0
    end = max(int(later[0]) if later.size else time.size, stop)
    if end < time.size and not gaps[end] and end > after + 1:
        end -= 1  # the row before the next current may hold its switch
    if end == after:  # what looked like the tail of the switch was the next current
        end = stop
    end = max(stop, min(end, int(np.searchsorted(time, time[stop - 1] + relaxation_s, "right"))))
    shown = int(np.searchsorted(time, time[max(begin - 1, 0)] - rest_shown_s))
    first = max(rest, min(shown, begin - LIMITS.rest_rows), 0)
    rows = slice(first, end)
    return pulse_from_arrays(
        time[rows], current[rows], voltage[rows], begin - first, stop - first, capacity_Ah,
        soc_start=soc_start,
        rest_before_s=float(time[max(begin - 1, 0)] - time[rest]),
        ocv=ocv,
        name=name or log.name,
    )  # fmt: skip


def cut_pulses(
    log: CellLog,
    pulses: Sequence[Pulse],
    capacity_Ah: float,
    soc: FloatArray | None = None,
    *,
    ocv: OcvTable | None = None,
    step_ocv: OcvTable | None = None,
    rest_shown_s: float = LIMITS.rest_s,
    relaxation_s: float = float("inf"),
) -> list[PulseData]:
    """Cut all pulses that `find_pulses` found out of their log; of a move, its first minutes.

    Parameters
    ----------
    log : CellLog
    pulses : sequence of Pulse        of this log
    capacity_Ah : float               [Ah]
    soc : (n,) float                  SOC of every row of the log [0..1]; None if unknown
    ocv, rest_shown_s, relaxation_s   as in `cut_pulse`

    Returns
    -------
    list of PulseData         in the order given

    Raises
    ------
    InputError        as `cut_pulse`; a SOC of another length
    """
    if soc is not None and np.shape(soc) != log.time_s.shape:
        raise InputError(
            f"soc of shape {np.shape(soc)} for a log of {len(log)} rows",
            "one SOC per row",
            "Compute it from the same log.",
        )
    return [
        cut_pulse(
            log, p.start, fitted_stop(log, p), capacity_Ah,
            soc_start=float("nan") if soc is None else float(soc[max(p.start - 1, 0)]),
            ocv=step_ocv if p.role == "move" and ocv is None else ocv,
            rest_shown_s=rest_shown_s,
            relaxation_s=relaxation_s,
            name=f"{log.name} at {log.time_s[p.start]:.0f} s",
        )
        for p in pulses
    ]  # fmt: skip


def fitted_stop(log: CellLog, pulse: Pulse) -> int:
    """Row after the last one that a fit sees as the pulse: of a long move, some minutes."""
    if pulse.role != "move":
        return pulse.stop
    begin = float(log.time_s[max(pulse.start - 1, 0)])
    shown = int(np.searchsorted(log.time_s, begin + LIMITS.step_s, "right"))
    return min(max(shown, pulse.start + LIMITS.step_rows), pulse.stop)


def slow_rows_notice(log: CellLog, pulses: Sequence[Pulse]) -> str | None:
    """What a person should know of a log whose first row after a switch comes late."""
    if not pulses:
        return None
    first_s = float(np.median([log.interval_s[p.start] for p in pulses]))
    if first_s <= LIMITS.late_row_s:
        return None
    return (
        f"'{log.name}' has its first row {first_s:.3g} s after a switch: what its R0 says is the "
        "resistance after that time; for a drive log pulses every second or faster"
    )


def has_enough_rows(log: CellLog, pulse: Pulse) -> bool:
    """Whether a fit finds the rows that it needs in the window that `cut_pulse` would cut."""
    rows = slice(pulse.rest_before_start, max(pulse.relax_stop, pulse.stop))
    if np.count_nonzero(np.isfinite(log.voltage_V[rows])) < MINIMUM_ROWS:
        return False
    try:
        data = cut_pulse(log, pulse.start, fitted_stop(log, pulse), 1.0)
    except InputError:
        return False
    return bool(np.count_nonzero(row_weights(data)) >= LEAST_SETTLED_ROWS)


def _merged_current(
    time: FloatArray, current: FloatArray, charge: FloatArray, keep: NDArray[np.intp]
) -> FloatArray:
    """Interval current of the rows kept: unchanged, or the mean over the rows dropped before."""
    merged: FloatArray = current[keep].copy()
    late = np.flatnonzero(np.diff(keep, prepend=-1) > 1)
    for k in late:
        if k == 0:
            continue
        dt = time[keep[k]] - time[keep[k - 1]]
        if dt > 0.0:
            merged[k] = 3600.0 * (charge[keep[k]] - charge[keep[k - 1]]) / dt
    return merged
