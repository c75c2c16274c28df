"""The adaptive filter's prediction: the state over an interval, then its covariance.

x = [soc, v1, v2, v3, h, b, q]; the equations stand in ``adaptive_kernels``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from cellwise.cell.kernels import (
    CellPoint,
    CellScalars,
    hysteresis_decay,
    look_up,
    under_load,
)
from cellwise.estimate.filters.adaptive_state_kernels import (
    BB,
    FAST_VAR,
    HEAT_K,
    P11,
    P22,
    P33,
    QQ,
    SOC,
    SS,
    TAIL_VAR,
    V1,
    V2,
    V3,
    AdaptiveScalars,
    B,
    H,
    Q,
    adaptive_start,
    lean,
    spread,
)
from cellwise.estimate.filters.ekf_kernels import WIDE_VARIANCE
from cellwise.estimate.filters.filter_state import EkfStart
from cellwise.estimate.measurement_kernels import start_branch, wide_slopes
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import Sample
from cellwise.estimate.status import STATE_RESET
from cellwise.typing import FloatArray


class Predicted(NamedTuple):
    """What the prediction hands to the update; slope and bend are chords while SOC is far off.

    ``load_A`` is what the voltage has seen without the sensor's offset, ``flow_A`` what moved
    charge: 0 where nobody knows.
    """

    point: CellPoint
    load_A: float
    flow_A: float
    warm_C: float
    slope_V: float
    bend_V: float
    wide: bool
    status: int


@njit(cache=True, error_model="numpy", inline="always")
def begin_branches(
    cell: CellScalars, point: CellPoint, current_A: float, x: FloatArray, p: FloatArray
) -> None:
    """What the branches may hold at the first sample."""
    x[V1], p[P11] = start_branch(cell, point.r1_ohm, current_A)
    x[V2], p[P22] = start_branch(cell, point.r2_ohm, current_A)
    x[V3], p[P33] = start_branch(cell, point.r3_ohm, current_A)


@njit(cache=True, error_model="numpy", inline="always")
def predict(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    noise: NoiseScalars,
    learn: AdaptiveScalars,
    anew: EkfStart,
    x: FloatArray,
    p: FloatArray,
    memory: FloatArray,
    s: Sample,
    begins: bool,
    dt_s: float,
    gap: bool,
) -> Predicted:
    """Over the interval that ends now: the state with the tables at the new SOC, then P."""
    status = 0
    counts = 0.0 if gap or s.lost_A > 0.0 else 1.0  # whether what flowed is known
    # A current that is lost has no offset, either.
    load = s.seen_A - x[B] if s.lost_A == 0.0 else s.seen_A
    flow = counts * (s.flow_A - x[B])
    gs = dt_s / cell.charge_As * (1.0 if flow > 0.0 else cell.charge_efficiency)
    soc = x[SOC] - x[Q] * gs * flow - cell.leak_A * dt_s / cell.charge_As
    if not (math.isfinite(soc) and math.isfinite(p[SS])):
        adaptive_start(anew, learn, s.current_A, x, p, memory)
        begins = True
        soc = x[SOC]
        load = s.seen_A
        flow = counts * s.flow_A
        status |= STATE_RESET
    warm = s.temperature_C + memory[HEAT_K]
    point = under_load(cell, look_up(table, grid, cell, soc, warm), load)
    if begins:
        begin_branches(cell, point, load, x, p)
    a1 = math.exp(-dt_s / point.tau1_s)
    a2 = math.exp(-dt_s / point.tau2_s)
    a3 = math.exp(-dt_s / point.tau3_s) if point.r3_ohm != 0.0 else 1.0
    ah = hysteresis_decay(cell, flow, dt_s) if cell.hysteresis_rate != 0.0 else 1.0
    g1 = point.r1_ohm * (1.0 - a1)
    g2 = point.r2_ohm * (1.0 - a2)
    g3 = point.r3_ohm * (1.0 - a3)
    x[SOC] = soc
    x[V1] = a1 * x[V1] + g1 * flow
    x[V2] = a2 * x[V2] + g2 * flow
    x[V3] = a3 * x[V3] + g3 * flow
    x[H] = ah * x[H] - (1.0 - ah) * math.copysign(1.0, flow)

    spread(p, a1, a2, a3, ah, counts * x[Q] * gs, -gs * flow, counts * g1, counts * g2, counts * g3)
    if gap:
        p[SS] += noise.gap_soc * noise.gap_soc
    if s.lost_A > 0.0:
        # It may keep one sign for as long as it is away: the deviation grows, not the variance.
        drift = math.sqrt(p[SS]) + s.lost_A * dt_s / cell.charge_As
        p[SS] = drift * drift
    slope = point.ocv_slope_V
    bend = 0.0
    wide = p[SS] > WIDE_VARIANCE
    if wide:
        w = wide_slopes(table, grid, cell, soc, point, math.sqrt(p[SS]), warm, load)
        slope = w.voltage_V
        bend = w.bend_V
        lean(
            p, w.r1_ohm * (1.0 - a1) * flow, w.r2_ohm * (1.0 - a2) * flow,
            w.r3_ohm * (1.0 - a3) * flow,
        )  # fmt: skip
    q = noise.current_A * noise.current_A
    qb = q + s.gap_A2
    share = noise.branch_share * flow
    share = share * share + s.lost_A * s.lost_A
    p[SS] += q * gs * gs + noise.soc_per_sqrt_s * noise.soc_per_sqrt_s * dt_s
    p[P11] += qb * g1 * g1 + share * point.r1_ohm * point.r1_ohm * (1.0 - a1 * a1)
    p[P22] += qb * g2 * g2 + share * point.r2_ohm * point.r2_ohm * (1.0 - a2 * a2)
    p[P33] += qb * g3 * g3 + share * point.r3_ohm * point.r3_ohm * (1.0 - a3 * a3)
    p[BB] += learn.offset_walk * dt_s
    p[QQ] += learn.charge_walk * dt_s
    # Doubt of the resistances comes back, up to what it was before any data.
    if memory[FAST_VAR] < learn.resistance_variance:
        memory[FAST_VAR] += learn.resistance_walk * dt_s
    if memory[TAIL_VAR] < learn.resistance_variance:
        memory[TAIL_VAR] += learn.resistance_walk * dt_s
    return Predicted(point, load, flow, warm, slope, bend, wide, status)
