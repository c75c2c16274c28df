"""Logs whose voltage is a model's own, replays that know the truth, and when a discharge ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellwise.cell.simulate import simulate
from cellwise.estimate.replay import Replay
from cellwise.estimate.trace import Trace
from cellwise.fit.start import InitialSoc
from cellwise.logs.cell_log import CellLog

CUTOFF_V = 3.2


def discharge(model, current, soc0, dt=1.0):
    """A log of that current, its voltage the model's own."""
    time = dt * np.arange(current.size)
    log = CellLog(time, current, np.full(current.size, 3.7), name="flight")
    found = simulate(model, log, soc0)
    return replace(log, voltage_V=found.voltage_V), found


def known_replay(log, soc, std=0.0):
    """A replay whose filter knows the truth."""
    n = len(log)
    trace = Trace(
        log.time_s, soc, np.full(n, std), *(np.zeros(n) for _ in range(4)), np.zeros(n, np.int32)
    )
    return Replay(log, "truth", InitialSoc(float(soc[0]), std, "given"), trace, 0.0, None)


def until(log, soc, cutoff):
    """Time and energy from the first row until the voltage or the charge is at its end."""
    ended = np.flatnonzero((log.voltage_V <= cutoff) | (soc <= 0.0))
    k = int(ended[0])
    energy = np.sum(log.current_A[1 : k + 1] * log.voltage_V[1 : k + 1] * log.interval_s[1 : k + 1])
    return float(log.time_s[k]), float(energy) / 3600.0
