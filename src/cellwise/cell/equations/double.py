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
def unit_of(y: float) -> float:
    """The unit in which a ratio over ``y`` goes on: ``y`` itself, so that nobody waits for it."""
    return y


@inline
def in_units(x: float, y: float) -> float:
    """The ratio x / y in that unit."""
    return x


@inline
def root(square: float) -> float:
    """Square root."""
    return math.sqrt(square)


@inline
def log_of_more(z: float) -> float:
    """ln(1 + z) for z >= 0."""
    return math.log1p(z)


@inline
def size_below(x: float, limit: float) -> bool:
    """Whether the absolute value is below the limit; false for NaN."""
    return math.fabs(x) < limit


@inline
def positive_within(x: float, low: float, high: float) -> bool:
    """Within low..high, both of them positive; false for NaN."""
    return low <= x <= high


@inline
def risen(z: float) -> float:
    """1 - exp(-z) for z >= 0."""
    return -math.expm1(-z)


@inline
def vanishing(z: float) -> float:
    """exp(-z) for z >= 0."""
    return math.exp(-z)


@inline
def add(total: float, carry: float, value: float) -> tuple[float, float]:
    """A sum: rounding keeps nothing that matters."""
    return total + value, carry
