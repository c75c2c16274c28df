"""Components over the SOC: where they lie, what speaks against them, what was before them."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations.double import log_of_more, magnitude, root
from cellwise.cell.equations.scalar import at_least, at_most
from cellwise.estimate.equations.constants import (
    DENSE,
    LEAST_PASSED,
    LEAST_PAST_V2,
    PAST_SPREAD,
    TAIL,
)


@inline
def edge(t: float, soc: float, std: float) -> float:
    """SOC between two components: ``t`` from -1 to 1 goes from 0 to 1, densely about the start."""
    room = soc
    if t > 0.0:
        room = 1.0 - soc
    near = at_most(DENSE * std, room)
    size = magnitude(t)
    away = size * (near + ((room - near) * (size * size)))
    at = soc - away
    if t > 0.0:
        at = soc + away
    return at


@inline
def start_cost(away: float, variance: float, width: float) -> float:
    """What speaks against a component ``away`` from a stated start, and of a ``width`` in SOC.

    How sure a stated start is, is itself not sure: Student's t of TAIL degrees of freedom.
    """
    off = (away * away) / (TAIL * variance)
    return ((0.5 * (TAIL + 1.0)) * log_of_more(off)) + log_of_more((1.0 / width) - 1.0)


@inline
def evidence_share(fades: float, stays: float, shared: float, since: float) -> float:
    """How much of a voltage's evidence is new, where a part p of the model's error stays for good.

    Of a mean over t the variance is ((1 - p) 2 tau / t + p) times an error's: what it says never
    exceeds one error over p, however long it is taken. ``shared`` is 2 tau, ``fades`` (1 - p) of
    that, ``stays`` is p.
    """
    left = fades + (stays * since)
    return at_most((fades * shared) / (left * left), 1.0)


class Passed(NamedTuple):
    """What the gate lets pass of an innovation, and how the rest ``grows`` what it says."""

    off_V: float
    grows: float


@inline
def let_pass(innovation_V: float, variance_V2: float, gate_square: float) -> Passed:
    """An innovation as a component takes it: as far as the gate.

    Beyond that it speaks against a component in proportion to how far it is off (Huber): below
    empty the lowest of them is the nearest.
    """
    most = gate_square * variance_V2
    square = innovation_V * innovation_V
    off_V = innovation_V
    grows = 1.0
    if square > most:
        share = at_least(root(most / square), LEAST_PASSED)
        off_V = innovation_V * share
        grows = (2.0 / share) - 1.0
    return Passed(off_V, grows)


@inline
def cost_of_voltage(
    share: float,
    off_V: float,
    grows: float,
    inverse: float,
    explained_V2: float,
    weight_V2: float,
) -> float:
    """What a voltage says against a component: minus the logarithm of its likelihood.

    It counts as often as it moves the state: samples that share one error of the model are one.
    """
    against = (grows * ((off_V * off_V) * inverse)) + log_of_more(explained_V2 / weight_V2)
    return share * (0.5 * against)


class Past(NamedTuple):
    """What the slow branch holds of a load before the start: mean, and variance of it."""

    held_V: float
    variance_V2: float


@inline
def past_of(r_ohm: float, gone: float, mean_A: float, before_V: float, past_A: float) -> Past:
    """When of ``before_V`` the share ``gone`` has gone, under a load of ``mean_A`` since.

    Half of what it has left, and what ``past_A`` would have, may be otherwise.
    """
    left = 1.0 - gone
    held_V = (gone * (r_ohm * mean_A)) + (left * before_V)
    spread_V = left * ((PAST_SPREAD * magnitude(before_V)) + (r_ohm * past_A))
    variance_V2 = (spread_V * spread_V) + LEAST_PAST_V2
    return Past(held_V, variance_V2)


@inline
def cost_of_past(off_V: float, variance_V2: float) -> float:
    """What the slow branch's past says against a component."""
    against = ((off_V * off_V) / variance_V2) + log_of_more(variance_V2 / LEAST_PAST_V2)
    return 0.5 * against
