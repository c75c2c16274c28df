"""What each target computes in its own way, in float64.

In float32 these are functions of :mod:`cellwise.estimate.fixed.arithmetic` of the same names, whose
bits are the same on every target.
"""

from __future__ import annotations

import math

from cellwise.cell.compiled import inline


@inline
def magnitude(x: float) -> float:
    """Absolute value."""
    return math.fabs(x)


@inline
def positive_above(x: float, y: float) -> bool:
    """Whether x > y, neither of them negative or NaN."""
    return x > y


@inline
def root(square: float) -> float:
    """Square root."""
    return math.sqrt(square)


@inline
def log_of_more(z: float) -> float:
    """ln(1 + z) for z >= 0."""
    return math.log1p(z)
