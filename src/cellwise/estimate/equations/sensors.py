"""Which readings a sensor cannot have meant, and how far a SOC is off that nobody counted."""

from __future__ import annotations

from cellwise.cell.compiled import inline
from cellwise.cell.equations.double import magnitude, root
from cellwise.cell.equations.scalar import at_least, at_most
from cellwise.estimate.equations.constants import DEAD_SWINGS, SWINGS_MOST


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


@inline
def is_frozen(change_A: float, r0_ohm: float, innovation_V: float, frozen_V: float) -> bool:
    """Whether a voltage that repeats itself, but for its last digits, must have moved.

    R0 times the change of current says so, and the prediction is off by half of that: a held
    voltage (the end of a charge) repeats itself, too, but the model expects it there.
    """
    moved_V = magnitude(r0_ohm * change_A)
    return moved_V > frozen_V and magnitude(innovation_V) > 0.5 * moved_V


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
