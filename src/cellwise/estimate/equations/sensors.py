"""Which readings a sensor cannot have meant, and how far a SOC is off that nobody counted."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations.double import magnitude, root
from cellwise.cell.equations.scalar import at_least, at_most
from cellwise.estimate.equations.constants import (
    DEAD_SWINGS,
    DITHER_V,
    FOUND_FROZEN,
    FROZEN_READINGS,
    SWINGS_MOST,
)


@inline
def swings_after(swings: float, moved_V: float, frozen_V: float) -> float:
    """How often the voltage has gone up and down under a current that repeats itself.

    A constant current moves a voltage one way. Where it goes both ways by as much as would call a
    voltage frozen, nobody measures the current. The sign is that of the last move.
    """
    count = at_most(magnitude(swings) + 1.0, SWINGS_MOST)
    after = swings
    if magnitude(moved_V) > frozen_V and not (swings * moved_V > 0.0):
        after = count if moved_V > 0.0 else -count
    return after


@inline
def is_dead(swings: float) -> bool:
    """Whether a current that repeats itself is not measured at all."""
    return magnitude(swings) >= DEAD_SWINGS


class HeldVoltage(NamedTuple):
    """The last reading of a voltage, the current when it came, and how often it has come since."""

    voltage_V: float
    since_A: float
    repeats: float


@inline
def repeats_after(
    last_V: float,
    since_A: float,
    repeats: float,
    voltage_V: float,
    current_A: float,
    r0_ohm: float,
    innovation_V: float,
    frozen_V: float,
) -> HeldVoltage:
    """After a voltage: FOUND_FROZEN of them where it is frozen, and so until it changes.

    It repeats itself, but for its last digits, where R0 times the change of current says that it
    must have moved, and the prediction is off by half of that: a held voltage (the end of a charge)
    repeats itself, too, but the model expects it there.
    """
    held_V = voltage_V
    held_A = current_A
    count = 0.0
    if magnitude(voltage_V - last_V) <= DITHER_V:
        held_V = last_V
        held_A = since_A
        count = at_most(repeats + 1.0, FROZEN_READINGS)
        moved_V = magnitude(r0_ohm * (current_A - since_A))
        frozen = moved_V > frozen_V and magnitude(innovation_V) > 0.5 * moved_V
        if repeats >= FOUND_FROZEN or (count >= FROZEN_READINGS and frozen):
            count = FOUND_FROZEN
    return HeldVoltage(held_V, held_A, count)


@inline
def unseen_variance(gap_variance: float, gap_A2: float, lost_A2: float, per_A: float) -> float:
    """SOC's variance of what may have flowed unseen over a gap.

    The currents on either side, or half a rate, for as long as it lasts (``per_A`` is the SOC that
    one ampere moves in it), and no more than ``gap_variance``.
    """
    return at_most((per_A * per_A) * at_least(gap_A2, lost_A2), gap_variance)


@inline
def drifted_variance(variance: float, moved: float) -> float:
    """SOC's variance after an interval of which nobody knows the current.

    It may keep one sign for as long as it is away: the deviation grows, not the variance.
    """
    deviation = root(variance) + moved
    return deviation * deviation
