"""The EKF's step over many cells at once, side by side in vector registers.

State lies in blocks of LANES cells, field by field, so that one loop over the lanes compiles to
vector instructions. A cell whose step is plain (SOC well known, readings sound, voltage within the
gate) takes the short way: the same sentences as in ``ekf_kernels``, with what depends on the time
step tabulated over SOC. Every other cell takes the EKF's own step.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from cellwise.cell.kernels import R3, CellScalars, M
from cellwise.estimate.filters.ekf_kernels import (
    FORGIVEN,
    SOC_HIGH,
    SOC_LOW,
    VARIANCE_FLOOR,
)
from cellwise.estimate.filters.filter_state import EkfStart
from cellwise.estimate.lockstep.cell_kernels import full_lane
from cellwise.estimate.lockstep.layout import (
    CURRENT,
    EVIDENCE,
    FIELDS,
    FROZEN_A,
    LANES,
    LASTING,
    LONG_FROZEN,
    MISMATCH,
    O_INNOVATION,
    O_RATIO,
    O_SOC,
    O_STD,
    O_VARIANCE,
    O_VOLTAGE,
    OUTPUTS,
    P1H,
    P2H,
    P3H,
    P11,
    P12,
    P13,
    P22,
    P23,
    P33,
    PHH,
    REJECTIONS,
    REPEATS,
    S1,
    S2,
    S3,
    SH,
    SOC,
    SS,
    T_A1,
    T_A2,
    T_A3,
    T_B1,
    T_B2,
    T_B3,
    T_ERROR,
    T_G1,
    T_G2,
    T_G3,
    T_M,
    T_OCV,
    T_R0,
    TABLE_COLUMNS,
    V1,
    V2,
    V3,
    VOLTAGE,
    W_DECAY,
    W_FLOW,
    W_PLAIN,
    W_SLOPE,
    W_SOC,
    WARM,
    H,
)
from cellwise.estimate.lockstep.lookup_kernels import (
    look_up_lane,
    look_up_warm_lane,
    read_block,
    scale_lane,
)
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import (
    COLDEST_C,
    FROZEN_READINGS,
    HOTTEST_C,
    MEMORY_GROWTH,
    MEMORY_START_S,
)
from cellwise.estimate.status import CLAMPED
from cellwise.typing import BoolArray, FloatArray, IntArray


@njit(cache=True, error_model="numpy", inline="always")
def plain_block(
    cell: CellScalars,
    noise: NoiseScalars,
    block: FloatArray,
    work: FloatArray,
    current_A: FloatArray,
    voltage_V: FloatArray,
    temperature_C: FloatArray,
    dt_s: float,
    out: FloatArray,
) -> None:
    """The EKF's step for the plain lanes of a block; the others keep their state."""
    per_gate = 1.0 / (noise.gate * noise.gate)
    per_dt = 2.0 / dt_s
    q = noise.current_A * noise.current_A
    gs = -dt_s / cell.charge_As
    walk = noise.soc_per_sqrt_s * noise.soc_per_sqrt_s * dt_s
    lately = 0.0
    if noise.mismatch_cap > 0.0 and noise.slow_s > 0.0:
        lately = min(dt_s / noise.slow_s, 1.0)
    for lane in range(LANES):
        flow = work[W_FLOW * LANES + lane]
        voltage = voltage_V[lane]
        soc = work[W_SOC * LANES + lane]
        slope = work[W_SLOPE * LANES + lane]
        ah = work[W_DECAY * LANES + lane]
        r0 = work[T_R0 * LANES + lane]
        a1 = work[T_A1 * LANES + lane]
        a2 = work[T_A2 * LANES + lane]
        a3 = work[T_A3 * LANES + lane]
        g1 = work[T_G1 * LANES + lane]
        g2 = work[T_G2 * LANES + lane]
        g3 = work[T_G3 * LANES + lane]
        m = work[T_M * LANES + lane]
        v1 = a1 * block[V1 * LANES + lane] + g1 * flow
        v2 = a2 * block[V2 * LANES + lane] + g2 * flow
        v3 = a3 * block[V3 * LANES + lane] + g3 * flow
        h = ah * block[H * LANES + lane] - (1.0 - ah) * (1.0 if flow >= 0.0 else -1.0)

        share = noise.branch_share * flow
        share = share * share
        ss = block[SS * LANES + lane] + (q * gs * gs + walk)
        s1 = a1 * block[S1 * LANES + lane] + q * gs * g1
        s2 = a2 * block[S2 * LANES + lane] + q * gs * g2
        s3 = a3 * block[S3 * LANES + lane] + q * gs * g3
        sh = ah * block[SH * LANES + lane]
        p11 = a1 * a1 * block[P11 * LANES + lane] + share * work[T_B1 * LANES + lane]
        p12 = a1 * a2 * block[P12 * LANES + lane] + q * g1 * g2
        p13 = a1 * a3 * block[P13 * LANES + lane] + q * g1 * g3
        p1h = a1 * ah * block[P1H * LANES + lane]
        p22 = a2 * a2 * block[P22 * LANES + lane] + share * work[T_B2 * LANES + lane]
        p23 = a2 * a3 * block[P23 * LANES + lane] + q * g2 * g3
        p2h = a2 * ah * block[P2H * LANES + lane]
        p33 = a3 * a3 * block[P33 * LANES + lane] + share * work[T_B3 * LANES + lane]
        p3h = a3 * ah * block[P3H * LANES + lane]
        phh = ah * ah * block[PHH * LANES + lane]
        p11 += q * g1 * g1
        p22 += q * g2 * g2
        p33 += q * g3 * g3

        drop = (r0 * flow + v1) + (v2 + v3)
        predicted = (work[T_OCV * LANES + lane] + m * h) - drop
        ds = (slope * ss + m * sh) - ((s1 + s2) + s3)
        d1 = (slope * s1 + m * p1h) - ((p11 + p12) + p13)
        d2 = (slope * s2 + m * p2h) - ((p12 + p22) + p23)
        d3 = (slope * s3 + m * p3h) - ((p13 + p23) + p33)
        dh = (slope * sh + m * phh) - ((p1h + p2h) + p3h)
        state_variance = (slope * ds + m * dh) - ((d1 + d2) + d3)
        branches = abs(v1) + (abs(v2) + abs(v3))
        along = noise.ocv_soc * slope
        ohmic = noise.branch_share * (abs(r0 * flow) + branches)
        jitter = noise.current_A * r0
        error = noise.error_scale * work[T_ERROR * LANES + lane]
        one = noise.voltage_V * noise.voltage_V + error * error
        one = one + (along * along + (ohmic * ohmic + jitter * jitter))
        variance = state_variance + one
        innovation = voltage - predicted
        square = innovation * innovation
        beyond = square / variance
        ratio = beyond * per_gate

        # The sensors' past: is the voltage frozen?
        same = voltage == block[VOLTAGE * LANES + lane]
        old = block[REPEATS * LANES + lane]
        repeats = old + 1.0 if same else 0.0
        frozen_A = block[FROZEN_A * LANES + lane] if same else flow
        moved = abs(r0 * (flow - frozen_A))
        frozen = (repeats >= FROZEN_READINGS) & (
            (old > LONG_FROZEN) | ((moved > noise.frozen_V) & (abs(innovation) > 0.5 * moved))
        )
        plain = (work[W_PLAIN * LANES + lane] > 0.0) & (ratio <= 1.0) & (not frozen)
        work[W_PLAIN * LANES + lane] = 1.0 if plain else 0.0

        mismatch = block[MISMATCH * LANES + lane]
        beyond = beyond if beyond < noise.mismatch_cap else noise.mismatch_cap
        mismatch = mismatch + lately * (beyond - mismatch)
        evidence = block[EVIDENCE * LANES + lane]
        memory = MEMORY_START_S + MEMORY_GROWTH * evidence
        memory = memory if memory < noise.slow_s else noise.slow_s
        shared = memory * per_dt
        shared = shared if shared > 1.0 else 1.0
        worse = mismatch if mismatch > 1.0 else 1.0
        inverse = 1.0 / (state_variance + one * shared * worse)
        ks = ds * inverse
        stays = noise.lasting * math.sqrt((error * error + along * along) * worse)
        lasting = block[LASTING * LANES + lane]
        lasting = lasting + ks * (stays - slope * lasting)
        k1 = d1 * inverse
        k2 = d2 * inverse
        k3 = d3 * inverse
        kh = dh * inverse
        soc += ks * innovation
        h += kh * innovation
        h = h if h < 1.0 else 1.0
        h = h if h > -1.0 else -1.0
        soc = soc if soc < SOC_HIGH else SOC_HIGH
        soc = soc if soc > SOC_LOW else SOC_LOW
        ss -= ks * ds
        p11 -= k1 * d1
        p22 -= k2 * d2
        p33 -= k3 * d3
        phh -= kh * dh
        rejections = block[REJECTIONS * LANES + lane] - FORGIVEN
        block[SOC * LANES + lane] = soc if plain else block[SOC * LANES + lane]
        block[V1 * LANES + lane] = (v1 + k1 * innovation) if plain else block[V1 * LANES + lane]
        block[V2 * LANES + lane] = (v2 + k2 * innovation) if plain else block[V2 * LANES + lane]
        block[V3 * LANES + lane] = (v3 + k3 * innovation) if plain else block[V3 * LANES + lane]
        block[H * LANES + lane] = h if plain else block[H * LANES + lane]
        ss = ss if ss > VARIANCE_FLOOR else VARIANCE_FLOOR
        block[SS * LANES + lane] = ss if plain else block[SS * LANES + lane]
        block[S1 * LANES + lane] = (s1 - ks * d1) if plain else block[S1 * LANES + lane]
        block[S2 * LANES + lane] = (s2 - ks * d2) if plain else block[S2 * LANES + lane]
        block[S3 * LANES + lane] = (s3 - ks * d3) if plain else block[S3 * LANES + lane]
        block[SH * LANES + lane] = (sh - ks * dh) if plain else block[SH * LANES + lane]
        p11 = p11 if p11 > 0.0 else 0.0
        block[P11 * LANES + lane] = p11 if plain else block[P11 * LANES + lane]
        block[P12 * LANES + lane] = (p12 - k1 * d2) if plain else block[P12 * LANES + lane]
        block[P13 * LANES + lane] = (p13 - k1 * d3) if plain else block[P13 * LANES + lane]
        block[P1H * LANES + lane] = (p1h - k1 * dh) if plain else block[P1H * LANES + lane]
        p22 = p22 if p22 > 0.0 else 0.0
        block[P22 * LANES + lane] = p22 if plain else block[P22 * LANES + lane]
        block[P23 * LANES + lane] = (p23 - k2 * d3) if plain else block[P23 * LANES + lane]
        block[P2H * LANES + lane] = (p2h - k2 * dh) if plain else block[P2H * LANES + lane]
        p33 = p33 if p33 > 0.0 else 0.0
        block[P33 * LANES + lane] = p33 if plain else block[P33 * LANES + lane]
        block[P3H * LANES + lane] = (p3h - k3 * dh) if plain else block[P3H * LANES + lane]
        phh = phh if phh > 0.0 else 0.0
        block[PHH * LANES + lane] = phh if plain else block[PHH * LANES + lane]
        rejections = rejections if rejections > 0.0 else 0.0
        block[REJECTIONS * LANES + lane] = rejections if plain else block[REJECTIONS * LANES + lane]
        block[MISMATCH * LANES + lane] = mismatch if plain else block[MISMATCH * LANES + lane]
        block[LASTING * LANES + lane] = lasting if plain else block[LASTING * LANES + lane]
        block[EVIDENCE * LANES + lane] = (
            (evidence + dt_s) if plain else block[EVIDENCE * LANES + lane]
        )
        block[VOLTAGE * LANES + lane] = voltage if plain else block[VOLTAGE * LANES + lane]
        block[FROZEN_A * LANES + lane] = frozen_A if plain else block[FROZEN_A * LANES + lane]
        block[REPEATS * LANES + lane] = repeats if plain else block[REPEATS * LANES + lane]
        block[CURRENT * LANES + lane] = current_A[lane] if plain else block[CURRENT * LANES + lane]
        warm = temperature_C[lane]
        sound = plain & (warm >= COLDEST_C) & (warm <= HOTTEST_C)
        block[WARM * LANES + lane] = warm if sound else block[WARM * LANES + lane]
        out[O_SOC * LANES + lane] = soc
        out[O_STD * LANES + lane] = math.sqrt(ss + lasting * lasting)
        out[O_VOLTAGE * LANES + lane] = predicted
        out[O_INNOVATION * LANES + lane] = innovation
        out[O_VARIANCE * LANES + lane] = variance
        out[O_RATIO * LANES + lane] = ratio


@njit(cache=True, error_model="numpy", nogil=True)
def lockstep(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    fast: FloatArray,
    noise: NoiseScalars,
    anew: EkfStart,
    state: FloatArray,
    work: FloatArray,
    told: FloatArray,
    current_A: FloatArray,
    voltage_V: FloatArray,
    temperature_C: FloatArray,
    gap: BoolArray,
    cells: int,
    dt_s: float,
    out: FloatArray,
    status: IntArray,
) -> int:
    """One sample of every cell; how many took the short way.

    ``state`` is in blocks of LANES cells with FIELDS rows each; the other arrays have one value
    per cell, a multiple of LANES of them, ``out`` OUTPUTS times as many. ``work`` and ``told`` are
    scratch; the first ``cells`` are real.
    """
    needs_temperature = table.shape[0] > 1 or cell.activation_K != 0.0
    scaled = cell.activation_K != 0.0 or cell.rate_per_A != 0.0 or cell.charge_scale != 1.0
    blocks = gap.size // LANES
    lanes = gap.size
    whole = bool(np.any(table[..., R3])) or bool(np.any(table[..., M]))
    some_gap = bool(np.any(gap))
    points = fast.size // (TABLE_COLUMNS * table.shape[0])
    short = 0
    for number in range(blocks):
        # Slices: offsets into them are known to be positive, without which nothing is vectorised.
        block = state[number * FIELDS * LANES : (number + 1) * FIELDS * LANES]
        first = number * LANES
        current = current_A[first : first + LANES]
        voltage = voltage_V[first : first + LANES]
        warm = temperature_C[first : first + LANES]
        read_block(
            cell, noise, points, block, work, current, voltage, warm, dt_s, needs_temperature
        )
        if table.shape[0] > 1:
            for lane in range(LANES):
                look_up_warm_lane(fast, grid, points, work, lane, warm[lane])
        else:
            for lane in range(LANES):
                look_up_lane(fast, 0, points - 1.0, work, lane, whole)
        if scaled:
            for lane in range(LANES):
                scale_lane(cell, block, work, lane, warm[lane])
        if cell.heating_K_per_W != 0.0:
            work[W_PLAIN * LANES : (W_PLAIN + 1) * LANES] = 0.0
        if some_gap:
            for lane in range(LANES):
                if gap[first + lane]:
                    work[W_PLAIN * LANES + lane] = 0.0
        plain_block(cell, noise, block, work, current, voltage, warm, dt_s, told)
        bits = status[first : first + LANES]
        plain = 0
        for lane in range(LANES):
            soc = told[O_SOC * LANES + lane]
            bits[lane] = CLAMPED if (soc <= SOC_LOW) | (soc >= SOC_HIGH) else 0
            plain += 1 if work[W_PLAIN * LANES + lane] > 0.0 else 0
        short += plain
        if plain < LANES:
            for lane in range(LANES):
                if not work[W_PLAIN * LANES + lane] > 0.0:
                    # fmt: off
                    bits[lane] = full_lane(
                        table, grid, cell, noise, anew, block, lane, current[lane], voltage[lane],
                        warm[lane], dt_s, gap[first + lane], told,
                    )
                    # fmt: on
        for row in range(OUTPUTS):
            shown = out[row * lanes + first : row * lanes + first + LANES]
            for lane in range(LANES):
                shown[lane] = told[row * LANES + lane]
    for lane in range(cells - (blocks - 1) * LANES, LANES):  # nobody's
        short -= 1 if work[W_PLAIN * LANES + lane] > 0.0 else 0
    return short
