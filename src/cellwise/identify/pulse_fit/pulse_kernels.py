"""Compiled kernel of the pulse fit: the exact response of an RC branch, row by row."""

from __future__ import annotations

import math

from cellwise.cell.compiled import cached
from cellwise.typing import FloatArray

# Intervals closer than this share one exponential: float64 stamps of a log that runs for days
# jitter in the last digits.
SAME_INTERVAL = 1e-7


@cached()
def branch_response(share: FloatArray, drive: FloatArray, u: FloatArray, du: FloatArray) -> None:
    r"""Voltage of a branch of one ohm, and its derivative to log tau, from rest [V].

    .. math:: u^{+} = e^{-\Delta t/\tau} u + (1 - e^{-\Delta t/\tau}) I

    Parameters
    ----------
    share : (n,) float            intervals over the time constant [-]
    drive : (n,) float            their currents [A]
    u, du : (n,) float            results
    """
    now = change = decay = 0.0
    last = -1.0
    for k in range(share.size):
        if abs(share[k] - last) > SAME_INTERVAL * share[k]:
            last = share[k]
            decay = math.exp(-last)
        change = decay * (change + last * (now - drive[k]))
        now = drive[k] + decay * (now - drive[k])
        u[k] = now
        du[k] = change
