"""When a gauge loses its power, and what that costs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellwise.benchmark.certify.gauge import RESTART, SAVE, TORN, UPDATED
from cellwise.typing import BoolArray, FloatArray

SAVE_S = 600.0  # between two writes of what is kept over a restart
GAP_S = 60.0  # of samples, beyond which the power was off
OFF_H, REST_C = (1.0, 4.0), 0.01  # how long the power is lost, and the load that a rest has at most
# When, as shares of a life: in the middle of a write; for hours; and tables are updated.
RESTARTS = ((TORN, 0.25, 0.40), (RESTART, 0.50, 0.65), (UPDATED, 0.70, 0.85))


def power_events(
    time_s: FloatArray, loaded: BoolArray, rng: np.random.Generator, restarts: bool = True
) -> tuple[NDArray[Any], BoolArray]:
    """The event before each sample, and whether the power is on at it, both of shape (n,).

    It is off for hours in a rest; a load or a charger switches it on. Without ``restarts`` tables
    are updated, and no power is lost but where the log has a gap.
    """
    event = np.zeros(time_s.size, dtype=np.uint32)
    on = np.ones(time_s.size, dtype=np.bool_)
    event[1:][np.diff(np.floor(time_s / SAVE_S)) > 0] = SAVE
    event[1:][np.diff(time_s) > GAP_S] = RESTART  # of the log: whoever logged was off
    for kind, low, high in RESTARTS:
        first = int(np.searchsorted(time_s, float(rng.uniform(low, high)) * time_s[-1]))
        off_s = 3600.0 * float(rng.uniform(*OFF_H))
        back = first
        if kind == RESTART:
            first += int(np.argmin(loaded[first:]))
            ends = first + int(np.argmax(np.append(loaded[first:], True)))
            back = min(ends, int(np.searchsorted(time_s, time_s[first] + off_s)))
        if restarts or kind == UPDATED:
            on[first:back] = False
            event[min(back, event.size - 1)] = kind
    return event, on


def restart_loss(
    event: NDArray[Any], written: BoolArray, error: FloatArray, truth: FloatArray
) -> float:
    """Largest growth of the error over a restart, beyond what flowed since the last write.

    ``written`` says before which samples a record came down whole.
    """
    flowed = np.cumsum(np.abs(np.diff(truth, prepend=truth[0])))
    rows = np.arange(event.size)
    last = np.maximum.accumulate(np.where(written, rows, 0))
    at = np.flatnonzero(event[1:] >= RESTART) + 1
    since = flowed[at] - flowed[np.maximum(last[at] - 1, 0)]
    grown = np.abs(error[at]) - np.abs(error[at - 1]) - since
    return float(np.max(np.where(np.isfinite(grown), grown, 1.0), initial=0.0))
