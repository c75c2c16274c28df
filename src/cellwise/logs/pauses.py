"""Pauses that nobody counted: what lies behind one is a log of its own."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

from cellwise.logs.measured_log import MeasuredLog

Log = TypeVar("Log", bound=MeasuredLog)

PAUSE_S = 300.0  # what flows unseen in less hardly moves the SOC
FEWEST_VOLTAGES = 30  # a shorter stretch says less than it costs to find where it begins


def uncounted_pauses(log: MeasuredLog) -> tuple[int, ...]:
    """Rows that end a pause of minutes over which no counter went on.

    A car that is switched off may be charged meanwhile: where its SOC is then, nobody knows.
    """
    long = np.flatnonzero(log.gap_rows & (log.interval_s > PAUSE_S))
    if log.charge_Ah is None:
        return tuple(map(int, long))
    return tuple(int(k) for k in long if not np.isfinite(log.charge_Ah[k - 1 : k + 1]).all())


def cut_at_pauses(log: Log) -> tuple[Log, ...]:
    """The stretches between such pauses, as logs with their time in the name; the log without one.

    What is too short to say anything is left away; a stated start and the notices of reading
    stay with the first stretch.
    """
    rows = uncounted_pauses(log)
    if not rows:
        return (log,)
    found: list[Log] = []
    for first, stop in pairwise((0, *rows, len(log))):
        part = log.part(first, stop)
        if np.count_nonzero(np.isfinite(part.voltage_V)) < FEWEST_VOLTAGES:
            continue
        name = f"{log.name}, {log.time_s[first]:.0f} s" if first else log.name
        found.append(replace(part, name=name, notices=() if found else log.notices))
    return tuple(found) or (log,)
