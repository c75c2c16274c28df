"""The current sensor's offset in a low-rate test: what it reads at rest, if the charge agrees.

A low-rate discharge and the charge that follows lead from full to empty and back to full. What the
cell took it has then given back, whatever the counter says: the rest is offset times time. At C/20
ten milliamperes are a fifteenth of the current, and a cell of 3.0 Ah seems to give 3.3 Ah and to
take 2.8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cellwise.identify.capacity.half_cycles import find_half_cycles, join_logs
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray


class _Limits(NamedTuple):
    """What counts as an offset; all are shares."""

    slow_rate: float = 1.0 / 9.0  # [1/h]: slower than this a usual offset counts
    idle: float = 0.4  # of the main current: below it flows no load, whatever the zero reads
    # Coulombic losses and counters of unlike gain leave some per cent of what was moved.
    noticeable: float = 0.04
    unexplained: float = 0.5  # of the surplus that may be left without the offset


LIMITS = _Limits()


class CurrentOffset(NamedTuple):
    """What a low-rate test says of its current sensor.

    offset_A : what the sensor adds to the true current [A]
    out_Ah, back_Ah : counted charge of discharge and charge, both positive [Ah]
    capacity_Ah : of the discharge with the offset taken out [Ah]
    """

    offset_A: float
    out_Ah: float
    back_Ah: float
    capacity_Ah: float


def find_current_offset(logs: Sequence[CellLog]) -> CurrentOffset | None:
    """Offset of the current sensor in a low-rate test, None where it shows none.

    The median of its readings at rest, where that is a noticeable charge over the test and explains
    most of what was counted beyond a closed round from rest to rest.

    Parameters
    ----------
    logs : sequence of CellLog        one low-rate test, or its parts in order
    """
    if not logs:
        return None
    trace = join_logs(logs)
    for first, second in pairwise(find_half_cycles(trace)):
        slow = all(
            abs(h.main_current_A) <= LIMITS.slow_rate * abs(h.charge_Ah) for h in (first, second)
        )
        if slow and first.charge_Ah * second.charge_Ah < 0.0 and first.steady_start > 0:
            break
    else:
        return None
    idle = _idle(trace.current_A, min(abs(first.main_current_A), abs(second.main_current_A)))
    before, turn = first.steady_start - 1, first.stop - 1
    later = np.flatnonzero(~idle[second.stop :])
    after = second.stop + int(later[0]) - 1 if later.size else trace.charge_Ah.size - 1
    offset = float(np.median(trace.current_A[idle])) if idle.any() else 0.0
    charge, hours = trace.charge_Ah, np.cumsum(trace.interval_s) / 3600.0
    out, back = charge[turn] - charge[before], charge[after] - charge[turn]
    surplus, added = float(out + back), offset * float(hours[after] - hours[before])
    if abs(added) < LIMITS.noticeable * 0.5 * (abs(out) + abs(back)):
        return None
    if abs(surplus - added) > LIMITS.unexplained * abs(surplus):
        return None
    taken, returned = (out, back) if out > 0.0 else (back, out)
    spent = hours[turn] - hours[before] if out > 0.0 else hours[after] - hours[turn]
    capacity = float(taken - offset * spent)
    return CurrentOffset(offset, float(taken), float(-returned), capacity)


def without_current_offset(logs: Sequence[CellLog]) -> tuple[tuple[CellLog, ...], tuple[str, ...]]:
    """Low-rate logs with their sensor's offset taken out, and what was found.

    Parameters
    ----------
    logs : sequence of CellLog             one low-rate test, or its parts in order

    Returns
    -------
    logs : tuple of CellLog       as given where nothing is taken out
    notices : tuple of str
    """
    found = find_current_offset(logs)
    if found is None:
        return tuple(logs), ()
    name = " + ".join(log.name or "a log" for log in logs)
    notice = (
        f"the current sensor of '{name}' reads {1e3 * found.offset_A:+.1f} mA at rest, and "
        f"{found.out_Ah:.3f} Ah went out and {found.back_Ah:.3f} Ah back between one state and the "
        f"same again. Taken out: {found.capacity_Ah:.3f} Ah"
    )
    return tuple(_corrected(log, found.offset_A) for log in logs), (notice,)


def _idle(current_A: FloatArray, main_A: float) -> BoolArray:
    return np.asarray(np.abs(current_A) < LIMITS.idle * main_A)


def _corrected(log: CellLog, offset_A: float) -> CellLog:
    """The log without the offset, in its current and in its counter."""
    charge = log.charge_Ah
    if charge is not None:
        charge = charge - np.cumsum(offset_A * log.interval_s) / 3600.0
    current = log.interval_current_A - offset_A
    return replace(log, current_A=current, charge_Ah=charge, current_meaning="interval_end")
