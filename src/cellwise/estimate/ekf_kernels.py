"""The extended Kalman filter as scalar code: no matrix calls, no allocation in a step.

State x = [soc, v1, v2, v3, h]. The transition is diagonal (no state drives another within an
interval; the current drives them all), so predict is one product per covariance entry. P is
carried as its upper triangle, 15 numbers.

The model's voltage error is remembered for minutes, so consecutive voltages repeat the same
evidence. Each is therefore weighed with its variance times the number of samples that share one
error (2 tau / dt: the spectral density of an exponentially correlated error at rest), while the
gate and NIS look at the plain variance of one sample.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from cellwise.cell.kernels import (
    CellScalars,
    heat_step,
    hysteresis_decay,
    look_up,
    seen_current,
    soc_step,
    under_load,
)
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.status import (
    CLAMPED,
    CURRENT_INVALID,
    DUPLICATE,
    GATE_RECOVERY,
    INNOVATION_REJECTED,
    SEQUENCE_GAP,
    STATE_RESET,
    VOLTAGE_INVALID,
)
from cellwise.typing import BoolArray, FloatArray, IntArray

# Columns of the per-sample output: the fields of EkfInfo but the status.
OUT_SOC, OUT_STD, OUT_VOLTAGE, OUT_INNOVATION, OUT_VARIANCE, OUT_RATIO = range(6)
OUTPUTS = 6

SOC_LOW = 0.0
SOC_HIGH = 1.0
VARIANCE_FLOOR = 1e-12
WIDE_VARIANCE = 4e-4  # beyond 2 points of SOC the tangent is no guide
SLOPE_FLOOR_V = 0.05
RECOVERY_VARIANCE = 0.09
SHORTEST_CHORD = 1e-6


class EkfStart(NamedTuple):
    """Where a state begins, and begins anew when it is no longer finite."""

    soc: float
    variance: float
    branch_variance: float
    slow_branch_variance: float
    hysteresis_variance: float


class EkfState(NamedTuple):
    """What must be carried: x, the upper triangle of P, the last current, rejections in a row.

    ``rejections`` is -1 until a voltage has been seen; ``mismatch`` is the running mean of the
    squared innovations over the variance that the model alone explains.
    """

    soc: float
    v1_V: float
    v2_V: float
    v3_V: float
    h: float
    ss: float
    s1: float
    s2: float
    s3: float
    sh: float
    p11: float
    p12: float
    p13: float
    p1h: float
    p22: float
    p23: float
    p2h: float
    p33: float
    p3h: float
    phh: float
    current_A: float
    rejections: float
    mismatch: float
    heat_K: float

    @property
    def soc_std(self) -> float:
        """Standard deviation of the state of charge."""
        return math.sqrt(self.ss)


class EkfInfo(NamedTuple):
    """What may be looked at after a step.

    ``voltage_V`` is predicted before the sample's own voltage is used; ``test_ratio`` above 1
    means that the gate rejected it; ``status`` are the bits of
    :class:`cellwise.estimate.status.Status`.
    """

    soc: float
    soc_std: float
    voltage_V: float
    innovation_V: float
    innovation_variance_V2: float
    test_ratio: float
    status: int


@njit(cache=True, error_model="numpy")
def ekf_start(start: EkfStart, current_A: float) -> EkfState:
    """A cell at rest, known as well as ``start`` says."""
    h = 1.0 if start.soc > 0.5 else -1.0
    v = start.branch_variance
    w = start.slow_branch_variance
    q = start.hysteresis_variance
    # fmt: off
    return EkfState(
        start.soc, 0.0, 0.0, 0.0, h,
        start.variance, 0.0, 0.0, 0.0, 0.0,
        v, 0.0, 0.0, 0.0,
        v, 0.0, 0.0,
        w, 0.0,
        q,
        current_A, -1.0, 1.0, 0.0,
    )
    # fmt: on


@njit(cache=True, error_model="numpy", inline="always")
def chord(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    soc: float,
    ocv_V: float,
    spread: float,
    temperature_C: float,
) -> tuple[float, float]:
    """OCV slope over one standard deviation of SOC on either side, and how far the OCV bends [V].

    A far-off start must not be corrected with the slope of the spot where it happens to stand, nor
    be thought of as right afterwards when the OCV is no straight line. The bend is the distance
    from the OCV here to the chord, inside 0..1; for a small spread the slope is the tangent's.
    """
    low = min(max(soc - spread, 0.0), 1.0)
    high = min(max(soc + spread, 0.0), 1.0)
    a = look_up(table, grid, cell, low, temperature_C)
    if high - low < SHORTEST_CHORD:  # both beyond the same end
        return a.ocv_slope_V, 0.0
    b = look_up(table, grid, cell, high, temperature_C)
    slope = (b.ocv_V - a.ocv_V) / (high - low)
    return slope, a.ocv_V + slope * (soc - low) - ocv_V


@njit(cache=True, error_model="numpy", inline="always")
def voltage_variance(
    noise: NoiseScalars, error_V: float, slope_V: float, r0_ohm: float, current_A: float
) -> float:
    """Variance of one measured voltage about a perfect state [V^2].

    Sensor, the model's slow error at this SOC, a SOC scale that is off by ``ocv_soc`` (it matters
    where the OCV is steep), and an R0 that is off by ``branch_share``.
    """
    scale = noise.ocv_soc * slope_V
    drop = noise.branch_share * r0_ohm * current_A
    jitter = noise.current_A * r0_ohm
    slow = noise.error_scale * error_V
    fixed = noise.voltage_V * noise.voltage_V + slow * slow
    return fixed + (scale * scale + (drop * drop + jitter * jitter))


@njit(cache=True, error_model="numpy", inline="always")
def ekf_step_inline(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    noise: NoiseScalars,
    anew: EkfStart,
    x: EkfState,
    current_A: float,
    voltage_V: float,
    temperature_C: float,
    dt_s: float,
    gap: bool,
) -> tuple[EkfState, EkfInfo]:
    """One step: predict over the interval that ends now, then use the voltage read now."""
    status = 0
    current = current_A
    held = x.current_A if math.isfinite(x.current_A) else 0.0
    if not math.isfinite(current):
        current = held
        status |= CURRENT_INVALID
    ss = x.ss
    seen = seen_current(cell, current, held, dt_s)
    flow = seen
    unknown = 0.0
    if gap:
        # What flowed is not known: no charge is moved, and the branches may hold what the currents
        # on either side can have left there. The voltage is still read under the row's current.
        status |= SEQUENCE_GAP
        ss += noise.gap_soc * noise.gap_soc
        flow = 0.0
        unknown = seen * seen + held * held
    elif dt_s <= 0.0:
        status |= DUPLICATE

    # Predict: the state first, with the tables at the new SOC.
    warm = temperature_C + x.heat_K
    soc = soc_step(cell, x.soc, flow, dt_s)
    if not (math.isfinite(soc) and math.isfinite(ss)):
        x = ekf_start(anew, current)
        soc = x.soc
        ss = x.ss
        warm = temperature_C
        status |= STATE_RESET
    point = under_load(cell, look_up(table, grid, cell, soc, warm), seen)
    a1 = math.exp(-dt_s / point.tau1_s)
    a2 = math.exp(-dt_s / point.tau2_s)
    a3 = 1.0
    ah = 1.0
    if point.r3_ohm != 0.0:
        a3 = math.exp(-dt_s / point.tau3_s)
    if cell.hysteresis_rate != 0.0:
        ah = hysteresis_decay(cell, flow, dt_s)
    gs = -dt_s / cell.charge_As
    g1 = point.r1_ohm * (1.0 - a1)
    g2 = point.r2_ohm * (1.0 - a2)
    g3 = point.r3_ohm * (1.0 - a3)
    v1 = a1 * x.v1_V + g1 * flow
    v2 = a2 * x.v2_V + g2 * flow
    v3 = a3 * x.v3_V + g3 * flow
    h = ah * x.h - (1.0 - ah) * math.copysign(1.0, flow)

    # Predict: the covariance. The current sensor drives every state at once; a branch resistance
    # that is off by a share drives its voltage like a current that is off by it (1 - a^2 keeps
    # the stationary spread independent of the sample rate).
    q = noise.current_A * noise.current_A
    qb = q + unknown
    share = noise.branch_share * flow
    share = share * share
    ss += q * gs * gs + noise.soc_per_sqrt_s * noise.soc_per_sqrt_s * dt_s
    s1 = a1 * x.s1 + q * gs * g1
    s2 = a2 * x.s2 + q * gs * g2
    s3 = a3 * x.s3 + q * gs * g3
    sh = ah * x.sh
    p11 = a1 * a1 * x.p11 + (qb * g1 * g1 + share * point.r1_ohm * point.r1_ohm * (1.0 - a1 * a1))
    p12 = a1 * a2 * x.p12 + qb * g1 * g2
    p13 = a1 * a3 * x.p13 + qb * g1 * g3
    p1h = a1 * ah * x.p1h
    p22 = a2 * a2 * x.p22 + (qb * g2 * g2 + share * point.r2_ohm * point.r2_ohm * (1.0 - a2 * a2))
    p23 = a2 * a3 * x.p23 + qb * g2 * g3
    p2h = a2 * ah * x.p2h
    p33 = a3 * a3 * x.p33 + (qb * g3 * g3 + share * point.r3_ohm * point.r3_ohm * (1.0 - a3 * a3))
    p3h = a3 * ah * x.p3h
    phh = ah * ah * x.phh

    # Innovation and its variance: d = P H', with H = [slope, -1, -1, -1, m].
    drop = (point.r0_ohm * seen + v1) + (v2 + v3)
    heat = x.heat_K
    if cell.heating_K_per_W != 0.0:
        heat = heat_step(cell, heat, flow, drop, dt_s)
    predicted = (point.ocv_V + point.m_V * h) - drop
    slope = point.ocv_slope_V
    bend = 0.0
    if ss > WIDE_VARIANCE:
        slope, bend = chord(table, grid, cell, soc, point.ocv_V, math.sqrt(ss), warm)
    m = point.m_V
    ds = (slope * ss + m * sh) - ((s1 + s2) + s3)
    d1 = (slope * s1 + m * p1h) - ((p11 + p12) + p13)
    d2 = (slope * s2 + m * p2h) - ((p12 + p22) + p23)
    d3 = (slope * s3 + m * p3h) - ((p13 + p23) + p33)
    dh = (slope * sh + m * phh) - ((p1h + p2h) + p3h)
    state_variance = (slope * ds + m * dh) - ((d1 + d2) + d3)
    # An OCV that bends by c at one standard deviation is off its tangent by c z^2, 3 c^2 in square.
    state_variance += 3.0 * bend * bend
    one = voltage_variance(noise, point.error_V, point.ocv_slope_V, point.r0_ohm, seen)
    variance = state_variance + one
    innovation = voltage_V - predicted
    square = innovation * innovation
    gate = noise.gate * noise.gate
    ratio = square / (gate * variance)
    rejections = x.rejections
    # A model of another temperature, age or cell is wrong all the time: evidence weighs less by
    # what the innovations have lately shown beyond their variance.
    mismatch = x.mismatch
    if noise.mismatch_cap > 0.0 and noise.slow_s > 0.0 and math.isfinite(innovation):
        lately = min(dt_s / noise.slow_s, 1.0)
        mismatch += lately * (min(square / variance, noise.mismatch_cap) - mismatch)
    if not math.isfinite(innovation):
        status |= VOLTAGE_INVALID
        innovation = math.nan
        ratio = math.nan
    elif ratio > 1.0:
        status |= INNOVATION_REJECTED
        # Under load the resistances may be what is wrong: only what three times the polarisation
        # cannot explain speaks against the SOC.
        polarisation = (abs(point.r0_ohm * seen) + abs(v1)) + (abs(v2) + abs(v3))
        if square > gate * variance + 4.0 * polarisation * polarisation:
            rejections = max(rejections, 0.0) + 1.0
        if rejections >= noise.recovery_after:
            # The gate may have locked the truth out: admit a SOC error as large as what is seen,
            # so that the next voltage passes.
            status |= GATE_RECOVERY
            rejections = 0.0
            mismatch = 1.0
            missed = innovation / max(slope, SLOPE_FLOOR_V)
            ss += min(missed * missed, RECOVERY_VARIANCE)
    else:
        shared = 1.0  # the first voltage is evidence by itself
        if rejections >= 0.0 and noise.slow_s > 0.0:
            # A repeated stamp repeats the slow error: no new evidence.
            shared = max(2.0 * noise.slow_s / dt_s, 1.0) if dt_s > 0.0 else math.inf
        rejections = 0.0
        inverse = 1.0 / (state_variance + one * shared * max(mismatch, 1.0))
        ks = ds * inverse
        k1 = d1 * inverse
        k2 = d2 * inverse
        k3 = d3 * inverse
        kh = dh * inverse
        soc += ks * innovation
        v1 += k1 * innovation
        v2 += k2 * innovation
        v3 += k3 * innovation
        h = min(max(h + kh * innovation, -1.0), 1.0)
        ss = max(ss - ks * ds, VARIANCE_FLOOR)
        s1 -= ks * d1
        s2 -= ks * d2
        s3 -= ks * d3
        sh -= ks * dh
        p11 = max(p11 - k1 * d1, 0.0)
        p12 -= k1 * d2
        p13 -= k1 * d3
        p1h -= k1 * dh
        p22 = max(p22 - k2 * d2, 0.0)
        p23 -= k2 * d3
        p2h -= k2 * dh
        p33 = max(p33 - k3 * d3, 0.0)
        p3h -= k3 * dh
        phh = max(phh - kh * dh, 0.0)
    if soc < SOC_LOW or soc > SOC_HIGH:
        soc = min(max(soc, SOC_LOW), SOC_HIGH)
        status |= CLAMPED
    # fmt: off
    state = EkfState(
        soc, v1, v2, v3, h,
        ss, s1, s2, s3, sh,
        p11, p12, p13, p1h,
        p22, p23, p2h,
        p33, p3h,
        phh,
        current, rejections, mismatch, heat,
    )
    # fmt: on
    return state, EkfInfo(soc, math.sqrt(ss), predicted, innovation, variance, ratio, status)


@njit(cache=True, error_model="numpy")
def ekf_step(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    noise: NoiseScalars,
    anew: EkfStart,
    x: EkfState,
    current_A: float,
    voltage_V: float,
    temperature_C: float,
    dt_s: float,
    gap: bool,
) -> tuple[EkfState, EkfInfo]:
    """One step for online use."""
    return ekf_step_inline(
        table, grid, cell, noise, anew, x, current_A, voltage_V, temperature_C, dt_s, gap
    )


@njit(cache=True, error_model="numpy", nogil=True)
def ekf_rows(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    noise: NoiseScalars,
    start: EkfStart,
    anew: EkfStart,
    current_A: FloatArray,
    voltage_V: FloatArray,
    temperature_C: FloatArray,
    dt_s: FloatArray,
    gap: BoolArray,
    out: FloatArray,
    status: IntArray,
) -> EkfState:
    """Every row of a log through one step each; ``out`` has shape (OUTPUTS, rows)."""
    x = ekf_start(start, current_A[0])
    for k in range(dt_s.size):
        x, info = ekf_step_inline(
            table,
            grid,
            cell,
            noise,
            anew,
            x,
            current_A[k],
            voltage_V[k],
            temperature_C[k],
            dt_s[k],
            gap[k],
        )
        out[OUT_SOC, k] = info.soc
        out[OUT_STD, k] = info.soc_std
        out[OUT_VOLTAGE, k] = info.voltage_V
        out[OUT_INNOVATION, k] = info.innovation_V
        out[OUT_VARIANCE, k] = info.innovation_variance_V2
        out[OUT_RATIO, k] = info.test_ratio
        status[k] = info.status
    return x
