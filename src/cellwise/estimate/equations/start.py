"""What the branches of a cell may hold that nobody has seen before."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations.double import magnitude
from cellwise.cell.equations.scalar import at_least, at_most
from cellwise.estimate.equations.constants import NO_LIMIT_V, REST_LIMIT_V, START_LOAD_SHARE


class Before(NamedTuple):
    """What may have flowed before a start: its mean, how far it may be off, the most it leaves."""

    mean_A: float
    spread_A: float
    limit_V: float


@inline
def load_before(
    current_A: float, rest_A: float, start_rest_A: float, start_load_A: float
) -> Before:
    """Nearly nothing at rest, half of the load under load."""
    mean_A = 0.0
    spread_A = start_rest_A
    limit_V = REST_LIMIT_V
    if not (magnitude(current_A) < rest_A):
        mean_A = START_LOAD_SHARE * current_A
        spread_A = at_least(magnitude(mean_A), start_load_A)
        limit_V = NO_LIMIT_V
    return Before(mean_A, spread_A, limit_V)


@inline
def held_variance(rested_V2: float, r_ohm: float, most_A: float, limit_V: float) -> float:
    """Variance of a branch that holds anything up to what a current leaves there; 0 without it."""
    variance_V2 = 0.0
    if r_ohm > 0.0:
        held_V = at_most(most_A * r_ohm, limit_V)
        variance_V2 = rested_V2 + (held_V * held_V)
    return variance_V2
