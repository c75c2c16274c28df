"""Sums over a trace, in one pass: what a replay's figures are made of."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import cached
from cellwise.typing import FloatArray, IntArray


class TraceSums(NamedTuple):
    """What is known of the innovations, which NIS were used, what the status said.

    ``squares_V2`` is the sum of the known innovations' squares, ``nis`` that of the NIS of voltages
    that were used, ``rejected`` counts rows, ``status`` has every bit that was ever set.
    """

    known: int
    squares_V2: float
    used: int
    nis: float
    rejected: int
    status: int


@cached(error_model="numpy", nogil=True)
def trace_sums(
    innovation_V: FloatArray,
    variance_V2: FloatArray,
    status: IntArray,
    unused: int,
    rejected: int,
) -> TraceSums:
    """Sums over the rows; ``unused`` are the bits of voltages that did not count."""
    known, used, rejections, bits = 0, 0, 0, 0
    squares, nis = 0.0, 0.0
    for k in range(innovation_V.size):
        bits |= status[k]
        if status[k] & rejected:
            rejections += 1
        square = innovation_V[k] * innovation_V[k]
        if not math.isfinite(square):
            continue
        known += 1
        squares += square
        if status[k] & unused:
            continue
        ratio = square / variance_V2[k]
        if math.isfinite(ratio):
            used += 1
            nis += ratio
    return TraceSums(known, squares, used, nis, rejections, bits)
