"""Components over the SOC: where they lie, what speaks against them, what was before them."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

from cellwise.cell.compiled import inline
from cellwise.cell.description import V3
from cellwise.cell.equations.double import log_of_more, magnitude, root
from cellwise.cell.equations.scalar import at_least, at_most
from cellwise.estimate.equations.constants import (
    COMPONENT_WIDTH,
    COST_MOST,
    DENSE,
    GIVEN_UP,
    LEAST_PASSED,
    LEAST_PAST_V2,
    LEAST_WIDTH,
    PAST_PART,
    PAST_SPREAD,
    TAIL,
)
from cellwise.estimate.equations.evidence import inverse_weight

SlowFloat: TypeAlias = Any  # of a state that a fixed step may do without


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


class SlowBranch(NamedTuple):
    """The slow branch at one SOC: resistance, and what it loses or gains in a unit of time."""

    r3_ohm: SlowFloat
    gain3: SlowFloat

    @property
    def r(self) -> dict[Any, float]:
        """Its resistance, by the branch."""
        return {V3: self.r3_ohm}

    @property
    def gain(self) -> dict[Any, float]:
        """The other, by the branch."""
        return {V3: self.gain3}


class Component(NamedTuple):
    """Where a component begins: its SOC, the variance of that, and what speaks against it."""

    soc: float
    variance: float
    cost: float


@inline
def component_from(t: float, apart: float, soc: float, variance: float, std: float) -> Component:
    """The component from ``t`` to ``t + apart`` in -1..1, about a start known to ``std``.

    How sure a stated start is, is itself not sure: Student's t of TAIL degrees of freedom.
    """
    low = edge(t, soc, std)
    high = edge(t + apart, soc, std)
    width = at_least(high - low, LEAST_WIDTH)
    wide = COMPONENT_WIDTH * width
    here = 0.5 * (low + high)
    away = here - soc
    off = (away * away) / (TAIL * variance)
    cost = ((0.5 * (TAIL + 1.0)) * log_of_more(off)) + log_of_more((1.0 / width) - 1.0)
    return Component(here, wide * wide, cost)


@inline
def kept_cost(cost: float) -> float:
    """Of a component beside the likeliest's; once it is given up, it stays so."""
    return GIVEN_UP if cost > COST_MOST else cost


@inline
def mixture_variance(own_V2: float, mean_V: float, square_V2: float) -> float:
    """Of components' predictions: their own, and how far they lie apart."""
    return own_V2 + at_least(square_V2 - (mean_V * mean_V), 0.0)


@inline
def evidence_share(fades: float, stays: float, shared: float, since: float) -> float:
    """How much of a voltage's evidence is new, where a part p of the model's error stays for good.

    Of a mean over t the variance is ((1 - p) 2 tau / t + p) times an error's: what it says never
    exceeds one error over p, however long it is taken. ``shared`` is 2 tau, ``fades`` (1 - p) of
    that, ``stays`` is p.
    """
    left = fades + (stays * since)
    return at_most((fades * shared) / (left * left), 1.0)


class ComponentUpdate(NamedTuple):
    """The innovation that a component takes, one over its variance, minus the log likelihood."""

    off_V: float
    inverse: float
    cost: float


@inline
def component_update(
    innovation_V: float,
    variance_V2: float,
    gate_square: float,
    explained_V2: float,
    weight_V2: float,
    below: float,
    share: float,
) -> ComponentUpdate:
    """None is rejected: it moves a component as far as the gate.

    Beyond that it speaks against it in proportion to how far it is off (Huber): below empty the
    lowest of them is the nearest. It counts as often as it moves the state: samples that share one
    error of the model are one, of which ``share`` is new.
    """
    most = gate_square * variance_V2
    square = innovation_V * innovation_V
    off_V = innovation_V
    grows = 1.0
    if square > most:
        passed = at_least(root(most / square), LEAST_PASSED)
        off_V = innovation_V * passed
        grows = (2.0 / passed) - 1.0
    inverse = inverse_weight(explained_V2, weight_V2, below)
    unlikely = log_of_more((explained_V2 * below) / weight_V2)
    cost = share * (0.5 * ((grows * ((off_V * off_V) * inverse)) + unlikely))
    return ComponentUpdate(off_V, inverse, cost)


@inline
def parts_before(soc: float, mean_A: float) -> float:
    """Of a load's way from full to a SOC, a charge's from empty, PAST_PART each; to be cut off."""
    way = soc
    if mean_A >= 0.0:
        way = 1.0 - soc
    return (way / PAST_PART) + 0.5


@inline
def soc_on_way(parts: float, mean_A: float) -> float:
    """SOC after so many parts."""
    soc = parts * PAST_PART
    if mean_A >= 0.0:
        soc = 1.0 - soc
    return soc


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
