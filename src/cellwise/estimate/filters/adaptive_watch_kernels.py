"""What the adaptive filter watches beside its state: rests, and how resistances answer the load."""

from __future__ import annotations

from numba import njit

from cellwise.estimate.filters.adaptive_state_kernels import (
    BB,
    BQ,
    DROP,
    DROP_MOVES,
    FAR_MOVES,
    FAST,
    FAST_VAR,
    MISS,
    MISS_FAR,
    MISS_MOVES,
    REST_A,
    REST_S,
    REST_USED,
    STATES,
    TAIL,
    TAIL_FAR,
    TAIL_MOVES,
    TAIL_NEAR,
    TAIL_VAR,
    AdaptiveScalars,
    B,
    Q,
    correct,
)
from cellwise.typing import FloatArray

SCALE_LOW, SCALE_HIGH = 0.2, 5.0
# Mean squares are taken over this many times the means.
LONGER = 10.0


@njit(cache=True, error_model="numpy", inline="always")
def watch_rest(learn: AdaptiveScalars, memory: FloatArray, current_A: float, dt_s: float) -> bool:
    """Whether the current has stood still near zero for long enough to be nothing but offset.

    True once per rest: a rest is one piece of evidence, so that a small constant load that is
    taken for a rest can be outvoted by the voltage.
    """
    near = abs(current_A) <= learn.rest_limit_A
    if not near or abs(current_A - memory[REST_A]) > learn.rest_band_A:
        memory[REST_S] = 0.0
        memory[REST_A] = current_A
        memory[REST_USED] = 0.0
        return False
    memory[REST_S] += dt_s
    if memory[REST_S] > 0.0:
        memory[REST_A] += min(dt_s / memory[REST_S], 1.0) * (current_A - memory[REST_A])
    if memory[REST_USED] == 0.0 and memory[REST_S] >= learn.rest_after_s:
        memory[REST_USED] = 1.0
        return True
    return False


@njit(cache=True, error_model="numpy", inline="always")
def use_rest(
    learn: AdaptiveScalars,
    x: FloatArray,
    p: FloatArray,
    memory: FloatArray,
    d: FloatArray,
    current_A: float,
    dt_s: float,
    blind: bool,
) -> None:
    """A rest shows the offset by itself: a measurement of b."""
    if blind:
        memory[REST_S] = 0.0
        return
    if watch_rest(learn, memory, current_A, dt_s) and learn.learn_offset:
        for i in range(B):
            d[i] = p[i * STATES + B]
        d[B] = p[BB]
        d[Q] = p[BQ]
        inverse = 1.0 / (d[B] + learn.rest_variance)
        correct(x, p, d, inverse, memory[REST_A] - x[B], False, not learn.learn_charge)


@njit(cache=True, error_model="numpy", inline="always")
def watch_resistance(
    learn: AdaptiveScalars,
    memory: FloatArray,
    drop_V: float,
    tail_V: float,
    innovation_V: float,
    white_V2: float,
    dt_s: float,
    hold: bool,
) -> bool:
    """Factors on R0, R1 and on R2, R3 by recursive least squares; whether the load moves enough.

    ``drop_V`` is R0 I + v1, ``tail_V`` is v2 + v3, both without their factor. The first is judged
    by what moves within ``fast_s``, the second by what moves between that and ``tail_s``: no error
    of an OCV is that fast. The noise is what the innovations show in the same band, one piece of
    evidence in twice the band's time.
    """
    near = min(dt_s / learn.fast_s, 1.0)
    memory[DROP] += near * (drop_V - memory[DROP])
    memory[MISS] += near * (innovation_V - memory[MISS])
    memory[TAIL_NEAR] += near * (tail_V - memory[TAIL_NEAR])
    drop = drop_V - memory[DROP]
    miss = innovation_V - memory[MISS]
    share = near / LONGER
    memory[DROP_MOVES] += share * (drop * drop - memory[DROP_MOVES])
    memory[MISS_MOVES] += share * (miss * miss - memory[MISS_MOVES])
    moves = memory[DROP_MOVES] >= learn.swing_V2
    if moves and not hold and dt_s > 0.0:
        noise = max(memory[MISS_MOVES], white_V2) * max(2.0 * learn.fast_s / dt_s, 1.0)
        k = memory[FAST_VAR] * drop / (drop * drop * memory[FAST_VAR] + noise)
        memory[FAST] = min(max(memory[FAST] - k * miss, SCALE_LOW), SCALE_HIGH)
        memory[FAST_VAR] -= k * drop * memory[FAST_VAR]

    far = min(dt_s / learn.tail_s, 1.0)
    memory[TAIL_FAR] += far * (memory[TAIL_NEAR] - memory[TAIL_FAR])
    memory[MISS_FAR] += far * (memory[MISS] - memory[MISS_FAR])
    tail = memory[TAIL_NEAR] - memory[TAIL_FAR]
    miss = memory[MISS] - memory[MISS_FAR]
    share = far * 3.0 / LONGER
    memory[TAIL_MOVES] += share * (tail * tail - memory[TAIL_MOVES])
    memory[FAR_MOVES] += share * (miss * miss - memory[FAR_MOVES])
    if memory[TAIL_MOVES] >= learn.swing_V2 and not hold and dt_s > 0.0:
        noise = max(memory[FAR_MOVES], white_V2) * max(2.0 * learn.tail_s / dt_s, 1.0)
        k = memory[TAIL_VAR] * tail / (tail * tail * memory[TAIL_VAR] + noise)
        memory[TAIL] = min(max(memory[TAIL] - k * miss, SCALE_LOW), SCALE_HIGH)
        memory[TAIL_VAR] -= k * tail * memory[TAIL_VAR]
    return bool(moves)
