"""How resistances answer the load: factors on the model's, by what moves within minutes."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.compiled import inline

SCALE_LOW, SCALE_HIGH = 0.2, 5.0
LONGER = 10.0  # mean squares are taken over this many times the means


class Resistances(NamedTuple):
    """Factors on R0, R1 (``fast``) and R2 (``tail``), and the means they are estimated from.

    ``drop`` and ``miss`` are running means of the fast part of the polarisation and of the
    innovation, ``near`` and ``far`` those of the tail over the shorter and the longer time; the
    others mean squares of what moves within each band.
    """

    fast: float
    fast_variance: float
    tail: float
    tail_variance: float
    drop_V: float
    miss_V: float
    drop_V2: float
    miss_V2: float
    near_V: float
    far_V: float
    miss_far_V: float
    tail_V2: float
    miss_far_V2: float


class ResistanceRules(NamedTuple):
    """What is known of the factors before any data, and how the load has to move to show them.

    ``variance`` beforehand, 0 where they are not estimated, ``wander`` per second; held while the
    mean square of what moves is below ``swing_V2``; what moves within ``fast_s`` shows R0 and R1,
    up to ``tail_s`` R2.
    """

    variance: float
    wander: float
    swing_V2: float
    fast_s: float
    tail_s: float


@inline
def no_resistances(variance: float) -> Resistances:
    """The model's own, known to a variance."""
    none = 0.0
    # fmt: off
    return Resistances(
        1.0, variance, 1.0, variance, none, none, none, none, none, none, none, none, none
    )
    # fmt: on


@inline
def least_squares(
    factor: float, variance: float, drive_V: float, miss_V: float, noise_V2: float
) -> tuple[float, float]:
    """One step of recursive least squares for a factor on what the load drives."""
    k = variance * drive_V / (drive_V * drive_V * variance + noise_V2)
    moved = min(max(factor - k * miss_V, SCALE_LOW), SCALE_HIGH)
    return moved, variance - k * drive_V * variance


@inline
def watch_resistances(
    r: Resistances,
    rules: ResistanceRules,
    drop_V: float,
    tail_V: float,
    innovation_V: float,
    white_V2: float,
    dt_s: float,
    hold: bool,
) -> Resistances:
    """Factors on R0, R1 and on R2 by recursive least squares, where the load moves enough.

    ``drop_V`` is R0 I + v1, ``tail_V`` is v2, both without their factor. The first is judged
    by what moves within ``fast_s``, the second by what moves between that and ``tail_s``: no error
    of an OCV is that fast. The noise is what the innovations show in the same band, one piece of
    evidence in twice the band's time.
    """
    near = min(dt_s / rules.fast_s, 1.0)
    drop_mean = r.drop_V + near * (drop_V - r.drop_V)
    left_V = innovation_V + (r.fast - 1.0) * drop_V  # with the factor, which the voltage has not
    miss_mean = r.miss_V + near * (left_V - r.miss_V)
    near_mean = r.near_V + near * (tail_V - r.near_V)
    drop = drop_V - drop_mean
    miss = left_V - miss_mean
    share = near / LONGER
    drop2 = r.drop_V2 + share * (drop * drop - r.drop_V2)
    miss2 = r.miss_V2 + share * (miss * miss - r.miss_V2)
    moves = drop2 >= rules.swing_V2
    fast, fast_variance = r.fast, r.fast_variance
    if moves and not hold and dt_s > 0.0:
        noise = max(miss2, white_V2) * max(2.0 * rules.fast_s / dt_s, 1.0)
        fast, fast_variance = least_squares(fast, fast_variance, drop, miss, noise)

    far = min(dt_s / rules.tail_s, 1.0)
    far_mean = r.far_V + far * (near_mean - r.far_V)
    miss_far = r.miss_far_V + far * (miss_mean - r.miss_far_V)
    lag = near_mean - far_mean
    miss = miss_mean - miss_far
    share = far * 3.0 / LONGER
    tail2 = r.tail_V2 + share * (lag * lag - r.tail_V2)
    far2 = r.miss_far_V2 + share * (miss * miss - r.miss_far_V2)
    tail, tail_variance = r.tail, r.tail_variance
    if tail2 >= rules.swing_V2 and not hold and dt_s > 0.0:
        noise = max(far2, white_V2) * max(2.0 * rules.tail_s / dt_s, 1.0)
        own = miss + (tail - 1.0) * lag
        tail, tail_variance = least_squares(tail, tail_variance, lag, own, noise)
    # fmt: off
    return Resistances(
        fast, fast_variance, tail, tail_variance, drop_mean, miss_mean, drop2, miss2,
        near_mean, far_mean, miss_far, tail2, far2,
    )
    # fmt: on


@inline
def wandered(r: Resistances, rules: ResistanceRules, dt_s: float) -> Resistances:
    """Uncertainty of the resistances comes back, up to what it was before any data."""
    fast, tail = r.fast_variance, r.tail_variance
    if fast < rules.variance:
        fast += rules.wander * dt_s
    if tail < rules.variance:
        tail += rules.wander * dt_s
    # fmt: off
    return Resistances(
        r.fast, fast, r.tail, tail, r.drop_V, r.miss_V, r.drop_V2, r.miss_V2,
        r.near_V, r.far_V, r.miss_far_V, r.tail_V2, r.miss_far_V2,
    )
    # fmt: on
