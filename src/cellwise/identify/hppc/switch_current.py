"""Current of the rows in which a tester switches, by its counter.

A logger on its own clock writes the current of the moment. In the row after a switch that is the
new level, though the old one flowed for part of the interval: at a row every ten seconds a step
seems to begin five seconds early, and its ohmic drop seems smaller. The counter knows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellwise.logs.cell_log import CellLog

SWITCH_OF_RANGE = 0.2  # a change by this share of the largest current is a switch
STEADY_OF_RANGE = 0.02
# The counter is as good as nine of ten steady rows agree with their current; what it says of a
# switch counts beyond so many times that, and beyond this share of the interval.
AGREEING, BEYOND, LEAST_SHARE, LEAST_ROWS = 0.9, 3.0, 0.05, 10


def with_switch_current(log: CellLog) -> CellLog:
    """The log with the mean current in the rows of its switches, as its counter has it.

    Unchanged where there is no counter, where it is too coarse for single rows, and in every row in
    which it says what the current says.
    """
    if log.charge_Ah is None:
        return log
    current, dt = log.interval_current_A, log.interval_s
    largest = float(np.nanmax(np.abs(current)))
    counted = 3600.0 * np.diff(log.charge_Ah, prepend=log.charge_Ah[0])
    step = np.diff(current, prepend=current[0])
    known = np.isfinite(counted) & np.isfinite(step) & (dt > 0.0)
    steady = known & (np.abs(step) < STEADY_OF_RANGE * largest)
    steady &= np.abs(current) > SWITCH_OF_RANGE * largest
    if np.count_nonzero(steady) < LEAST_ROWS:
        return log
    apart = np.where(known, counted - current * dt, 0.0)
    scatter = float(np.quantile(np.abs(apart[steady]), AGREEING))
    switch = known & (np.abs(step) > SWITCH_OF_RANGE * largest) & (np.abs(apart) > BEYOND * scatter)
    # The share of the interval in which the old level still flowed.
    moved = np.where(switch, step * dt, 1.0)
    share = np.where(switch, -apart / moved, 0.0)
    late = (share > LEAST_SHARE) & (share < 1.0 + LEAST_SHARE)
    if not late.any():
        return log
    mean = current - share * step
    return replace(log, current_A=np.where(late, mean, current), current_meaning="interval_end")
