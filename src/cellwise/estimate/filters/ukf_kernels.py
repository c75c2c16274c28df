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

from cellwise.cell.compiled import inline, kernel, rows
from cellwise.cell.equations import (
    CellState,
    CellTables,
    heat_step,
    loaded,
    rc_step,
    terminal_voltage,
    with_heat,
    with_soc,
)
from cellwise.cell.point_kernels import CellPoint
from cellwise.estimate.evidence_kernels import voltage_variance
from cellwise.estimate.filters.covariance_kernels import (
    VARIANCE_FLOOR,
    Column,
    Covariance,
    column,
    corrected,
    decayed,
    explained,
    noisy,
    scaled,
    with_outer,
    with_soc_row,
    without_outer,
)
from cellwise.estimate.filters.ekf_kernels import (
    beside_step,
    counted,
    finish,
    look_again,
    moved,
    nothing_beside,
    put_info,
    reading_of,
    recover,
)
from cellwise.estimate.filters.filter_state import (
    EkfInfo,
    EkfStart,
    EkfState,
    LogArrays,
    TraceArrays,
    ekf_start,
)
from cellwise.estimate.filters.predict_kernels import (
    Begun,
    begin_interval,
    branch_variance,
    drifted,
    soc_wander,
    unseen_variance,
)
from cellwise.estimate.gate_kernels import Innovation, gate
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import Reading, Sample, read_sample
from cellwise.estimate.slopes_kernels import WIDE_VARIANCE, flat_slope


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


class Pair(NamedTuple):
    """The points along the first column of the Cholesky factor, at c times its length."""

    root: float
    step: float
    along: Column


class Spread(NamedTuple):
    """Mean and covariance after an interval; ``wide`` where the points have their own tables."""

    x: CellState
    p: Covariance
    wide: bool


class Seen(NamedTuple):
    """The voltage over the points: mean, first and second difference, OCV's slope between them."""

    predicted_V: float
    first_V: float
    second_V: float
    slope_V: float


@inline
def pair_of(sigma: SigmaScalars, p: Covariance, ss: float) -> Pair:
    """The pair; a SOC that is known exactly keeps a variance above zero."""
    root = math.sqrt(max(ss, VARIANCE_FLOOR))
    along = Column(ss / root, p.s1 / root, p.s2 / root, p.s3 / root, p.sh / root)
    return Pair(root, sigma.reach * root, along)


@inline
def predict(
    tables: CellTables, noise: NoiseScalars, sigma: SigmaScalars, s: Sample, begun: Begun
) -> Spread:
    """First and second differences along the pair, the rest of P mapped, and noise."""
    now = begun.now
    old, point, t, c = now.old, now.point, now.t, sigma.reach
    ss = unseen_variance(tables, noise, s, begun.p.ss)
    pair = pair_of(sigma, begun.p, ss)
    along = pair.along
    # A resistance that is off by a share must not vouch for the SOC: unless the SOC is badly known,
    # every point has the centre's.
    wide = ss > sigma.wide_variance
    up, low = point, point
    if wide:
        up = loaded(tables, now.end.soc + pair.step, now.warm_C, s.seen_A, now.end.slow_A)
        low = loaded(tables, now.end.soc - pair.step, now.warm_C, s.seen_A, now.end.slow_A)
    up1 = rc_step(old.v1_V + c * along.v1, s.flow_A, up.r1_ohm, up.tau1_s, s.dt_s)
    up2 = rc_step(old.v2_V + c * along.v2, s.flow_A, up.r2_ohm, up.tau2_s, s.dt_s)
    up3 = old.v3_V + c * along.v3
    low1 = rc_step(old.v1_V - c * along.v1, s.flow_A, low.r1_ohm, low.tau1_s, s.dt_s)
    low2 = rc_step(old.v2_V - c * along.v2, s.flow_A, low.r2_ohm, low.tau2_s, s.dt_s)
    low3 = old.v3_V - c * along.v3
    if point.r3_ohm != 0.0:
        up3 = rc_step(up3, s.flow_A, up.r3_ohm, up.tau3_s, s.dt_s)
        low3 = rc_step(low3, s.flow_A, low.r3_ohm, low.tau3_s, s.dt_s)
    x = now.end
    per = 0.5 / c
    d = Column(0.0, (up1 - low1) * per, (up2 - low2) * per, (up3 - low3) * per, t.ah * along.h)
    e1 = (up1 + low1) - 2.0 * x.v1_V
    e2 = (up2 + low2) - 2.0 * x.v2_V
    e3 = (up3 + low3) - 2.0 * x.v3_V
    mean = CellState(
        x.soc,
        x.v1_V + sigma.side * e1,
        x.v2_V + sigma.side * e2,
        x.v3_V + sigma.side * e3,
        x.h,
        x.heat_K,
        x.slow_A,
    )
    p = decayed(without_outer(begun.p, along), t)
    p = with_outer(p, d, sigma.curve, Column(0.0, e1, e2, e3, 0.0))
    p = with_soc_row(p, drifted(tables, s, ss), d, pair.root)
    q = noise.current_A * noise.current_A
    p = noisy(
        p,
        t,
        q,
        q + s.gap_A2,
        soc_wander(noise, begun.state.watch.no_voltage_s, s.dt_s),
        branch_variance(noise, s, point.r1_ohm, t.a1),
        branch_variance(noise, s, point.r2_ohm, t.a2),
        branch_variance(noise, s, point.r3_ohm, t.a3),
    )
    return Spread(mean, p, wide)


@inline
def voltages(
    tables: CellTables,
    sigma: SigmaScalars,
    s: Sample,
    point: CellPoint,
    warm_C: float,
    now: Spread,
    pair: Pair,
) -> Seen:
    """Voltage of the centre and of the pair, drawn again from the prediction."""
    x, c, along = now.x, sigma.reach, pair.along
    branches = (x.v1_V + x.v2_V) + x.v3_V
    away = c * ((along.v1 + along.v2) + along.v3)
    up = loaded(tables, x.soc + pair.step, warm_C, s.seen_A, x.slow_A)
    low = loaded(tables, x.soc - pair.step, warm_C, s.seen_A, x.slow_A)
    r_up = up.r0_ohm if now.wide else point.r0_ohm
    r_low = low.r0_ohm if now.wide else point.r0_ohm
    centre = terminal_voltage(point, x.h, point.r0_ohm * s.seen_A + branches)
    above = terminal_voltage(up, x.h + c * along.h, r_up * s.seen_A + branches + away)
    below = terminal_voltage(low, x.h - c * along.h, r_low * s.seen_A + branches - away)
    second = (above + below) - 2.0 * centre
    slope = ((up.ocv_V - low.ocv_V) - (r_up - r_low) * s.seen_A) / (2.0 * pair.step)
    return Seen(centre + sigma.side * second, (above - below) * (0.5 / c), second, slope)


@inline
def ukf_step_inline(
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars,
    start: EkfStart,
    state: EkfState,
    reading: Reading,
) -> tuple[EkfState, EkfInfo]:
    """One step: predict over the interval that ends now, then use the voltage read now."""
    s = read_sample(tables, noise, state.watch, start.temperature_C, reading)
    begun = begin_interval(tables, noise, start, state, s)
    old, point, warm = begun.state, begun.now.point, begun.now.warm_C
    now = predict(tables, noise, sigma, s, begun)
    x, p = now.x, now.p
    pair = pair_of(sigma, p, p.ss)
    seen = voltages(tables, sigma, s, point, warm, now, pair)
    branches = (x.v1_V + x.v2_V) + x.v3_V
    drop = point.r0_ohm * s.seen_A + branches
    heat = heat_step(tables.cell, x.heat_K, s.flow_A, drop, s.dt_s)
    x = with_heat(x, heat)

    # Covariance with the voltage: along the pair, and given the SOC.
    rest = column(without_outer(p, pair.along), 0.0, point.m_V)
    along, first = pair.along, seen.first_V
    d = Column(
        pair.root * first,
        rest.v1 + along.v1 * first,
        rest.v2 + along.v2 * first,
        rest.v3 + along.v3 * first,
        rest.h + along.h * first,
    )
    given = explained(Column(0.0, rest.v1, rest.v2, rest.v3, rest.h), 0.0, point.m_V)
    state_variance = given + first * first + sigma.curve * seen.second_V * seen.second_V
    held = abs(x.v1_V) + (abs(x.v2_V) + abs(x.v3_V))
    one = voltage_variance(noise, point, point.r0_ohm, s.seen_A, s.lost_A, held)
    bent = min(seen.slope_V, point.ocv_slope_V) < flat_slope(tables)
    # fmt: off
    i = Innovation(
        seen.predicted_V, s.voltage_V - seen.predicted_V, state_variance, one, point.r0_ohm, held,
        p.ss > WIDE_VARIANCE, bent,
    )
    v = gate(
        tables.cell, noise, old.watch, s, begun.evidence_s, old.rejections, old.mismatch, i
    )
    # fmt: on
    predicted = x
    x, beside = counted(predicted, old, begun.drift)
    if v.recover:
        x, p = recover(tables, s, predicted, p, i, warm, begun.evidence_s >= 0.0)
        beside = nothing_beside()
    elif v.accepted:
        k = scaled(d, v.inverse)
        x = moved(predicted, k, v.innovation_V)
        p = corrected(p, k, d)
        beside, move = beside_step(
            noise,
            point,
            s,
            v,
            old,
            begun.drift,
            seen.slope_V,
            k.s,
            i,
            tables.cell.charge_As,
            begun.status,
        )
        x = with_soc(x, x.soc + move)
    # fmt: off
    x, p, beside, past = look_again(
        tables, noise, s, warm, begun.evidence_s, begun.past, v, x, p, beside
    )
    # fmt: on
    return finish(x, p, beside, past, i, v, s.status | begun.status | v.status)


@kernel
def ukf_step(
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars,
    start: EkfStart,
    state: EkfState,
    reading: Reading,
) -> tuple[EkfState, EkfInfo]:
    """One step for online use."""
    return ukf_step_inline(tables, noise, sigma, start, state, reading)


@rows
def ukf_rows(
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars,
    first: EkfStart,
    start: EkfStart,
    log: LogArrays,
    out: TraceArrays,
) -> EkfState:
    """Every row of a log through one step each; ``start`` re-initialises a state gone wrong."""
    state = ekf_start(first, log.current_A[0])
    for k in range(log.dt_s.size):
        state, info = ukf_step_inline(tables, noise, sigma, start, state, reading_of(log, k))
        put_info(out, k, info)
    return state
