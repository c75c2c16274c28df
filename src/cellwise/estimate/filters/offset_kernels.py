"""The hypothesis of a constant offset of the current, in float64: what is carried of it.

Its equations are :mod:`cellwise.estimate.equations.offset`, for float64 and for C.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES
from cellwise.cell.equations import relaxed
from cellwise.cell.unrolled import CALLED, ByState, unrolled
from cellwise.estimate.equations.constants import CHANCE, OFFSET_REST_S
from cellwise.estimate.equations.offset import offset_after, rest_after
from cellwise.estimate.noise import NoiseScalars

# An offset of the current, per standard deviation that it has beforehand. ``reach`` is the SOC by
# which one of them puts the filter's own estimate too low, ``d1_V`` ... by how much it puts the
# branches too high; ``score`` to ``unsure`` are an ``Offset``: the estimate that is carried is the
# filter's own and ``believed`` x ``reach``. ``rest_s`` and ``rest_A`` are a ``Standstill``.
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
    """After an interval of which ``counted_s`` were counted by the sensor, at ``current_A``."""
    offset_A = noise.offset_soc_per_s * charge_As
    rate_A = charge_As * (1.0 / 3600.0)
    rest = rest_after(old.rest_s, old.rest_A, current_A, counted_s, rate_A, OFFSET_REST_S)
    score, information = old.score, old.information
    if rest.weight > 0.0 and offset_A > 0.0:
        information += rest.weight
        score += rest.weight * current_A / offset_A
    return Drift(
        old.reach + noise.offset_soc_per_s * counted_s,
        score,
        information,
        old.believed,
        old.unsure,
        *(relaxed(old.d[i], t.a[i], t.g[i], offset_A) for i in BRANCHES),
        rest.lasts,
        rest.current_A,
    )


@inline
def drift_variance(drift: Drift) -> float:
    """What an offset that is not known may have moved the SOC by, variance over both hypotheses."""
    variance: float = drift.reach * drift.reach * drift.unsure
    return variance


@inline
@unrolled
def dropped_by_offset(noise: NoiseScalars, d: Drift, r0_ohm: float, charge_As: float) -> float:
    """By what one deviation of the offset puts the drop over R0 and branches too high [V]."""
    offset_V = r0_ohm * noise.offset_soc_per_s * charge_As
    dropped_V: float = offset_V + sum(d.d[i] for i in BRANCHES)
    return dropped_V


@inline
@unrolled
def drift_step(now: Drift, of_offset_V: float, own_V: float, gain: float, inverse: float) -> Drift:
    """After a voltage with the ``gain`` of the SOC; ``now`` is :func:`counted_on`."""
    found = offset_after(now.score, now.information, of_offset_V, own_V, inverse)
    # fmt: off
    return Drift(
        now.reach - gain * of_offset_V,
        found.score, found.information, found.believed, found.unsure,
        *(now.d[i] for i in BRANCHES), now.rest_s, now.rest_A,
    )
    # fmt: on
