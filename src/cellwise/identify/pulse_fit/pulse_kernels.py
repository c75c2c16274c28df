"""Compiled kernel of the pulse fit: the exact response of an RC branch, row by row."""

from __future__ import annotations

import math

from cellwise.cell.compiled import cached
from cellwise.typing import FloatArray

# Sampling intervals closer than this share one exponential: float64 stamps of a log that runs
# for days jitter in the last digits.
SAME_INTERVAL = 1e-7


@cached()
def branch_response(
    dt: FloatArray, current: FloatArray, tau: float, u: FloatArray, du: FloatArray
) -> None:
    r"""Voltage of a branch of one ohm, and its derivative to log tau, from rest [V].

    .. math:: u^{+} = e^{-\Delta t/\tau} u + (1 - e^{-\Delta t/\tau}) I

    Parameters
    ----------
    dt, current : (n,) float      intervals [s] and their currents [A]
    tau : float                   time constant [s]
    u, du : (n,) float            results
    """
    now = change = share = decay = 0.0
    last_dt = -1.0
    for k in range(dt.size):
        if abs(dt[k] - last_dt) > SAME_INTERVAL * dt[k]:
            last_dt = dt[k]
            share = dt[k] / tau
            decay = math.exp(-share)
        change = decay * (change + share * (now - current[k]))
        now = current[k] + decay * (now - current[k])
        u[k] = now
        du[k] = change
