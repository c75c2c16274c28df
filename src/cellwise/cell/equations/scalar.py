"""Equations of single numbers, compiled in float64 and in float32, and printed as C.

They are written in the subset of Python that has a C: see :mod:`cellwise.printing`.
"""

from __future__ import annotations

from cellwise.cell.compiled import inline
from cellwise.cell.equations.double import magnitude


@inline
def at_least(x: float, low: float) -> float:
    """Held above low."""
    return low if x < low else x


@inline
def at_most(x: float, high: float) -> float:
    """Held below high."""
    return x if x < high else high


@inline
def clip(x: float, low: float, high: float) -> float:
    """Held within low..high."""
    return low if x < low else (high if x > high else x)


@inline
def distance_beyond(x: float, low: float, high: float) -> float:
    """How far a number is outside of low..high, 0 within."""
    return at_least(at_least(low - x, x - high), 0.0)


@inline
def exponential_rise(x: float) -> float:
    """What an exponential adds to 1, to its third order: an embedded target has no other."""
    return x * (1.0 + (x * (0.5 + (x * (1.0 / 6.0)))))


@inline
def charge_transfer(overvoltage: float) -> float:
    """Factor on a resistance whose voltage follows asinh, asinh(y) / y, 1 at small currents.

    y is its resistance times the current over that voltage. As a fraction that is within 0.05 % of
    it up to y = 60, because an embedded target has no logarithm whose bits are the same everywhere.
    """
    y = magnitude(overvoltage)
    above = 1.0 + (y * (0.66171232 + (y * (0.42143288 + (y * 0.01126451)))))
    below = 0.66171232 + (y * (0.59291773 + (y * (0.11957555 + (y * 0.00170013)))))
    return above / (1.0 + (y * below))
