"""Cutting pulses out of a log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.identify.hppc.pulses import Pulse
from cellwise.identify.pulse_fit.pulse_data import PulseData
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray


class _Limits(NamedTuple):
    """How much of a log belongs to a pulse."""

    rest_s: float = 60.0  # of rest before it that is compared, if there is as much
    rest_rows: int = 3  # at least
    before_s: float = 600.0  # shown before it: branches of minutes have forgotten the rest
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
    first: int = 0,
    soc_start: float = float("nan"),
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
    first : int               first row that is compared
    soc_start : float         SOC at the first row of all [0..1]; needed with ``ocv``
    ocv : callable            tabulated OCV: SOC array -> voltage array [V]
    name : str                for people

    Raises
    ------
    InputError        too few rows
    """
    time, current, voltage = time_s, current_A, voltage_V
    keep = np.flatnonzero(np.isfinite(voltage))
    dt = np.diff(time, prepend=time[0])
    charge = np.cumsum(current * dt) / 3600.0
    if keep.size < time.size:
        current = _merged_current(time, current, charge, keep)
        first, start, stop = (int(np.searchsorted(keep, row)) for row in (first, start, stop))
        time, voltage, charge = time[keep], voltage[keep], charge[keep]
        charge = charge - charge[0] if charge.size else charge
    change = None
    if ocv is not None:
        table = np.asarray(ocv(soc_start - charge / capacity_Ah), dtype=np.float64)
        change = table - table[0]
    return PulseData(
        time, current, voltage, charge, start, stop, capacity_Ah, soc_start, first, change, name
    )


def cut_pulse(
    log: CellLog,
    start: int,
    stop: int,
    capacity_Ah: float,
    *,
    soc_start: float = float("nan"),
    ocv: OcvTable | None = None,
) -> PulseData:
    """Cut the pulse in rows ``start`` to ``stop`` (not included) out of a log.

    What is compared begins a minute before the pulse and ends before the next current or a gap. Ten
    minutes before the pulse are shown, too: what its branches hold comes from there.

    Parameters
    ----------
    log : CellLog
    start, stop : int         first row whose interval carries the pulse; first row after it
    capacity_Ah : float       [Ah]
    soc_start : float         SOC right before the pulse [0..1]
    ocv : callable            tabulated OCV: SOC array -> voltage array [V]

    Raises
    ------
    InputError        as `pulse_from_arrays`
    """
    time, current, voltage = log.time_s, log.known_current_A(), log.voltage_V
    gaps = log.gap_rows
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
    at_s = float(time[max(begin - 1, 0)])
    shown = int(np.searchsorted(time, at_s - LIMITS.rest_s))
    first = max(rest, min(shown, begin - LIMITS.rest_rows), 0)
    before = int(np.searchsorted(time, at_s - LIMITS.before_s))
    gap = np.flatnonzero(gaps[: first + 1])
    before = min(max(before, int(gap[-1]) if gap.size else 0), first)
    rows = slice(before, end)
    moved_Ah = float(log.counted_charge_Ah()[max(begin - 1, 0)] - log.counted_charge_Ah()[before])
    return pulse_from_arrays(
        time[rows], current[rows], voltage[rows], begin - before, stop - before, capacity_Ah,
        first=first - before,
        soc_start=soc_start + moved_Ah / capacity_Ah,
        ocv=ocv,
        name=f"{log.name} at {time[start]:.0f} s",
    )  # fmt: skip


def cut_pulses(
    log: CellLog,
    pulses: Sequence[Pulse],
    capacity_Ah: float,
    soc: FloatArray | None = None,
    ocv: OcvTable | None = None,
) -> list[PulseData]:
    """Cut all pulses that `find_pulses` found out of their log; of a move, its first minutes.

    Parameters
    ----------
    log : CellLog
    pulses : sequence of Pulse        of this log
    capacity_Ah : float               [Ah]
    soc : (n,) float                  SOC of every row of the log [0..1]; None if unknown
    ocv : callable                    tabulated OCV: SOC array -> voltage array [V]

    Returns
    -------
    list of PulseData         in the order given

    Raises
    ------
    InputError        as `pulse_from_arrays`
    """
    return [
        cut_pulse(
            log, p.start, fitted_stop(log, p), capacity_Ah,
            soc_start=float("nan") if soc is None else float(soc[max(p.start - 1, 0)]),
            ocv=ocv,
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
