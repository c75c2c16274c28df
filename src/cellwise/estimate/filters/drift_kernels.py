"""A current sensor that is off all the time: a second hypothesis beside the filter's own.

The filter's own estimate is that of a right current. How far a constant offset of the current would
have moved it, and what the voltages then say of that offset, takes one scalar filter beside it that
is exact where the filter is linear (separate-bias estimation: Friedland 1969,
doi:10.1109/TAC.1969.1099223). The estimate is the mean of the two hypotheses, weighed by their
evidence (Savage-Dickey ratio: Dickey 1971). Everything is in units of the offset's standard
deviation beforehand, ``Noise.offset_share`` of 1C.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES
from cellwise.cell.equations import relaxed
from cellwise.cell.unrolled import CALLED, ByState, unrolled
from cellwise.estimate.equations.constants import REST_RATE
from cellwise.estimate.noise import NoiseScalars

CHANCE = 0.2  # of an offset, before any data, as in the adaptive filter
ODDS = CHANCE / (1.0 - CHANCE)
PER_FREEDOM = 1.0 / 31.0
# A rest: the current stands still for REST_S, near zero, as shares of 1C. Below REST_RATE it shows
# an offset to a fifth of the deviation that it has beforehand; what is more may as well be a load,
# and shows as much as is known beforehand.
REST_S = 120.0
REST_LIMIT, REST_BAND = 0.04, 0.01
SHOWN, MAY_BE_LOAD = 25.0, 1.0
LONG_S = 1e30  # infinite: used


# An offset of the current, per standard deviation that it has beforehand. ``reach`` is the SOC by
# which one of them puts the filter's own estimate too low, ``d1_V`` ... by how much it puts the
# branches too high; ``information`` is what the voltages say of it if there is one, one over its
# variance, ``score`` that times its mean, ``believed`` and ``unsure`` its mean and variance over
# both hypotheses: the estimate that is carried is the filter's own and ``believed`` x ``reach``.
# ``rest_s`` is for how long the current has stood still near zero, infinite once that has been
# used, ``rest_A`` what it has been.
if TYPE_CHECKING:
    Drift: TypeAlias = Any
else:
    FIELDS = (
        *("reach", "score", "information", "believed", "unsure"),
        *(CALLED["d"](s) for s in BRANCHES),
        *("rest_s", "rest_A"),
    )
    Drift = NamedTuple("Drift", [(name, float) for name in FIELDS])


@inline
@unrolled
def no_drift() -> Drift:
    """Nothing counted yet, nothing known."""
    return Drift(0.0, 0.0, 1.0, 0.0, CHANCE, *(0.0 for i in BRANCHES), 0.0, 0.0)


@inline
@unrolled
def counted_on(
    noise: NoiseScalars,
    old: Drift,
    t: ByState,
    charge_As: float,
    counted_s: float,
    current_A: float,
) -> Drift:
    """After an interval of which ``counted_s`` were counted by the sensor, at ``current_A``.

    A current that stands still near zero for REST_S is what the sensor adds: once for each rest,
    so that a small constant load that is taken for one can be outvoted by the voltages.
    """
    offset_A = noise.offset_soc_per_s * charge_As
    rate_A = charge_As * (1.0 / 3600.0)
    stands = abs(current_A) <= REST_LIMIT * rate_A
    stands &= abs(current_A - old.rest_A) <= REST_BAND * rate_A
    rest_s = old.rest_s + counted_s if stands else 0.0
    shows = (rest_s >= REST_S) & (rest_s <= LONG_S)
    score, information = old.score, old.information
    if shows and offset_A > 0.0:
        weight = SHOWN if abs(current_A) <= REST_RATE * rate_A else MAY_BE_LOAD
        information += weight
        score += weight * current_A / offset_A
    return Drift(
        old.reach + noise.offset_soc_per_s * counted_s,
        score,
        information,
        old.believed,
        old.unsure,
        *(relaxed(old.d[i], t.a[i], t.g[i], offset_A) for i in BRANCHES),
        math.inf if shows else rest_s,
        old.rest_A if stands else current_A,
    )


@inline
def drift_variance(drift: Drift) -> float:
    """What an offset that is not known may have moved the SOC by, variance over both hypotheses."""
    variance: float = drift.reach * drift.reach * drift.unsure
    return variance


@inline
def student(square: float) -> float:
    """How likely a mean of that square over its variance is beside none: Student's t.

    Of 31 degrees of freedom, in place of the normal density: how sure the voltages are is itself
    not quite sure, and it takes no exponential.
    """
    base = 1.0 + square * PER_FREEDOM
    base *= base
    base *= base
    base *= base
    return base * base


@inline
@unrolled
def dropped_by_offset(noise: NoiseScalars, d: Drift, r0_ohm: float, charge_As: float) -> float:
    """By what one deviation of the offset puts the drop over R0 and branches too high [V]."""
    offset_V = r0_ohm * noise.offset_soc_per_s * charge_As
    dropped_V: float = offset_V + sum(d.d[i] for i in BRANCHES)
    return dropped_V


@inline
@unrolled
def drift_step(now: Drift, seen_V: float, own_V: float, gain: float, inverse: float) -> Drift:
    """After a voltage with the ``gain`` of the SOC; ``now`` is :func:`counted_on`.

    ``seen_V`` is what one deviation moves the voltage by, ``own_V`` the innovation of the filter's
    own estimate, ``inverse`` one over the variance that weighed it.
    """
    read = inverse * seen_V
    information = now.information + read * seen_V
    score = now.score + read * own_V
    variance = 1.0 / information
    odds = ODDS * student(score * score * variance)
    weight = odds / (odds + math.sqrt(information))
    offset = score * variance
    unsure = weight * (variance + (1.0 - weight) * offset * offset)
    # fmt: off
    return Drift(
        now.reach - gain * seen_V, score, information, weight * offset, unsure,
        *(now.d[i] for i in BRANCHES), now.rest_s, now.rest_A,
    )
    # fmt: on
