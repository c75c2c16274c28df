"""The LFP paper's treatment of a log: edges of the current, running mean of the voltage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.hppc.plateaus import LEVEL_ROWS, current_scale
from cellwise.typing import FloatArray

# The LFP paper's detector: weights 0.1 and 0.02 at 135 Hz, threshold 0.5 A for steps of up to
# 120 A. A weight w at the interval h is the time constant -h / ln(1 - w).
EMA_FAST_S = float(-1.0 / (135.0 * np.log1p(-0.1)))
EMA_SLOW_S = float(-1.0 / (135.0 * np.log1p(-0.02)))
EMA_THRESHOLD_OF_RANGE = 0.5 / 120.0
EMA_SIGMAS = 6.0


@dataclass(frozen=True)
class Edge:
    """A change of the current from one level to another.

    ``row`` is the first row whose interval carries something of the new current; ``time_s`` is
    when that interval begins, the instant of the change.
    """

    row: int
    time_s: float
    before_A: float
    after_A: float

    @property
    def step_A(self) -> float:
        """Change of the current [A]."""
        return self.after_A - self.before_A


def ema_edges(
    current_A: FloatArray,
    time_s: FloatArray,
    *,
    threshold_A: float | None = None,
    fast_s: float = EMA_FAST_S,
    slow_s: float = EMA_SLOW_S,
) -> tuple[Edge, ...]:
    r"""Edges by the difference of two exponential averages, the LFP paper's equations (5), (6).

    .. math:: r_i(a) = a I_i + (1 - a) r_{i-1}, \qquad \Delta_i = r_i(a_f) - r_i(a_s)

    An edge begins at the first row at which :math:`|\Delta|` exceeds the threshold and is over
    when it falls below again or changes its sign. Two edges closer than the slow average are seen
    as one where they have the same sign: that is the method's own limit.

    Parameters
    ----------
    current_A, time_s : (n,) float     finite; time never decreasing
    threshold_A : float                at 135 Hz [A]; default 0.5 A per 120 A of range, and not
                                       below six standard deviations of the noise in Delta
    fast_s, slow_s : float             time constants of the averages [s]; defaults are the
                                       paper's weights 0.1 and 0.02 at 135 Hz

    Notes
    -----
    The paper samples at 135 Hz throughout. Here the weight of each sample follows its own
    interval, a = 1 - exp(-dt/T), and the threshold follows the response to a step, so that the
    same step is found whatever the rate: at 1 Hz the slow average follows a step almost at once
    and leaves only 6.5 % of it in Delta.
    """
    _check(current_A, time_s)
    scale = current_scale(current_A)
    dt = np.diff(time_s, prepend=time_s[0])
    fast, slow = -np.expm1(-dt / fast_s), -np.expm1(-dt / slow_s)
    delta = _average(current_A, fast) - _average(current_A, slow)
    at_135 = threshold_A if threshold_A is not None else EMA_THRESHOLD_OF_RANGE * scale.range_A
    response = _step_response(dt, fast_s, slow_s)
    bound = at_135 * response / _step_response(np.array([1.0 / 135.0]), fast_s, slow_s)
    if threshold_A is None:
        both = np.maximum(fast + slow - fast * slow, 1e-300)
        gain = fast / (2.0 - fast) + slow / (2.0 - slow) - 2.0 * fast * slow / both
        bound = np.maximum(bound, EMA_SIGMAS * scale.noise_A * np.sqrt(np.maximum(gain, 0.0)))
    side = np.where(np.abs(delta) > bound, np.sign(delta), 0.0)
    starts = np.flatnonzero((side != 0.0) & (np.concatenate(([0.0], side[:-1])) != side))
    ends = np.append(starts[1:], current_A.size) if starts.size else starts
    begins = np.concatenate(([0], starts[:-1])) if starts.size else starts
    edges = []
    for begin, row, end in zip(begins.tolist(), starts.tolist(), ends.tolist(), strict=True):
        calm = np.flatnonzero(side[row:end] == 0.0)
        after = row + int(calm[0]) if calm.size else end - 1
        edges.append(
            Edge(
                row=row,
                time_s=float(time_s[max(row - 1, 0)]),
                before_A=float(np.median(current_A[max(begin, row - LEVEL_ROWS) : max(row, 1)])),
                after_A=float(np.median(current_A[after : min(end, after + LEVEL_ROWS)])),
            )
        )
    return tuple(edges)


def _check(current_A: FloatArray, time_s: FloatArray) -> None:
    if current_A.ndim != 1 or current_A.shape != time_s.shape or current_A.size < 2:
        raise InputError(
            f"current of shape {current_A.shape} and time of shape {time_s.shape}",
            "two arrays of one length, at least two rows",
            "Give every current its time.",
        )
    if not np.all(np.isfinite(current_A)):
        raise InputError(
            f"{int(np.count_nonzero(~np.isfinite(current_A)))} current samples that are not finite",
            "a finite current in every row",
            "Fill them first, as CellLog.known_current_A does.",
        )


def _average(x: FloatArray, weight: FloatArray) -> FloatArray:
    """Exponential average with a weight per sample, from the first sample on, shape (n,).

    The recursion is cut into about sqrt(n) blocks that are stepped side by side from zero, then
    joined: the same numbers as a loop over all rows.
    """
    n = x.size
    width = int(np.ceil(np.sqrt(n)))
    count = -(-n // width)
    a = np.zeros(count * width)
    y = np.zeros(count * width)
    a[:n], y[:n] = weight, weight * x
    keep = np.ascontiguousarray(1.0 - a.reshape(count, width).T)
    y = np.ascontiguousarray(y.reshape(count, width).T)
    for k in range(1, width):
        y[k] += keep[k] * y[k - 1]
        keep[k] *= keep[k - 1]
    carry = np.empty(count)
    value = float(x[0])
    for k in range(count):
        carry[k] = value
        value = float(y[-1, k] + keep[-1, k] * value)
    y += keep * carry
    return y.T.reshape(-1)[:n]


def _step_response(dt: FloatArray, fast_s: float, slow_s: float) -> FloatArray:
    """Largest difference of the averages after a unit step sampled every dt."""
    peak_s = np.log(slow_s / fast_s) * fast_s * slow_s / (slow_s - fast_s)
    h = np.maximum(dt, 1e-9)
    t = h * np.maximum(np.round(peak_s / h), 1.0)
    response: FloatArray = np.exp(-t / slow_s) - np.exp(-t / fast_s)
    return response


HALF_WIDTH = 5


def running_mean(
    values: FloatArray, half_width: int = HALF_WIDTH, *, edges: Sequence[int] = ()
) -> FloatArray:
    r"""Mean over the sample itself and ``half_width`` samples on either side.

    .. math:: \bar U_i = \frac{1}{2N+1} \sum_{j=-N}^{N} U_{i+j}

    Equation (7) of the LFP paper, with N = 5. A straight line passes unchanged. Towards the ends,
    where there are fewer than N samples on one side, N shrinks on both, so that the mean stays
    symmetric and a line still passes unchanged.

    Parameters
    ----------
    values : (n,) float
    half_width : int           N >= 0; 0 returns the values
    edges : sequence of int    rows at which a new stretch begins, as the rows of current edges:
                               no mean reaches across them. The paper's own filter has none and
                               smears the first drop of a pulse over 2N+1 samples, which takes the
                               fast part of the response from R0 and R1

    Returns
    -------
    (n,) float      NaN where a sample in reach is NaN

    Raises
    ------
    InputError      a negative half width, an edge outside the rows
    """
    x = np.asarray(values, dtype=np.float64)
    if half_width < 0:
        raise InputError(f"half_width = {half_width}", "0 or more", "Give the N of 2N+1 samples.")
    rows = np.unique(np.asarray(edges, dtype=np.int64)) if len(edges) else np.zeros(0, np.int64)
    if rows.size and (rows[0] < 0 or rows[-1] > x.size):
        raise InputError(
            f"an edge at row {int(rows[0] if rows[0] < 0 else rows[-1])}",
            f"rows from 0 to {x.size}",
            "Take the edges from the same log as the values.",
        )
    if x.size == 0 or half_width == 0:
        return x.copy()
    bounds = np.unique(np.concatenate(([0], rows, [x.size])))
    length = np.diff(bounds)
    first = np.repeat(bounds[:-1], length)
    last = np.repeat(bounds[1:] - 1, length)
    at = np.arange(x.size)
    reach = np.minimum(half_width, np.minimum(at - first, last - at))
    # Sums of differences to the mean: cumulated absolute values would lose digits in long logs.
    known = np.isfinite(x)
    centre = float(np.mean(x[known])) if known.any() else 0.0
    total = np.concatenate(([0.0], np.cumsum(np.where(known, x - centre, 0.0))))
    missing = np.concatenate(([0], np.cumsum(~known)))
    low, high = at - reach, at + reach + 1
    mean: FloatArray = centre + (total[high] - total[low]) / (high - low)
    mean[missing[high] > missing[low]] = np.nan
    return mean
