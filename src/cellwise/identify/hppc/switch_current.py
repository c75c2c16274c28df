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
# The counter is believed where nine of ten steady rows agree with the current within this share.
AGREES, AGREEING, LEAST_ROWS = 0.05, 0.9, 10


def with_switch_current(log: CellLog) -> CellLog:
    """The log with the mean current in the rows of its switches, as its counter has it.

    Unchanged where there is no counter, where it is too coarse for single rows, and in every row in
    which it says what the current says.
    """
    if log.charge_Ah is None:
        return log
    current, dt = log.interval_current_A, log.interval_s
    largest = float(np.nanmax(np.abs(current)))
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = 3600.0 * np.diff(log.charge_Ah, prepend=log.charge_Ah[0]) / dt
    step = np.diff(current, prepend=current[0])
    known = np.isfinite(mean) & np.isfinite(step) & (dt > 0.0)
    steady = known & (np.abs(step) < STEADY_OF_RANGE * largest)
    steady &= np.abs(current) > SWITCH_OF_RANGE * largest
    if np.count_nonzero(steady) < LEAST_ROWS:
        return log
    apart = np.abs(mean[steady] - current[steady]) / np.abs(current[steady])
    if float(np.quantile(apart, AGREEING)) > AGREES:
        return log
    switch = known & (np.abs(step) > SWITCH_OF_RANGE * largest)
    share = np.where(switch, (current - mean) / np.where(step == 0.0, 1.0, step), 0.0)
    # The share of the interval in which the old level still flowed.
    late = switch & (share > AGREES) & (share < 1.0 + AGREES)
    if not late.any():
        return log
    return replace(log, current_A=np.where(late, mean, current), current_meaning="interval_end")
