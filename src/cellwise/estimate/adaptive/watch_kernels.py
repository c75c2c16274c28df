"""What the adaptive filter watches beside its state: rests, and how resistances answer the load."""

from __future__ import annotations

from cellwise.cell.compiled import inline
from cellwise.estimate.adaptive.state_kernels import AdaptiveScalars, Resistances, Rest

SCALE_LOW, SCALE_HIGH = 0.2, 5.0
# Mean squares are taken over this many times the means.
LONGER = 10.0


@inline
def watch_rest(
    rules: AdaptiveScalars, rest: Rest, current_A: float, dt_s: float
) -> tuple[Rest, bool]:
    """Whether the current has stood still near zero for long enough to be nothing but offset.

    True once per rest: a rest is one piece of evidence, so that a small constant load that is
    taken for a rest can be outvoted by the voltage.
    """
    near = abs(current_A) <= rules.rest_limit_A
    if not near or abs(current_A - rest.current_A) > rules.rest_band_A:
        return Rest(0.0, current_A, False), False
    since = rest.since_s + dt_s
    mean = rest.current_A
    if since > 0.0:
        mean += min(dt_s / since, 1.0) * (current_A - mean)
    shows = not rest.used and since >= rules.rest_after_s
    return Rest(since, mean, rest.used or shows), shows


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
    rules: AdaptiveScalars,
    r: Resistances,
    drop_V: float,
    tail_V: float,
    innovation_V: float,
    white_V2: float,
    dt_s: float,
    hold: bool,
) -> tuple[Resistances, bool]:
    """Factors on R0, R1 and on R2 by recursive least squares; whether the load moves enough.

    ``drop_V`` is R0 I + v1, ``tail_V`` is v2, both without their factor. The first is judged
    by what moves within ``fast_s``, the second by what moves between that and ``tail_s``: no error
    of an OCV is that fast. The noise is what the innovations show in the same band, one piece of
    evidence in twice the band's time.
    """
    near = min(dt_s / rules.fast_s, 1.0)
    drop_mean = r.drop_V + near * (drop_V - r.drop_V)
    miss_mean = r.miss_V + near * (innovation_V - r.miss_V)
    near_mean = r.near_V + near * (tail_V - r.near_V)
    drop = drop_V - drop_mean
    miss = innovation_V - miss_mean
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
        own = miss + (tail - 1.0) * lag  # the voltage has no factor on the tail
        tail, tail_variance = least_squares(tail, tail_variance, lag, own, noise)
    # fmt: off
    return Resistances(
        fast, fast_variance, tail, tail_variance, drop_mean, miss_mean, drop2, miss2,
        near_mean, far_mean, miss_far, tail2, far2,
    ), moves
    # fmt: on


@inline
def walk_resistances(rules: AdaptiveScalars, r: Resistances, dt_s: float) -> Resistances:
    """Uncertainty of the resistances comes back, up to what it was before any data."""
    fast, tail = r.fast_variance, r.tail_variance
    if fast < rules.resistance_variance:
        fast += rules.resistance_walk * dt_s
    if tail < rules.resistance_variance:
        tail += rules.resistance_walk * dt_s
    # fmt: off
    return Resistances(
        r.fast, fast, r.tail, tail, r.drop_V, r.miss_V, r.drop_V2, r.miss_V2,
        r.near_V, r.far_V, r.miss_far_V, r.tail_V2, r.miss_far_V2,
    )
    # fmt: on
