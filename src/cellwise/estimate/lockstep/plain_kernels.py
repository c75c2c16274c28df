"""The EKF's step over many cells at once, side by side in vector registers.

State lies in blocks of LANES cells, field by field, so that one loop over the lanes compiles to
vector instructions. A cell whose step is plain (SOC well known, readings sound, voltage within the
gate) takes the short way: the EKF's own equations, with what depends on the time step tabulated
over SOC, and without a branch. Every other cell takes the EKF's own step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import inline, rows
from cellwise.cell.equations import (
    CellState,
    CellTables,
    Transition,
    hysteresis_step,
    needs_temperature,
    polarisation,
    relaxed,
    terminal_voltage,
    with_soc,
)
from cellwise.cell.point_kernels import R3, CellPoint, CellScalars, M
from cellwise.estimate.evidence_kernels import (
    contradicted_step,
    mismatch_step,
    persistent_step,
    persistent_V,
    share_at,
    stated_deviation,
    voltage_variance,
)
from cellwise.estimate.filters.covariance_kernels import (
    column,
    corrected,
    decayed,
    explained,
    moved,
    noisy,
    scaled,
)
from cellwise.estimate.filters.drift_kernels import (
    counted_on,
    drift_step,
    drift_variance,
    dropped_by_offset,
)
from cellwise.estimate.filters.filter_state import OUT_SOC, OUTPUTS, EkfInfo, EkfStart, EkfState
from cellwise.estimate.filters.predict_kernels import SOC_HIGH, SOC_LOW
from cellwise.estimate.lockstep.block_kernels import (
    FIELDS,
    LANES,
    LONG_FROZEN,
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
    W_CURRENT,
    W_DECAY,
    W_FLOW,
    W_OUT,
    W_PLAIN,
    W_SLOPE,
    W_SOC,
    W_VOLTAGE,
    W_WARM,
    full_lane,
    get_state,
    look_up_lane,
    look_up_warm_lane,
    put_info,
    put_state,
    read_block,
    scale_lane,
    watch_validity,
)
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import (
    COLDEST_C,
    FROZEN_READINGS,
    HOTTEST_C,
    Reading,
    Watch,
)
from cellwise.estimate.status import CLAMPED
from cellwise.typing import BoolArray, FloatArray, IntArray


class LaneTables(NamedTuple):
    """The table of one time step at one lane's SOC; ``b`` are R^2 (1 - a^2)."""

    point: CellPoint
    t: Transition
    b1: float
    b2: float
    b3: float


@inline
def lane_tables(work: FloatArray, lane: int, gs: float) -> LaneTables:
    """What the look-up has left in the scratch of a block."""
    point = CellPoint(
        ocv_V=work[T_OCV * LANES + lane],
        ocv_slope_V=work[W_SLOPE * LANES + lane],
        r0_ohm=work[T_R0 * LANES + lane],
        r1_ohm=0.0,
        tau1_s=0.0,
        r2_ohm=0.0,
        tau2_s=0.0,
        r3_ohm=0.0,
        tau3_s=0.0,
        m_V=work[T_M * LANES + lane],
        error_V=work[T_ERROR * LANES + lane],
        entropy_V=0.0,
        entropy_slope_V=0.0,
    )
    t = Transition(
        work[T_A1 * LANES + lane],
        work[T_A2 * LANES + lane],
        work[T_A3 * LANES + lane],
        work[W_DECAY * LANES + lane],
        gs,
        work[T_G1 * LANES + lane],
        work[T_G2 * LANES + lane],
        work[T_G3 * LANES + lane],
    )
    b1, b2, b3 = (
        work[T_B1 * LANES + lane],
        work[T_B2 * LANES + lane],
        work[T_B3 * LANES + lane],
    )
    return LaneTables(point, t, b1, b2, b3)


@inline
def plain_step(
    noise: NoiseScalars,
    old: EkfState,
    at: LaneTables,
    soc: float,
    flow: float,
    current_A: float,
    voltage_V: float,
    warm_C: float,
    dt_s: float,
    gs: float,
    charge_As: float,
) -> tuple[EkfState, EkfInfo, bool]:
    """The EKF's step where SOC is well known; whether gate and sensors allow it."""
    x, point, t = old.cell, at.point, at.t
    v1 = relaxed(x.v1_V, t.a1, t.g1, flow)
    v2 = relaxed(x.v2_V, t.a2, t.g2, flow)
    v3 = relaxed(x.v3_V, t.a3, t.g3, flow)
    h = hysteresis_step(x.h, t.ah, flow)
    share = share_at(noise, flow) * flow
    share = share * share
    q = noise.current_A * noise.current_A
    wander = noise.wander_per_sqrt_s * noise.wander_per_sqrt_s * dt_s
    p = noisy(decayed(old.p, t), t, q, q, wander, share * at.b1, share * at.b2, share * at.b3)

    drop = polarisation(point.r0_ohm, flow, v1, v2, v3)
    slope = point.ocv_slope_V
    drift = counted_on(noise, old.drift, t, charge_As, dt_s, current_A)
    dropped = dropped_by_offset(noise, drift, point.r0_ohm, charge_As)
    of_offset = slope * drift.reach + dropped
    free_variance = of_offset * of_offset * drift.unsure
    predicted = terminal_voltage(point, h, drop) + drift.believed * dropped
    d = column(p, slope, point.m_V)
    state_variance = explained(d, slope, point.m_V)
    branches = abs(v1) + (abs(v2) + abs(v3))
    one = voltage_variance(noise, point, point.r0_ohm, flow, 0.0, branches)
    variance = state_variance + (one + free_variance)
    innovation = voltage_V - predicted
    square = innovation * innovation
    own = state_variance + one
    ratio = square / variance * noise.per_gate2

    # The sensors' past: is the voltage frozen?
    w = old.watch
    same = voltage_V == w.voltage_V
    repeats = w.repeats + 1.0 if same else 0.0
    frozen_A = w.frozen_A if same else flow
    change = abs(point.r0_ohm * (flow - frozen_A))
    frozen = (repeats >= FROZEN_READINGS) & (
        (w.repeats > LONG_FROZEN) | ((change > noise.frozen_V) & (abs(innovation) > 0.5 * change))
    )
    sound = (warm_C >= COLDEST_C) & (warm_C <= HOTTEST_C)
    watch = Watch(
        current_A,
        warm_C if sound else w.temperature_C,
        w.evidence_s + dt_s,
        w.no_current_s,  # a plain lane's is none
        w.no_voltage_s,
        voltage_V,
        frozen_A,
        repeats,
        0.0 if sound else w.no_warm_s,
    )

    off = mismatch_step(noise, old.mismatch, square, own, dt_s)
    mismatch = off / own
    # As `repeated_evidence` says, without branches.
    below = (w.evidence_s + noise.half_s) * dt_s
    above = 2.0 * noise.slow_s * (w.evidence_s + noise.early_s)
    above = above if above > below else below
    below *= own
    off = off if off > own else own
    inverse = below / (state_variance * below + one * off * above)
    k = scaled(d, inverse)
    stays_V = persistent_V(noise, point, mismatch)
    persistent = persistent_step(k.s, slope, old.persistent, stays_V)
    end = moved(CellState(soc, v1, v2, v3, h, x.heat_K, x.slow_A), k, innovation)
    followed = old.drift.believed * old.drift.reach
    followed_V = slope * followed + old.drift.believed * dropped
    drift = drift_step(drift, of_offset, innovation + followed_V, k.s, inverse)
    soc = end.soc + (k.s * followed_V + (drift.believed * drift.reach - followed))
    soc = soc if soc < SOC_HIGH else SOC_HIGH
    soc = soc if soc > SOC_LOW else SOC_LOW
    p = corrected(p, k, d)
    contradicted = contradicted_step(
        noise, old.contradicted, innovation, slope, one, w.evidence_s, dt_s
    )
    # fmt: off
    state = EkfState(
        with_soc(end, soc), p, 0.0, mismatch, persistent, contradicted, drift, watch,
        old.past,
    )
    # fmt: on
    known = p.ss + drift_variance(drift)
    std = stated_deviation(known, mismatch, persistent, contradicted)
    info = EkfInfo(soc, std, predicted, innovation, variance, ratio, 0)
    return state, info, (ratio <= 1.0) & (not frozen)


@inline
def plain_block(
    cell: CellScalars,
    noise: NoiseScalars,
    block: FloatArray,
    work: FloatArray,
    dt_s: float,
) -> None:
    """The plain lanes of a block; the others keep their state."""
    gs = -dt_s / cell.charge_As
    for lane in range(LANES):
        old = get_state(block, lane)
        new, info, fits = plain_step(
            noise,
            old,
            lane_tables(work, lane, gs),
            work[W_SOC * LANES + lane],
            work[W_FLOW * LANES + lane],
            work[W_CURRENT * LANES + lane],
            work[W_VOLTAGE * LANES + lane],
            work[W_WARM * LANES + lane],
            dt_s,
            gs,
            cell.charge_As,
        )
        plain = (work[W_PLAIN * LANES + lane] > 0.0) & fits
        work[W_PLAIN * LANES + lane] = 1.0 if plain else 0.0
        put_state(block, lane, new, plain)
        put_info(work, lane, info)


class LockstepRules(NamedTuple):
    """What stays from step to step: where a state begins, how many cells are real, the time.

    ``beyond``: the table of one time step does not hold all of the model; every cell takes the
    EKF's own step. Flat, since Python hands it over with every step, and takes longer over records
    within records.
    """

    soc: float
    variance: float
    hysteresis_variance: float
    temperature_C: float
    cells: int
    dt_s: float
    beyond: bool


@rows
def lockstep(
    tables: CellTables,
    fast: FloatArray,
    noise: NoiseScalars,
    rules: LockstepRules,
    state: FloatArray,
    work: FloatArray,
    current_A: FloatArray,
    voltage_V: FloatArray,
    temperature_C: FloatArray,
    gap: BoolArray,
    out: FloatArray,
    status: IntArray,
) -> int:
    """One sample of every cell; how many took the short way.

    ``state`` is in blocks of LANES cells with FIELDS rows each; the other arrays have one value
    per cell, a multiple of LANES of them, ``out`` OUTPUTS times as many.
    ``work`` is scratch for one block.
    """
    soc0, variance, hysteresis_variance, unknown_C, cells, dt_s, beyond = rules
    start = EkfStart(soc0, variance, hysteresis_variance, unknown_C)
    table, grid, cell = tables.table, tables.grid_C, tables.cell
    warm_tables = needs_temperature(tables)
    scaled_tables = cell.activation_K != 0.0 or cell.rate_per_A != 0.0 or cell.charge_scale != 1.0
    limited = noise.valid.share_per_K > 0.0
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
        read_block(cell, noise, points, block, work, current, voltage, warm, dt_s, warm_tables)
        if limited:
            watch_validity(noise.valid, block, work, warm)
        if table.shape[0] > 1:
            for lane in range(LANES):
                look_up_warm_lane(fast, grid, points, work, lane, warm[lane])
        else:
            for lane in range(LANES):
                look_up_lane(fast, 0, points - 1.0, work, lane, whole)
        if scaled_tables:
            for lane in range(LANES):
                scale_lane(cell, block, work, lane, warm[lane])
        if beyond:
            work[W_PLAIN * LANES : (W_PLAIN + 1) * LANES] = 0.0
        if some_gap:
            for lane in range(LANES):
                if gap[first + lane]:
                    work[W_PLAIN * LANES + lane] = 0.0
        plain_block(cell, noise, block, work, dt_s)
        bits = status[first : first + LANES]
        plain = 0
        for lane in range(LANES):
            soc = work[(W_OUT + OUT_SOC) * LANES + lane]
            bits[lane] = CLAMPED if (soc <= SOC_LOW) | (soc >= SOC_HIGH) else 0
            plain += 1 if work[W_PLAIN * LANES + lane] > 0.0 else 0
        short += plain
        if plain < LANES:
            for lane in range(LANES):
                if not work[W_PLAIN * LANES + lane] > 0.0:
                    reading = Reading(
                        current[lane], voltage[lane], warm[lane], dt_s, gap[first + lane]
                    )
                    bits[lane] = full_lane(tables, noise, start, block, lane, reading, work)
        for row in range(OUTPUTS):
            shown = out[row * lanes + first : row * lanes + first + LANES]
            for lane in range(LANES):
                shown[lane] = work[(W_OUT + row) * LANES + lane]
    for lane in range(cells - (blocks - 1) * LANES, LANES):  # nobody's
        short -= 1 if work[W_PLAIN * LANES + lane] > 0.0 else 0
    return short
