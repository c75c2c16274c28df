"""The extended Kalman filter as scalar code: no matrix calls, no allocation in a step.

State x = [soc, v1, v2, v3, h]. While the SOC is well known the transition is taken as diagonal (no
state drives another within an interval; the current drives them all), so predict is one product
per covariance entry. P is carried as its upper triangle, 15 numbers.

The model's voltage error is remembered for minutes, so consecutive voltages repeat the same
evidence. Each is therefore weighed with its variance times the number of samples that share one
error (2 tau / dt: the spectral density of an exponentially correlated error at rest), while the
gate and NIS look at the plain variance of one sample.

While the SOC is known to worse than WIDE_VARIANCE, slopes are chords over one standard deviation
to either side, the resistances' slopes join them, and the covariance after an update is that of the
slope where the estimate lands.
"""

from __future__ import annotations

import math

from numba import njit

from cellwise.cell.kernels import (
    CellScalars,
    heat_step,
    hysteresis_decay,
    look_up,
    soc_step,
    under_load,
)
from cellwise.estimate.evidence_kernels import FORGIVEN as FORGIVEN
from cellwise.estimate.evidence_kernels import UNDER_LOAD_COUNT as UNDER_LOAD_COUNT
from cellwise.estimate.evidence_kernels import weigh
from cellwise.estimate.filters.filter_state import EkfInfo, EkfState, ekf_start
from cellwise.estimate.filters.filter_state import EkfStart as EkfStart
from cellwise.estimate.measurement_kernels import chord as chord
from cellwise.estimate.measurement_kernels import (
    flat_slope,
    lasting_step,
)
from cellwise.estimate.measurement_kernels import start_branch as start_branch
from cellwise.estimate.measurement_kernels import voltage_variance as voltage_variance
from cellwise.estimate.measurement_kernels import wide_slopes as wide_slopes
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.recovery_kernels import recovered
from cellwise.estimate.sensing_kernels import NOT_BEGUN, read_sample
from cellwise.estimate.status import CLAMPED, STATE_RESET
from cellwise.typing import BoolArray, FloatArray, IntArray

# Columns of the per-sample output: the fields of EkfInfo but the status.
OUT_SOC, OUT_STD, OUT_VOLTAGE, OUT_INNOVATION, OUT_VARIANCE, OUT_RATIO = range(6)
OUTPUTS = 6

SOC_LOW = 0.0
SOC_HIGH = 1.0
VARIANCE_FLOOR = 1e-12
WIDE_VARIANCE = 4e-4  # beyond 2 points of SOC the tangent is no guide
SMALL_MOVE = 0.05  # of a standard deviation: the slope is that of the spot left


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
    needs_temperature = table.shape[0] > 1 or cell.activation_K != 0.0
    # fmt: off
    s = read_sample(
        cell, noise, x.watch, anew.temperature_C, needs_temperature,
        current_A, voltage_V, temperature_C, dt_s, gap,
    )
    # fmt: on
    status = s.status
    seen = s.seen_A
    flow = s.flow_A

    # Predict: the state first, with the tables at the new SOC.
    soc = soc_step(cell, x.soc, flow, dt_s)
    if not (math.isfinite(soc) and math.isfinite(x.ss)):
        x = ekf_start(anew, s.current_A)
        soc = x.soc
        status |= STATE_RESET
    ss = x.ss
    warm = s.temperature_C + x.heat_K
    point = under_load(cell, look_up(table, grid, cell, soc, warm), seen)
    old1 = x.v1_V
    old2 = x.v2_V
    old3 = x.v3_V
    p11 = x.p11
    p22 = x.p22
    p33 = x.p33
    evidence = x.watch.evidence_s
    if evidence == NOT_BEGUN:
        old1, p11 = start_branch(cell, point.r1_ohm, seen)
        old2, p22 = start_branch(cell, point.r2_ohm, seen)
        old3, p33 = start_branch(cell, point.r3_ohm, seen)
        evidence = -1.0
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
    v1 = a1 * old1 + g1 * flow
    v2 = a2 * old2 + g2 * flow
    v3 = a3 * old3 + g3 * flow
    h = ah * x.h - (1.0 - ah) * math.copysign(1.0, flow)

    # Predict: the covariance. The current sensor drives every state at once; a branch resistance
    # that is off by a share drives its voltage like a current that is off by it (1 - a^2 keeps
    # the stationary spread independent of the sample rate), and so does a current that is lost.
    q = noise.current_A * noise.current_A
    qb = q + s.gap_A2
    share = noise.branch_share * flow
    share = share * share + s.lost_A * s.lost_A
    s1 = a1 * x.s1
    s2 = a2 * x.s2
    s3 = a3 * x.s3
    sh = ah * x.sh
    p11 = a1 * a1 * p11 + share * point.r1_ohm * point.r1_ohm * (1.0 - a1 * a1)
    p12 = a1 * a2 * x.p12
    p13 = a1 * a3 * x.p13
    p1h = a1 * ah * x.p1h
    p22 = a2 * a2 * p22 + share * point.r2_ohm * point.r2_ohm * (1.0 - a2 * a2)
    p23 = a2 * a3 * x.p23
    p2h = a2 * ah * x.p2h
    p33 = a3 * a3 * p33 + share * point.r3_ohm * point.r3_ohm * (1.0 - a3 * a3)
    p3h = a3 * ah * x.p3h
    phh = ah * ah * x.phh
    if gap:
        ss += noise.gap_soc * noise.gap_soc
    if s.lost_A > 0.0:
        # It may keep one sign for as long as it is away: the deviation grows, not the variance.
        drift = math.sqrt(ss) + s.lost_A * dt_s / cell.charge_As
        ss = drift * drift
    slope = point.ocv_slope_V
    bend = 0.0
    wide = ss > WIDE_VARIANCE
    spread = 0.0
    if wide:
        spread = math.sqrt(ss)
        w = wide_slopes(table, grid, cell, soc, point, spread, warm, seen)
        slope = w.voltage_V
        bend = w.bend_V
        f1 = w.r1_ohm * (1.0 - a1) * flow
        f2 = w.r2_ohm * (1.0 - a2) * flow
        f3 = w.r3_ohm * (1.0 - a3) * flow
        p11 += f1 * (2.0 * s1 + f1 * ss)
        p12 += f1 * s2 + f2 * s1 + f1 * f2 * ss
        p13 += f1 * s3 + f3 * s1 + f1 * f3 * ss
        p1h += f1 * sh
        p22 += f2 * (2.0 * s2 + f2 * ss)
        p23 += f2 * s3 + f3 * s2 + f2 * f3 * ss
        p2h += f2 * sh
        p33 += f3 * (2.0 * s3 + f3 * ss)
        p3h += f3 * sh
        s1 += f1 * ss
        s2 += f2 * ss
        s3 += f3 * ss
    ss += q * gs * gs + noise.soc_per_sqrt_s * noise.soc_per_sqrt_s * dt_s
    s1 += q * gs * g1
    s2 += q * gs * g2
    s3 += q * gs * g3
    p11 += qb * g1 * g1
    p12 += qb * g1 * g2
    p13 += qb * g1 * g3
    p22 += qb * g2 * g2
    p23 += qb * g2 * g3
    p33 += qb * g3 * g3

    # Innovation and its variance: d = P H', with H = [slope, -1, -1, -1, m].
    drop = (point.r0_ohm * seen + v1) + (v2 + v3)
    heat = x.heat_K
    if cell.heating_K_per_W != 0.0:
        heat = heat_step(cell, heat, flow, drop, dt_s)
    predicted = (point.ocv_V + point.m_V * h) - drop
    m = point.m_V
    ds = (slope * ss + m * sh) - ((s1 + s2) + s3)
    d1 = (slope * s1 + m * p1h) - ((p11 + p12) + p13)
    d2 = (slope * s2 + m * p2h) - ((p12 + p22) + p23)
    d3 = (slope * s3 + m * p3h) - ((p13 + p23) + p33)
    dh = (slope * sh + m * phh) - ((p1h + p2h) + p3h)
    state_variance = (slope * ds + m * dh) - ((d1 + d2) + d3)
    # An OCV that bends by c at one standard deviation is off its tangent by c z^2, 3 c^2 in square.
    state_variance += 3.0 * bend * bend
    branches = abs(v1) + (abs(v2) + abs(v3))
    one = voltage_variance(noise, point.error_V, point.ocv_slope_V, point.r0_ohm, seen, branches)
    if s.lost_A > 0.0:
        one += s.lost_A * s.lost_A * point.r0_ohm * point.r0_ohm
    variance = state_variance + one
    # fmt: off
    seen_as = weigh(
        cell, noise, x.watch, s, evidence, x.rejections, x.mismatch,
        s.voltage_V - predicted, state_variance, one, point.r0_ohm, branches, dt_s,
        ss > WIDE_VARIANCE, 3.0 * bend * bend > one or slope < flat_slope(table),
    )
    # fmt: on
    status |= seen_as.status
    innovation = seen_as.innovation_V
    lasting = 0.0 if seen_as.recover else x.lasting
    if seen_as.recover:
        # The gate may have locked the truth out: the SOC is looked for anew.
        # fmt: off
        soc, ss, p11, p22, p33 = recovered(
            table, grid, cell, warm, seen, s.voltage_V, (v1, v2, v3), (p11, p22, p33), h, phh,
            one, abs(point.r0_ohm * seen) + branches, evidence >= 0.0, soc, ss,
        )
        # fmt: on
        s1 = 0.0
        s2 = 0.0
        s3 = 0.0
        sh = 0.0
        p12 = 0.0
        p13 = 0.0
        p1h = 0.0
        p23 = 0.0
        p2h = 0.0
        p3h = 0.0
    if seen_as.accepted:
        inverse = seen_as.inverse
        ks = ds * inverse
        k1 = d1 * inverse
        k2 = d2 * inverse
        k3 = d3 * inverse
        kh = dh * inverse
        soc += ks * innovation
        # fmt: off
        lasting = lasting_step(
            noise, point.error_V, point.ocv_slope_V, seen_as.mismatch, ks, slope, lasting
        )
        # fmt: on
        v1 += k1 * innovation
        v2 += k2 * innovation
        v3 += k3 * innovation
        h = min(max(h + kh * innovation, -1.0), 1.0)
        learnt = True
        if wide:
            # The gain was that of the slope here; what it is worth is said by the slope where
            # it leads, if that is flatter (Joseph's form): on a plateau nothing was learnt.
            flat = min(slope, point.ocv_slope_V)
            if abs(ks * innovation) > SMALL_MOVE * spread:
                landed = under_load(cell, look_up(table, grid, cell, soc, warm), seen)
                there = wide_slopes(table, grid, cell, soc, landed, spread, warm, seen)
                flat = min(min(there.voltage_V, landed.ocv_slope_V), slope)
            less = flat - slope
            e = less * (2.0 * ds + less * ss)
            cs = less * ss
            learnt = ks * (ks * e - 2.0 * cs) < ks * ds
            if learnt:
                c1 = less * s1
                c2 = less * s2
                c3 = less * s3
                ch = less * sh
                ss += ks * (ks * e - 2.0 * cs)
                s1 += ks * k1 * e - ks * c1 - k1 * cs
                s2 += ks * k2 * e - ks * c2 - k2 * cs
                s3 += ks * k3 * e - ks * c3 - k3 * cs
                sh += ks * kh * e - ks * ch - kh * cs
                p11 += k1 * (k1 * e - 2.0 * c1)
                p12 += k1 * k2 * e - k1 * c2 - k2 * c1
                p13 += k1 * k3 * e - k1 * c3 - k3 * c1
                p1h += k1 * kh * e - k1 * ch - kh * c1
                p22 += k2 * (k2 * e - 2.0 * c2)
                p23 += k2 * k3 * e - k2 * c3 - k3 * c2
                p2h += k2 * kh * e - k2 * ch - kh * c2
                p33 += k3 * (k3 * e - 2.0 * c3)
                p3h += k3 * kh * e - k3 * ch - kh * c3
                phh += kh * (kh * e - 2.0 * ch)
        if learnt:
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
        heat, seen_as.rejections, seen_as.mismatch, lasting, seen_as.watch,
    )
    # fmt: on
    std = math.sqrt(ss + lasting * lasting)
    return state, EkfInfo(soc, std, predicted, innovation, variance, seen_as.ratio, status)


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
