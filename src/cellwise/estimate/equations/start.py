"""What the branches of a cell may hold that nobody has seen before."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

from cellwise.cell.compiled import inline, noinline
from cellwise.cell.description import BRANCHES, CARRIED
from cellwise.cell.equations.double import magnitude
from cellwise.cell.equations.scalar import at_least, at_most
from cellwise.cell.unrolled import unrolled_by_option
from cellwise.estimate.equations.constants import NO_LIMIT_V, REST_LIMIT_V, START_LOAD_SHARE
from cellwise.estimate.equations.covariance import Point, forget_correlations

SLOW = WIDE = True  # what a fixed step may do without
Constants: TypeAlias = Any
State: TypeAlias = Any


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


@inline
@noinline
@unrolled_by_option
def guess_branches(c: Constants, x: State, p: Point, current: float) -> None:
    """What the branches hold when nobody knows what was before."""
    rested_V2 = c.branch_variance_V2
    forget_correlations(x)
    if WIDE:
        before = load_before(current, c.rest_A, c.start_rest_A, c.start_load_A)
        for i in BRANCHES:
            x.state[i] = p.r[i] * before.mean_A
            if i in CARRIED:
                x.carry[i] = 0.0
            x.p[i, i] = held_variance(rested_V2, p.r[i], before.spread_A, before.limit_V)
    else:
        mean_A = START_LOAD_SHARE * current
        spread_A = magnitude(mean_A) + c.start_rest_A
        for i in BRANCHES:
            x.state[i] = p.r[i] * mean_A
            held_V = spread_A * p.r[i]
            x.p[i, i] = rested_V2 + (held_V * held_V)
