"""State and covariance of the adaptive filter: its start, its spread, its correction.

x = [soc, v1, v2, v3, h, b, q] and P, seven by seven in one row, live in arrays that the caller
owns; loops have constant bounds and allocate nothing.
"""

from __future__ import annotations

from typing import NamedTuple

from numba import njit

from cellwise.estimate.filters.filter_state import EkfStart
from cellwise.estimate.sensing_kernels import Watch, first_watch
from cellwise.typing import FloatArray

SOC, V1, V2, V3, H, B, Q = range(7)
STATES = 7
# P row by row; only the upper triangle is read and written.
SS, S1, S2, S3, SH, SB, SQ = range(7)
P11, P12, P13, P1H, B1, Q1 = range(8, 14)
P22, P23, P2H, B2, Q2 = range(16, 21)
P33, P3H, B3, Q3 = range(24, 28)
PHH, BH, QH = range(32, 35)
BB, BQ = range(40, 42)
QQ = 48

# What is carried beside x and P: how the model has done, the rest that may be going on, the
# resistances' two factors and the running means that they are learnt from, the sensors' past
# (the fields of Watch), what an error of the model that stays has brought into the SOC.
REJECTIONS, MISMATCH, HEAT_K, REST_S, REST_A, REST_USED = range(6)
FAST, FAST_VAR, TAIL, TAIL_VAR = range(6, 10)
DROP, MISS, DROP_MOVES, MISS_MOVES = range(10, 14)
TAIL_NEAR, TAIL_FAR, MISS_FAR, TAIL_MOVES, FAR_MOVES = range(14, 19)
WATCH = 19
LASTING = 27
MEMORY = 28

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
    p[:] = 0.0
    memory[:] = 0.0
    x[SOC] = start.soc
    x[H] = 1.0 if start.soc > 0.5 else -1.0
    x[Q] = 1.0
    p[SS] = start.variance
    p[PHH] = start.hysteresis_variance
    p[BB] = learn.offset_variance
    p[QQ] = learn.charge_variance
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
    bb, bq, qq = p[BB], p[BQ], p[QQ]
    old_b, old_q = p[SB], p[SQ]
    b1, b2, b3, bh = p[B1], p[B2], p[B3], p[BH]
    q1, q2, q3, qh = p[Q1], p[Q2], p[Q3], p[QH]
    # With offset and capacity first: what drives.
    p[SB] = old_b + (sb * bb + sq * bq)
    p[SQ] = old_q + (sb * bq + sq * qq)
    p[B1] = a1 * b1 - g1 * bb
    p[B2] = a2 * b2 - g2 * bb
    p[B3] = a3 * b3 - g3 * bb
    p[BH] = ah * bh
    p[Q1] = a1 * q1 - g1 * bq
    p[Q2] = a2 * q2 - g2 * bq
    p[Q3] = a3 * q3 - g3 * bq
    p[QH] = ah * qh
    p[SS] += sb * (old_b + p[SB]) + sq * (old_q + p[SQ])
    p[S1] = a1 * (p[S1] + (sb * b1 + sq * q1)) - g1 * p[SB]
    p[S2] = a2 * (p[S2] + (sb * b2 + sq * q2)) - g2 * p[SB]
    p[S3] = a3 * (p[S3] + (sb * b3 + sq * q3)) - g3 * p[SB]
    p[SH] = ah * (p[SH] + (sb * bh + sq * qh))
    p[P11] = a1 * (a1 * p[P11] - g1 * b1) - g1 * p[B1]
    p[P12] = a1 * (a2 * p[P12] - g2 * b1) - g1 * p[B2]
    p[P13] = a1 * (a3 * p[P13] - g3 * b1) - g1 * p[B3]
    p[P1H] = ah * (a1 * p[P1H] - g1 * bh)
    p[P22] = a2 * (a2 * p[P22] - g2 * b2) - g2 * p[B2]
    p[P23] = a2 * (a3 * p[P23] - g3 * b2) - g2 * p[B3]
    p[P2H] = ah * (a2 * p[P2H] - g2 * bh)
    p[P33] = a3 * (a3 * p[P33] - g3 * b3) - g3 * p[B3]
    p[P3H] = ah * (a3 * p[P3H] - g3 * bh)
    p[PHH] *= ah * ah


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
    ds = slope_V * p[SS] + m_V * p[SH]
    ds += rb * p[SB] - (fast * p[S1] + tail * (p[S2] + p[S3]))
    d1 = slope_V * p[S1] + m_V * p[P1H]
    d1 += rb * p[B1] - (fast * p[P11] + tail * (p[P12] + p[P13]))
    d2 = slope_V * p[S2] + m_V * p[P2H]
    d2 += rb * p[B2] - (fast * p[P12] + tail * (p[P22] + p[P23]))
    d3 = slope_V * p[S3] + m_V * p[P3H]
    d3 += rb * p[B3] - (fast * p[P13] + tail * (p[P23] + p[P33]))
    dh = slope_V * p[SH] + m_V * p[PHH]
    dh += rb * p[BH] - (fast * p[P1H] + tail * (p[P2H] + p[P3H]))
    db = slope_V * p[SB] + m_V * p[BH]
    db += rb * p[BB] - (fast * p[B1] + tail * (p[B2] + p[B3]))
    dq = slope_V * p[SQ] + m_V * p[QH]
    dq += rb * p[BQ] - (fast * p[Q1] + tail * (p[Q2] + p[Q3]))
    d[SOC] = ds
    d[V1] = d1
    d[V2] = d2
    d[V3] = d3
    d[H] = dh
    d[B] = db
    d[Q] = dq
    return float((slope_V * ds + m_V * dh) + (rb * db - (fast * d1 + tail * (d2 + d3))))


@njit(cache=True, error_model="numpy", inline="always")
def lean(p: FloatArray, f1: float, f2: float, f3: float) -> None:
    """The branches follow a SOC that is far off through the slopes of their resistances."""
    ss, s1, s2, s3, sh = p[SS], p[S1], p[S2], p[S3], p[SH]
    p[P11] += f1 * (2.0 * s1 + f1 * ss)
    p[P12] += f1 * s2 + f2 * s1 + f1 * f2 * ss
    p[P13] += f1 * s3 + f3 * s1 + f1 * f3 * ss
    p[P1H] += f1 * sh
    p[B1] += f1 * p[SB]
    p[Q1] += f1 * p[SQ]
    p[P22] += f2 * (2.0 * s2 + f2 * ss)
    p[P23] += f2 * s3 + f3 * s2 + f2 * f3 * ss
    p[P2H] += f2 * sh
    p[B2] += f2 * p[SB]
    p[Q2] += f2 * p[SQ]
    p[P33] += f3 * (2.0 * s3 + f3 * ss)
    p[P3H] += f3 * sh
    p[B3] += f3 * p[SB]
    p[Q3] += f3 * p[SQ]
    p[S1] += f1 * ss
    p[S2] += f2 * ss
    p[S3] += f3 * ss


@njit(cache=True, error_model="numpy", inline="always")
def flatten(p: FloatArray, d: FloatArray, c: FloatArray, inverse: float, less_V: float) -> bool:
    """Before :func:`correct`: its gain, worth only a slope that is flatter by ``-less_V``.

    Joseph's form with d = P H' of the steeper slope, as in the EKF; c is room to work in. Offset
    and capacity are not corrected while SOC is as far off. False, and P as it was, where nothing
    was learnt: the SOC would be known no better for it.
    """
    e = less_V * (2.0 * d[SOC] + less_V * p[SS])
    gain = d[SOC] * inverse
    if not gain * (gain * e - 2.0 * less_V * p[SS]) < gain * d[SOC]:
        return False
    for i in range(STATES):
        c[i] = less_V * p[SOC * STATES + i]
    for i in range(B):
        ki = d[i] * inverse
        for j in range(i, B):
            kj = d[j] * inverse
            p[i * STATES + j] += ki * kj * e - ki * c[j] - c[i] * kj
    return True


@njit(cache=True, error_model="numpy", inline="always")
def shift(
    x: FloatArray,
    d: FloatArray,
    inverse: float,
    innovation: float,
    hold_offset: bool,
    hold_charge: bool,
) -> None:
    """The state's part of :func:`correct`: x moved, P as it was."""
    b, q = x[B], x[Q]
    for i in range(STATES):
        x[i] += d[i] * inverse * innovation
    if hold_offset:
        x[B] = b
    if hold_charge:
        x[Q] = q
    x[H] = min(max(x[H], -1.0), 1.0)
    x[Q] = min(max(x[Q], CHARGE_LOW), CHARGE_HIGH)


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
    shift(x, d, inverse, innovation, hold_offset, hold_charge)
    bb, bq, qq = p[BB], p[BQ], p[QQ]
    for i in range(STATES):
        k = d[i] * inverse
        for j in range(i, STATES):
            p[i * STATES + j] -= k * d[j]
    if hold_offset:
        p[BB] = bb
    if hold_charge:
        p[QQ] = qq
    if hold_offset and hold_charge:
        p[BQ] = bq
    for i in range(STATES):
        p[i * STATES + i] = max(p[i * STATES + i], 0.0)
    p[SS] = max(p[SS], VARIANCE_FLOOR)


@njit(cache=True, error_model="numpy", inline="always")
def begin_anew(p: FloatArray, ss: float, p11: float, p22: float, p33: float) -> None:
    """P after a lock-out: variances of SOC and branches as found, offset and capacity as they were.

    What SOC and branches had in common with anything belongs to the state that was given up.
    """
    for i in range(B):
        for j in range(i + 1, STATES):
            p[i * STATES + j] = 0.0
    p[SS] = ss
    p[P11] = p11
    p[P22] = p22
    p[P33] = p33


@njit(cache=True, error_model="numpy", inline="always")
def settled_variance(p: FloatArray) -> float:
    """Variance that SOC would have if offset and capacity were known."""
    free_b = p[BB] > 0.0
    free_q = p[QQ] > 0.0
    if free_b and free_q:
        sb, sq = p[SB], p[SQ]
        bb, bq, qq = p[BB], p[BQ], p[QQ]
        det = max(bb * qq - bq * bq, NEARLY * bb * qq)
        return float(p[SS] - (sb * (sb * qq - sq * bq) + sq * (sq * bb - sb * bq)) / det)
    if free_b:
        return float(p[SS] - p[SB] * p[SB] / p[BB])
    if free_q:
        return float(p[SS] - p[SQ] * p[SQ] / p[QQ])
    return float(p[SS])
