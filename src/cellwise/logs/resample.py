"""A log on an even time step, as an embedded target would see it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

LARGEST = 100_000_000  # rows; beyond it a step is a slip of the unit


def resample(log: CellLog, dt_s: float) -> CellLog:
    """Rows every ``dt_s`` seconds: mean current of the interval, last voltage and temperature.

    The charge of every interval is kept. A step that holds no measured voltage gets none (NaN),
    so that a pause stays a pause for a filter; the counter is read at the step's end.

    Raises
    ------
    InputError        a step that is not above zero, longer than the log, or beyond any memory
    """
    if not (np.isfinite(dt_s) and dt_s > 0):
        raise InputError(f"a time step of {dt_s} s", "a step above zero", "Give `dt_s=1.0`.")
    if dt_s > log.duration_s:
        raise InputError(
            f"a time step of {dt_s:g} s for a log of {log.duration_s:g} s",
            "a step shorter than the log",
            "Give a shorter step.",
        )
    if log.duration_s / dt_s > LARGEST:
        raise InputError(
            f"a time step of {dt_s:g} s for a log of {log.duration_s:g} s",
            f"at most {LARGEST:,} steps",
            "Give the step in seconds.",
        )
    start = float(log.time_s[0])
    steps = int(np.floor(log.duration_s / dt_s + 1e-9))
    grid: FloatArray = start + dt_s * np.arange(steps + 1, dtype=np.float64)
    current = log.known_current_A()
    charge = np.cumsum(current * log.interval_s)
    at = np.interp(grid, log.time_s, charge)
    mean = np.diff(at, prepend=at[0]) / dt_s
    mean[0] = current[0]
    last = np.searchsorted(log.time_s, grid + 1e-9, side="right") - 1
    fresh = log.time_s[last] > grid - dt_s + 1e-9
    fresh[0] = True

    def held(values: FloatArray | None) -> FloatArray | None:
        return None if values is None else values[last]

    counter = None
    if log.charge_Ah is not None:
        counter = np.interp(grid, log.time_s, log.charge_Ah)
    return replace(
        log,
        time_s=grid,
        current_A=mean,
        voltage_V=np.where(fresh, log.voltage_V[last], np.nan),
        temperature_C=held(log.temperature_C),
        charge_Ah=counter,
        step=None if log.step is None else log.step[last],
        current_meaning="interval_end",
    )
