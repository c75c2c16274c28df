"""Compiled kernels of the pulse fit: where in the plane of log tau1 and log tau2 to go next."""

from __future__ import annotations

import math

from cellwise.cell.compiled import cached
from cellwise.typing import FloatArray

LONGEST_BOOST = 32.0


@cached()
def _inside(p1: float, p2: float, limits: FloatArray) -> bool:
    """Whether (log tau1, log tau2) keeps the limits, to rounding."""
    slack = 1e-9
    return bool(
        p1 >= limits[0] - slack
        and p1 <= limits[1] + slack
        and p2 >= limits[2] - slack
        and p2 <= limits[3] + slack
        and p2 - p1 >= limits[4] - slack
    )


@cached()
def bounded_step(
    h11: float,
    h12: float,
    h22: float,
    g1: float,
    g2: float,
    p1: float,
    p2: float,
    limits: FloatArray,
    step: FloatArray,
) -> None:
    """Minimum of the quadratic model within the limits, exactly: inside, on a side, or a corner.

    ``limits`` = (min, max of log tau1; min, max of log tau2; min of log tau2 - log tau1).
    """
    determinant = max(h11 * h22 - h12 * h12, 1e-14 * h11 * h22, 1e-300)
    step[0] = (h22 * g1 - h12 * g2) / determinant
    step[1] = (h11 * g2 - h12 * g1) / determinant
    if _inside(p1 + step[0], p2 + step[1], limits):
        return
    best = math.inf
    for side in range(5):
        # A side is the line base + s * direction; find its part that keeps the other limits.
        if side < 2:
            base1, base2, d1, d2 = limits[side] - p1, 0.0, 0.0, 1.0
        elif side < 4:
            base1, base2, d1, d2 = 0.0, limits[side] - p2, 1.0, 0.0
        else:
            base1, base2, d1, d2 = 0.0, p1 + limits[4] - p2, 1.0, 1.0
        low, high = -math.inf, math.inf
        if d1 != 0.0:
            low, high = max(low, limits[0] - p1 - base1), min(high, limits[1] - p1 - base1)
        if d2 != 0.0:
            low, high = max(low, limits[2] - p2 - base2), min(high, limits[3] - p2 - base2)
        gap = p2 + base2 - p1 - base1 - limits[4]
        if d2 > d1:
            low = max(low, -gap)
        elif d1 > d2:
            high = min(high, gap)
        if low > high + 1e-12:
            continue
        curve = h11 * d1 * d1 + 2.0 * h12 * d1 * d2 + h22 * d2 * d2
        pull = (g1 - h11 * base1 - h12 * base2) * d1 + (g2 - h12 * base1 - h22 * base2) * d2
        s = min(max(pull / curve if curve > 0.0 else 0.0, low), high)
        t1, t2 = base1 + s * d1, base2 + s * d2
        value = 0.5 * (h11 * t1 * t1 + 2 * h12 * t1 * t2 + h22 * t2 * t2) - g1 * t1 - g2 * t2
        if value < best:
            best = value
            step[0], step[1] = t1, t2


@cached()
def within(x: float, low: float, high: float) -> float:
    """``x`` limited to [low, high]."""
    return min(max(x, low), high)


@cached()
def next_boost(boost: float, step: FloatArray, last1: float, last2: float) -> float:
    """Factor on the next step: longer while steps follow each other, half where they alternate.

    Where a real cell is no 2-RC circuit the residual is large, and Gauss-Newton creeps along the
    valley by nearly equal steps, or swings across it by nearly opposite ones.
    """
    length = math.hypot(step[0], step[1])
    last = math.hypot(last1, last2)
    if length <= 0.5 * last:
        return 1.0
    along = step[0] * last1 + step[1] * last2
    if along > 0.9 * length * last:
        return min(2.0 * boost, LONGEST_BOOST)
    return 0.5 if along < -0.9 * length * last else 1.0
