"""A current sensor that is off all the time: a second hypothesis beside the filter's own.

The filter's own estimate is that of a right current. How far a constant offset of the current would
have moved it, and what the voltages then say of that offset, takes one scalar filter beside it that
is exact where the filter is linear (separate-bias estimation: Friedland 1969,
doi:10.1109/TAC.1969.1099223). The estimate is the mean of the two hypotheses, weighed by their
evidence (Savage-Dickey ratio: Dickey 1971). Everything is in units of the offset's standard
deviation beforehand, ``Noise.offset_share`` of 1C.
"""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations.double import magnitude, root
from cellwise.cell.equations.scalar import at_most
from cellwise.estimate.equations.constants import (
    INFORMATION_MOST,
    MAY_BE_LOAD,
    ODDS,
    PER_FREEDOM,
    REST_BAND,
    REST_LIMIT,
    REST_SHOWS,
    REST_USED,
    SURE_SQUARE,
)


class Standstill(NamedTuple):
    """How long the current has stood still near zero, at what, and how much that shows now."""

    lasts: float
    current_A: float
    weight: float


@inline
def rest_after(
    lasts: float, since_A: float, current_A: float, counted: float, rate_A: float, least: float
) -> Standstill:
    """After an interval of which ``counted`` were counted by the sensor; ``rate_A`` is 1C.

    A current that stands still near zero for ``least`` is what the sensor adds: once for each rest,
    so that a small constant load that is taken for one can be outvoted by the voltages. Within
    REST_BAND of zero it shows an offset to a fifth of the deviation that it has beforehand; what is
    more may as well be a load, and shows as much as is known beforehand.
    """
    now = 0.0
    at_A = current_A
    weight = 0.0
    size_A = magnitude(current_A)
    if size_A <= REST_LIMIT * rate_A and magnitude(current_A - since_A) <= REST_BAND * rate_A:
        at_A = since_A
        now = REST_USED
        if lasts >= 0.0:
            now = lasts + counted
        if now >= least:
            now = REST_USED
            weight = REST_SHOWS if size_A <= REST_BAND * rate_A else MAY_BE_LOAD
    return Standstill(now, at_A, weight)


@inline
def student(square: float) -> float:
    """How likely a mean of that square over its variance is beside none: Student's t.

    Of 31 degrees of freedom, in place of the normal density: how sure the voltages are is itself
    not quite sure, and it takes no exponential.
    """
    base = 1.0 + (square * PER_FREEDOM)
    base = base * base
    base = base * base
    base = base * base
    return base * base


class Offset(NamedTuple):
    """What the voltages say of an offset, and its mean and variance over both hypotheses.

    ``information`` is one over its variance if there is one, ``score`` that times its mean.
    """

    score: float
    information: float
    believed: float
    unsure: float


@inline
def offset_after(
    score: float, information: float, of_offset_V: float, own_V: float, inverse: float
) -> Offset:
    """After a voltage.

    ``of_offset_V`` is what one deviation moves the voltage by, ``own_V`` the innovation of the
    filter's own estimate, ``inverse`` one over the variance that weighed it.
    """
    per_V = inverse * of_offset_V
    more = information + (per_V * of_offset_V)
    sum_of = score + (per_V * own_V)
    if not (more <= INFORMATION_MOST):
        more = information
        sum_of = score
    variance = 1.0 / more
    square = at_most((sum_of * sum_of) * variance, SURE_SQUARE)
    odds = (ODDS * student(square)) * root(variance)
    weight = odds / (odds + 1.0)
    mean = sum_of * variance
    unsure = weight * (variance + ((1.0 - weight) * (mean * mean)))
    return Offset(sum_of, more, weight * mean, unsure)
