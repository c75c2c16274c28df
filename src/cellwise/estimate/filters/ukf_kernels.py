"""The unscented Kalman filter as scalar code: sigma points of the whole state, few look-ups.

State x = [soc, v1, v2, v3, h], scaled sigma points (Julier; van der Merwe's scaling) along the
columns of the lower Cholesky factor of P with the SOC first. Only the first column has a component
along the SOC, and at one SOC the model is affine in all else. So every pair of points but the
first goes through the same affine map, and its share of the transform is known without taking it:
the covariance given the SOC, mapped. Three points remain, the centre and the pair along the first
column [P_ss, P_s1, ...] / sqrt(P_ss); the result is that of all eleven, to rounding.

Points are drawn again between predict and update. Evidence, gate and sensors are the EKF's.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from cellwise.cell.kernels import (
    CellPoint,
    CellScalars,
    heat_step,
    hysteresis_decay,
    look_up,
    rc_step,
    soc_step,
    under_load,
)
from cellwise.estimate.evidence_kernels import weigh
from cellwise.estimate.filters.ekf_kernels import (
    OUT_INNOVATION,
    OUT_RATIO,
    OUT_SOC,
    OUT_STD,
    OUT_VARIANCE,
    OUT_VOLTAGE,
    SOC_HIGH,
    SOC_LOW,
    VARIANCE_FLOOR,
    WIDE_VARIANCE,
)
from cellwise.estimate.filters.filter_state import EkfInfo, EkfStart, EkfState, ekf_start
from cellwise.estimate.measurement_kernels import (
    lasting_step,
    start_branch,
    voltage_variance,
)
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.recovery_kernels import recovered
from cellwise.estimate.sensing_kernels import NOT_BEGUN, read_sample
from cellwise.estimate.status import CLAMPED, STATE_RESET
from cellwise.typing import BoolArray, FloatArray, IntArray


class SigmaScalars(NamedTuple):
    """Scaled sigma points as the kernels see them.

    ``reach`` is c = sqrt(n + lambda), how many standard deviations out a point lies; ``side`` the
    weight of one outer point, 1 / (2 c^2); ``curve`` what the square of a second difference adds to
    a covariance. While the SOC's variance is below ``wide_variance`` every point has the
    resistances of the centre.
    """

    reach: float
    side: float
    curve: float
    wide_variance: float


@njit(cache=True, error_model="numpy", inline="always")
def point_voltage(point: CellPoint, drop_V: float, h: float) -> float:
    """Terminal voltage of one sigma point."""
    return (point.ocv_V + point.m_V * h) - drop_V


@njit(cache=True, error_model="numpy", inline="always")
def ukf_step_inline(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    noise: NoiseScalars,
    sigma: SigmaScalars,
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
    if gap:
        ss += noise.gap_soc * noise.gap_soc
    # The pair of sigma points along the first column of the Cholesky factor.
    c = sigma.reach
    root = math.sqrt(max(ss, VARIANCE_FLOOR))
    step = c * root
    l1 = x.s1 / root
    l2 = x.s2 / root
    l3 = x.s3 / root
    lh = x.sh / root
    # A resistance that is off by a share must not vouch for the SOC: unless the SOC is badly known,
    # every point has the centre's.
    wide = ss > sigma.wide_variance
    up = point
    low = point
    if wide:
        up = under_load(cell, look_up(table, grid, cell, soc + step, warm), seen)
        low = under_load(cell, look_up(table, grid, cell, soc - step, warm), seen)
    a1 = math.exp(-dt_s / point.tau1_s)
    a2 = math.exp(-dt_s / point.tau2_s)
    a3 = 1.0
    ah = 1.0
    if cell.hysteresis_rate != 0.0:
        ah = hysteresis_decay(cell, flow, dt_s)
    gs = -dt_s / cell.charge_As
    g1 = point.r1_ohm * (1.0 - a1)
    g2 = point.r2_ohm * (1.0 - a2)
    g3 = 0.0
    y1 = a1 * old1 + g1 * flow
    y2 = a2 * old2 + g2 * flow
    y3 = old3
    up1 = rc_step(old1 + c * l1, flow, up.r1_ohm, up.tau1_s, dt_s)
    up2 = rc_step(old2 + c * l2, flow, up.r2_ohm, up.tau2_s, dt_s)
    up3 = old3 + c * l3
    low1 = rc_step(old1 - c * l1, flow, low.r1_ohm, low.tau1_s, dt_s)
    low2 = rc_step(old2 - c * l2, flow, low.r2_ohm, low.tau2_s, dt_s)
    low3 = old3 - c * l3
    if point.r3_ohm != 0.0:
        a3 = math.exp(-dt_s / point.tau3_s)
        g3 = point.r3_ohm * (1.0 - a3)
        y3 = a3 * old3 + g3 * flow
        up3 = rc_step(up3, flow, up.r3_ohm, up.tau3_s, dt_s)
        low3 = rc_step(low3, flow, low.r3_ohm, low.tau3_s, dt_s)
    h = ah * x.h - (1.0 - ah) * math.copysign(1.0, flow)

    # Mean and covariance: first and second differences along the pair, what is left of P given the
    # SOC mapped by the centre's map, and the noise of the EKF.
    per = 0.5 / c
    d1 = (up1 - low1) * per
    d2 = (up2 - low2) * per
    d3 = (up3 - low3) * per
    dh = ah * lh
    e1 = (up1 + low1) - 2.0 * y1
    e2 = (up2 + low2) - 2.0 * y2
    e3 = (up3 + low3) - 2.0 * y3
    v1 = y1 + sigma.side * e1
    v2 = y2 + sigma.side * e2
    v3 = y3 + sigma.side * e3
    k = sigma.curve
    q = noise.current_A * noise.current_A
    qb = q + s.gap_A2
    share = noise.branch_share * flow
    share = share * share + s.lost_A * s.lost_A
    w1 = share * point.r1_ohm * point.r1_ohm * (1.0 - a1 * a1)
    w2 = share * point.r2_ohm * point.r2_ohm * (1.0 - a2 * a2)
    w3 = share * point.r3_ohm * point.r3_ohm * (1.0 - a3 * a3)
    p11 = a1 * a1 * (p11 - l1 * l1) + d1 * d1 + k * e1 * e1 + (qb * g1 * g1 + w1)
    p12 = a1 * a2 * (x.p12 - l1 * l2) + d1 * d2 + k * e1 * e2 + qb * g1 * g2
    p13 = a1 * a3 * (x.p13 - l1 * l3) + d1 * d3 + k * e1 * e3 + qb * g1 * g3
    p1h = a1 * ah * (x.p1h - l1 * lh) + d1 * dh
    p22 = a2 * a2 * (p22 - l2 * l2) + d2 * d2 + k * e2 * e2 + (qb * g2 * g2 + w2)
    p23 = a2 * a3 * (x.p23 - l2 * l3) + d2 * d3 + k * e2 * e3 + qb * g2 * g3
    p2h = a2 * ah * (x.p2h - l2 * lh) + d2 * dh
    p33 = a3 * a3 * (p33 - l3 * l3) + d3 * d3 + k * e3 * e3 + (qb * g3 * g3 + w3)
    p3h = a3 * ah * (x.p3h - l3 * lh) + d3 * dh
    phh = ah * ah * x.phh
    s1 = root * d1 + q * gs * g1
    s2 = root * d2 + q * gs * g2
    s3 = root * d3 + q * gs * g3
    sh = root * dh
    if s.lost_A > 0.0:
        # It may keep one sign for as long as it is away: the deviation grows, not the variance.
        drift = math.sqrt(ss) + s.lost_A * dt_s / cell.charge_As
        ss = drift * drift
    ss += q * gs * gs + noise.soc_per_sqrt_s * noise.soc_per_sqrt_s * dt_s

    # Innovation: sigma points drawn anew from the prediction.
    root = math.sqrt(max(ss, VARIANCE_FLOOR))
    step = c * root
    l1 = s1 / root
    l2 = s2 / root
    l3 = s3 / root
    lh = sh / root
    branches = (v1 + v2) + v3
    along = c * ((l1 + l2) + l3)
    up = under_load(cell, look_up(table, grid, cell, soc + step, warm), seen)
    low = under_load(cell, look_up(table, grid, cell, soc - step, warm), seen)
    r_up = up.r0_ohm if wide else point.r0_ohm
    r_low = low.r0_ohm if wide else point.r0_ohm
    centre = point_voltage(point, point.r0_ohm * seen + branches, h)
    above = point_voltage(up, r_up * seen + branches + along, h + c * lh)
    below = point_voltage(low, r_low * seen + branches - along, h - c * lh)
    dz = (above - below) * per
    ez = (above + below) - 2.0 * centre
    predicted = centre + sigma.side * ez
    heat = x.heat_K
    if cell.heating_K_per_W != 0.0:
        heat = heat_step(cell, heat, flow, point.r0_ohm * seen + branches, dt_s)
    m = point.m_V
    r1 = m * (p1h - l1 * lh) - ((p11 - l1 * l1) + (p12 - l1 * l2) + (p13 - l1 * l3))
    r2 = m * (p2h - l2 * lh) - ((p12 - l1 * l2) + (p22 - l2 * l2) + (p23 - l2 * l3))
    r3 = m * (p3h - l3 * lh) - ((p13 - l1 * l3) + (p23 - l2 * l3) + (p33 - l3 * l3))
    rh = m * (phh - lh * lh) - ((p1h - l1 * lh) + (p2h - l2 * lh) + (p3h - l3 * lh))
    state_variance = (m * rh - ((r1 + r2) + r3)) + dz * dz + k * ez * ez
    zs = root * dz
    z1 = r1 + l1 * dz
    z2 = r2 + l2 * dz
    z3 = r3 + l3 * dz
    zh = rh + lh * dz
    held_V = abs(v1) + (abs(v2) + abs(v3))
    one = voltage_variance(noise, point.error_V, point.ocv_slope_V, point.r0_ohm, seen, held_V)
    if s.lost_A > 0.0:
        one += s.lost_A * s.lost_A * point.r0_ohm * point.r0_ohm
    variance = state_variance + one
    # fmt: off
    seen_as = weigh(
        cell, noise, x.watch, s, evidence, x.rejections, x.mismatch,
        s.voltage_V - predicted, state_variance, one, point.r0_ohm, held_V, dt_s,
        ss > WIDE_VARIANCE, False,
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
            one, abs(point.r0_ohm * seen) + held_V, evidence >= 0.0, soc, ss,
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
        ks = zs * inverse
        k1 = z1 * inverse
        k2 = z2 * inverse
        k3 = z3 * inverse
        kh = zh * inverse
        soc += ks * innovation
        slope = ((up.ocv_V - low.ocv_V) - (r_up - r_low) * seen) / (2.0 * step)
        # fmt: off
        lasting = lasting_step(
            noise, point.error_V, point.ocv_slope_V, seen_as.mismatch, ks, slope, lasting
        )
        # fmt: on
        v1 += k1 * innovation
        v2 += k2 * innovation
        v3 += k3 * innovation
        h = min(max(h + kh * innovation, -1.0), 1.0)
        ss = max(ss - ks * zs, VARIANCE_FLOOR)
        s1 -= ks * z1
        s2 -= ks * z2
        s3 -= ks * z3
        sh -= ks * zh
        p11 = max(p11 - k1 * z1, 0.0)
        p12 -= k1 * z2
        p13 -= k1 * z3
        p1h -= k1 * zh
        p22 = max(p22 - k2 * z2, 0.0)
        p23 -= k2 * z3
        p2h -= k2 * zh
        p33 = max(p33 - k3 * z3, 0.0)
        p3h -= k3 * zh
        phh = max(phh - kh * zh, 0.0)
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
def ukf_step(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    noise: NoiseScalars,
    sigma: SigmaScalars,
    anew: EkfStart,
    x: EkfState,
    current_A: float,
    voltage_V: float,
    temperature_C: float,
    dt_s: float,
    gap: bool,
) -> tuple[EkfState, EkfInfo]:
    """One step for online use."""
    return ukf_step_inline(
        table, grid, cell, noise, sigma, anew, x, current_A, voltage_V, temperature_C, dt_s, gap
    )


@njit(cache=True, error_model="numpy", nogil=True)
def ukf_rows(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    noise: NoiseScalars,
    sigma: SigmaScalars,
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
        x, info = ukf_step_inline(
            table,
            grid,
            cell,
            noise,
            sigma,
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
