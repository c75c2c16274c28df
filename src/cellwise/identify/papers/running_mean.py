"""Symmetric running mean: the voltage filter of the LFP paper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellwise.errors import InputError
from cellwise.typing import FloatArray

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
