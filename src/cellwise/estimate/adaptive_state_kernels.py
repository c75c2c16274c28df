"""State and covariance of the adaptive filter: its start, its spread, its correction.

x = [soc, v1, v2, v3, h, b, q] and P, seven by seven, live in arrays that the caller owns; loops
have constant bounds and allocate nothing.
"""

from __future__ import annotations

from typing import NamedTuple

from numba import njit

from cellwise.estimate.filter_state import EkfStart
from cellwise.estimate.sample_kernels import Watch, first_watch
from cellwise.typing import FloatArray

SOC, V1, V2, V3, H, B, Q = range(7)
STATES = 7

# What is carried beside x and P: how the model has done, the rest that may be going on, the
# resistances' two factors and the running means that they are learnt from, the sensors' past
# (the fields of Watch).
REJECTIONS, MISMATCH, HEAT_K, REST_S, REST_A, REST_USED = range(6)
FAST, FAST_VAR, TAIL, TAIL_VAR = range(6, 10)
DROP, MISS, DROP_MOVES, MISS_MOVES = range(10, 14)
TAIL_NEAR, TAIL_FAR, MISS_FAR, TAIL_MOVES, FAR_MOVES = range(14, 19)
WATCH = 19
MEMORY = 27

VARIANCE_FLOOR = 1e-12
CHARGE_LOW, CHARGE_HIGH = 0.5, 2.5
NEARLY = 1e-12


class AdaptiveScalars(NamedTuple):
    """How the parameters may move, as the kernels see it; variances of what is not learnt are 0."""

    offset_variance: float
    resistance_variance: float
    charge_variance: float
    offset_walk: float  # variance per second
    resistance_walk: float
    charge_walk: float
    learn_offset: bool
    learn_resistance: bool
    learn_charge: bool
    settled_variance: float
    swing_V2: float
    fast_s: float
    tail_s: float
    misfit: float
    rest_after_s: float
    rest_band_A: float
    rest_limit_A: float
    rest_variance: float
    odds: float
    doubt: float


@njit(cache=True, error_model="numpy")
def adaptive_start(
    start: EkfStart,
    learn: AdaptiveScalars,
    current_A: float,
    x: FloatArray,
    p: FloatArray,
    memory: FloatArray,
) -> None:
    """Nothing known but ``start``; parameters at the model's own values."""
    x[:] = 0.0
    p[:, :] = 0.0
    memory[:] = 0.0
    x[SOC] = start.soc
    x[H] = 1.0 if start.soc > 0.5 else -1.0
    x[Q] = 1.0
    p[SOC, SOC] = start.variance
    p[H, H] = start.hysteresis_variance
    p[B, B] = learn.offset_variance
    p[Q, Q] = learn.charge_variance
    memory[MISMATCH] = 1.0
    memory[FAST] = 1.0
    memory[FAST_VAR] = learn.resistance_variance
    memory[TAIL] = 1.0
    memory[TAIL_VAR] = learn.resistance_variance
    keep_watch(memory, first_watch(current_A))


@njit(cache=True, error_model="numpy", inline="always")
def watch_of(memory: FloatArray) -> Watch:
    """What is remembered of the sensors."""
    # fmt: off
    return Watch(
        memory[WATCH], memory[WATCH + 1], memory[WATCH + 2], memory[WATCH + 3],
        memory[WATCH + 4], memory[WATCH + 5], memory[WATCH + 6], memory[WATCH + 7],
    )
    # fmt: on


@njit(cache=True, error_model="numpy", inline="always")
def keep_watch(memory: FloatArray, watch: Watch) -> None:
    """Remember it."""
    memory[WATCH] = watch.current_A
    memory[WATCH + 1] = watch.temperature_C
    memory[WATCH + 2] = watch.evidence_s
    memory[WATCH + 3] = watch.no_current_s
    memory[WATCH + 4] = watch.no_voltage_s
    memory[WATCH + 5] = watch.voltage_V
    memory[WATCH + 6] = watch.frozen_A
    memory[WATCH + 7] = watch.repeats


@njit(cache=True, error_model="numpy", inline="always")
def spread(
    p: FloatArray,
    a1: float,
    a2: float,
    a3: float,
    ah: float,
    sb: float,
    sq: float,
    g1: float,
    g2: float,
    g3: float,
) -> None:
    """P to F P F': a diagonal transition, and offset and capacity driving SOC and branches."""
    for j in range(STATES):
        b = p[B, j]
        p[SOC, j] += sb * b + sq * p[Q, j]
        p[V1, j] = a1 * p[V1, j] - g1 * b
        p[V2, j] = a2 * p[V2, j] - g2 * b
        p[V3, j] = a3 * p[V3, j] - g3 * b
        p[H, j] *= ah
    for i in range(STATES):
        b = p[i, B]
        p[i, SOC] += sb * b + sq * p[i, Q]
        p[i, V1] = a1 * p[i, V1] - g1 * b
        p[i, V2] = a2 * p[i, V2] - g2 * b
        p[i, V3] = a3 * p[i, V3] - g3 * b
        p[i, H] *= ah


@njit(cache=True, error_model="numpy", inline="always")
def observe(
    p: FloatArray,
    d: FloatArray,
    slope_V: float,
    m_V: float,
    fast: float,
    tail: float,
    r0_ohm: float,
) -> float:
    """Put d = P H' with H = [slope, -r, -w, -w, m, r R0, 0] there; H P H' [V^2]."""
    rb = fast * r0_ohm
    for i in range(STATES):
        d[i] = (slope_V * p[SOC, i] + m_V * p[H, i]) + (
            rb * p[B, i] - (fast * p[V1, i] + tail * (p[V2, i] + p[V3, i]))
        )
    return float(
        (slope_V * d[SOC] + m_V * d[H]) + (rb * d[B] - (fast * d[V1] + tail * (d[V2] + d[V3])))
    )


@njit(cache=True, error_model="numpy", inline="always")
def lean(p: FloatArray, f1: float, f2: float, f3: float) -> None:
    """The branches follow a SOC that is far off through the slopes of their resistances."""
    for j in range(STATES):
        s = p[SOC, j]
        p[V1, j] += f1 * s
        p[V2, j] += f2 * s
        p[V3, j] += f3 * s
    for i in range(STATES):
        s = p[i, SOC]
        p[i, V1] += f1 * s
        p[i, V2] += f2 * s
        p[i, V3] += f3 * s


@njit(cache=True, error_model="numpy", inline="always")
def flatten(p: FloatArray, d: FloatArray, c: FloatArray, inverse: float, less_V: float) -> None:
    """Before :func:`correct`: its gain, worth only a slope that is flatter by ``-less_V``.

    Joseph's form with d = P H' of the steeper slope, as in the EKF; c is room to work in. Offset
    and capacity are not corrected while SOC is as far off.
    """
    e = less_V * (2.0 * d[SOC] + less_V * p[SOC, SOC])
    for i in range(STATES):
        c[i] = less_V * p[SOC, i]
    for i in range(B):
        ki = d[i] * inverse
        for j in range(B):
            kj = d[j] * inverse
            p[i, j] += ki * kj * e - ki * c[j] - c[i] * kj


@njit(cache=True, error_model="numpy", inline="always")
def correct(
    x: FloatArray,
    p: FloatArray,
    d: FloatArray,
    inverse: float,
    innovation: float,
    hold_offset: bool,
    hold_charge: bool,
) -> None:
    """Kalman update with d = P H' and ``inverse``, one over the innovation's variance.

    A held parameter keeps value and variance, and its uncertainty still counts in all others
    (consider filter: S. F. Schmidt, Advances in Control Systems 3, 1966, p. 293).
    """
    b, q = x[B], x[Q]
    bb, bq, qq = p[B, B], p[B, Q], p[Q, Q]
    for i in range(STATES):
        k = d[i] * inverse
        x[i] += k * innovation
        for j in range(STATES):
            p[i, j] -= k * d[j]
    if hold_offset:
        x[B] = b
        p[B, B] = bb
    if hold_charge:
        x[Q] = q
        p[Q, Q] = qq
    if hold_offset and hold_charge:
        p[B, Q] = bq
        p[Q, B] = bq
    for i in range(STATES):
        p[i, i] = max(p[i, i], 0.0)
    p[SOC, SOC] = max(p[SOC, SOC], VARIANCE_FLOOR)
    x[H] = min(max(x[H], -1.0), 1.0)
    x[Q] = min(max(x[Q], CHARGE_LOW), CHARGE_HIGH)


@njit(cache=True, error_model="numpy", inline="always")
def settled_variance(p: FloatArray) -> float:
    """Variance that SOC would have if offset and capacity were known."""
    free_b = p[B, B] > 0.0
    free_q = p[Q, Q] > 0.0
    if free_b and free_q:
        sb, sq = p[SOC, B], p[SOC, Q]
        bb, bq, qq = p[B, B], p[B, Q], p[Q, Q]
        det = max(bb * qq - bq * bq, NEARLY * bb * qq)
        return float(p[SOC, SOC] - (sb * (sb * qq - sq * bq) + sq * (sq * bb - sb * bq)) / det)
    if free_b:
        return float(p[SOC, SOC] - p[SOC, B] * p[SOC, B] / p[B, B])
    if free_q:
        return float(p[SOC, SOC] - p[SOC, Q] * p[SOC, Q] / p[Q, Q])
    return float(p[SOC, SOC])
