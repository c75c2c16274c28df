"""The current that flowed, from what was logged: shifted in time, without offset and gain."""

from __future__ import annotations

import numpy as np

from cellwise.cell.compiled import cached
from cellwise.typing import FloatArray


@cached(error_model="numpy", nogil=True)
def shift_rows(
    time_s: FloatArray,
    dt_s: FloatArray,
    current_A: FloatArray,
    skew_s: float,
    shifted_A: FloatArray,
    by_skew: FloatArray,
) -> None:
    """Mean current over every row's interval moved back by ``skew_s``, and its derivative [A/s].

    Row k's current flows from row k - 1 to row k; before the first row and after the last one the
    nearest current flows on. A negative skew moves forward.
    """
    n = time_s.size
    # At the end of row k-1's interval moved back: charge there and the current that flows there.
    charge = np.zeros(n)
    for k in range(1, n):
        charge[k] = charge[k - 1] + current_A[k] * dt_s[k]
    shifted_A[0] = current_A[0]
    by_skew[0] = 0.0
    j = 1
    last_charge, last_current, j = _at(time_s, current_A, charge, time_s[0] - skew_s, j)
    for k in range(1, n):
        here, flowing, j = _at(time_s, current_A, charge, time_s[k] - skew_s, j)
        if dt_s[k] > 0.0:
            shifted_A[k] = (here - last_charge) / dt_s[k]
            by_skew[k] = -(flowing - last_current) / dt_s[k]
        else:
            shifted_A[k] = shifted_A[k - 1]
            by_skew[k] = 0.0
        last_charge = here
        last_current = flowing


@cached(error_model="numpy", inline="always")
def _at(
    time_s: FloatArray, current_A: FloatArray, charge: FloatArray, moment: float, j: int
) -> tuple[float, float, int]:
    """Charge and current at a moment; ``j`` is the interval at which the search goes on."""
    n = time_s.size
    if moment <= time_s[0]:
        first = current_A[1] if n > 1 else current_A[0]
        return charge[0] - first * (time_s[0] - moment), first, j
    if moment >= time_s[n - 1]:
        return charge[n - 1] + current_A[n - 1] * (moment - time_s[n - 1]), current_A[n - 1], j
    while j > 1 and time_s[j - 1] >= moment:
        j -= 1
    while j < n - 1 and time_s[j] < moment:
        j += 1
    return charge[j] - current_A[j] * (time_s[j] - moment), current_A[j], j
