"""The tester's own charge counter against the current."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cellwise.logs.measured_log import MeasuredLog
from cellwise.typing import BoolArray, FloatArray

RESTART_SHARE = 0.1
RESTART_STEPS = 5.0
RESTART_OF_RANGE = 1e-3
JOINED_RESIDUAL = 0.5


class CounterCheck(NamedTuple):
    """Counter and summed current compared, gaps left out.

    ``factor`` is the counter per ampere hour of summed current (least squares), ``agreement``
    their correlation over the log, ``mismatch_percent`` the difference of the net charges in
    percent of the charge moved, ``throughput_Ah`` the charge moved according to the current.
    """

    factor: float
    agreement: float
    mismatch_percent: float
    throughput_Ah: float


def compare_counter(log: MeasuredLog) -> CounterCheck | None:
    """Compare the tester's counter with the sum of the current.

    The current of a row is held over the interval it belongs to; the trapezoid would be wrong
    wherever a tester logs a step late.

    Returns
    -------
    CounterCheck, or None without a counter, without current or with a counter that stands still
    """
    if log.charge_Ah is None or np.count_nonzero(np.isfinite(log.charge_Ah)) < 2:
        return None
    return compare_steps(*charge_steps(log))


def compare_steps(drawn: FloatArray, counted: FloatArray) -> CounterCheck | None:
    """`compare_counter` for the charges of `charge_steps`."""
    summed, counter = np.cumsum(drawn), np.cumsum(counted)
    difference = float(summed[-1] - counter[-1])
    summed -= summed.mean()
    counter -= counter.mean()
    moved = float(summed @ summed)
    read = float(counter @ counter)
    if moved == 0.0 or read == 0.0:
        return None
    throughput = float(np.sum(np.abs(drawn)))
    return CounterCheck(
        factor=float(summed @ counter) / moved,
        agreement=float(summed @ counter) / np.sqrt(moved * read),
        mismatch_percent=100.0 * abs(difference) / throughput,
        throughput_Ah=throughput,
    )


def charge_steps(log: MeasuredLog) -> tuple[FloatArray, FloatArray]:
    """Charge of every interval [Ah] by the current and by the counter, shape (n,), zero over gaps.

    Where the counter is missing its steps are gathered in the next row that has one.
    """
    drawn = replace(log, charge_Ah=None).known_current_A() * log.interval_s / 3600.0
    counter = log.charge_Ah if log.charge_Ah is not None else np.zeros(len(log))
    read = np.isfinite(counter)
    last = np.maximum.accumulate(np.where(read, np.arange(counter.size), 0))
    held = counter[last]
    held[np.isnan(held)] = counter[read][0]
    counted = np.diff(held, prepend=held[0])
    gaps = log.gap_rows
    drawn[gaps] = 0.0
    counted[gaps] = 0.0
    return drawn, counted


def joined_counter(
    counter: FloatArray, drawn: FloatArray, gap_rows: BoolArray
) -> tuple[FloatArray, int] | None:
    """The counter with its restarts joined up, and how many there were; None where none was seen.

    A counter has restarted at a row where it reads what flowed during this one interval, and not
    that plus what it read before. The current carries it over that interval.

    Parameters
    ----------
    counter : (n,) float        [Ah], finite
    drawn : (n,) float          charge of each interval by the current [Ah], see `charge_steps`
    gap_rows : (n,) bool        intervals of which the current knows nothing
    """
    moves = np.diff(counter)
    jump = moves - drawn[1:]
    fresh = np.abs(counter[1:] - drawn[1:])
    np.abs(moves, out=moves)
    step = float(np.min(moves[moves > 1e-9], initial=np.inf))
    if not np.isfinite(step):
        return None
    least = max(RESTART_STEPS * step, RESTART_OF_RANGE * float(np.ptp(counter)))
    restarts = (np.abs(jump) > least) & (fresh < RESTART_SHARE * np.abs(jump)) & ~gap_rows[1:]
    if not restarts.any():
        return None
    joined = counter - np.concatenate(([0.0], np.cumsum(np.where(restarts, jump, 0.0))))
    summed = np.cumsum(drawn)
    if np.std(joined - summed) > JOINED_RESIDUAL * np.std(counter - summed):
        return None  # a counter and a current that merely differ
    return joined, int(np.count_nonzero(restarts))


def counts_throughput(drawn: FloatArray, counted: FloatArray) -> bool:
    """The counter adds charge and discharge alike, so it does not contain the net charge."""
    summed, moved, counter = np.cumsum(drawn), np.cumsum(np.abs(drawn)), np.cumsum(counted)
    return _correlation(moved, counter) > 0.999 > 1.02 * abs(_correlation(summed, counter))


def _correlation(x: FloatArray, y: FloatArray) -> float:
    a, b = x - x.mean(), y - y.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else 0.0
