"""The adaptive filter as scalar code: SOC together with what is wrong with sensor and cell.

State x = [soc, v1, v2, v3, h, b, q]: the EKF's five, what the current sensor adds (b, [A]), and
the model's capacity over the cell's (q); beside it the factors r on R0, R1 and w on R2, R3:

    soc+ = soc - q (I - b) dt / (3600 Q)
    v_j+ = a_j v_j + R_j (1 - a_j) (I - b)
    v    = OCV(soc) - r (R0 (I - b) + v1) - w (v2 + v3) + M h

A sensor's gain and a capacity move the counted charge alike, so q stands for either.

A voltage says two things, and they are heard apart. Its slow part, weighed as in the EKF with the
number of samples that share one model error, tells of soc, b and q. Its fast part, against the
fast part of the drop, tells of the resistances by recursive least squares.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from cellwise.cell.kernels import (
    CellScalars,
    heat_step,
    look_up,
    under_load,
)
from cellwise.estimate.evidence_kernels import weigh
from cellwise.estimate.filters.adaptive_mixture_kernels import Mixture, mixture, told_deviation
from cellwise.estimate.filters.adaptive_predict_kernels import predict
from cellwise.estimate.filters.adaptive_state_kernels import (
    FAST,
    FAST_VAR,
    HEAT_K,
    LASTING,
    MISMATCH,
    P11,
    P22,
    P33,
    PHH,
    REJECTIONS,
    SOC,
    SS,
    TAIL,
    TAIL_VAR,
    V1,
    V2,
    V3,
    AdaptiveScalars,
    H,
    begin_anew,
    correct,
    flatten,
    keep_watch,
    observe,
    settled_variance,
    shift,
    watch_of,
)
from cellwise.estimate.filters.adaptive_watch_kernels import use_rest, watch_resistance
from cellwise.estimate.filters.ekf_kernels import (
    SMALL_MOVE,
    WIDE_VARIANCE,
)
from cellwise.estimate.filters.filter_state import EkfStart
from cellwise.estimate.measurement_kernels import (
    flat_slope,
    lasting_step,
    voltage_variance,
    wide_slopes,
)
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.recovery_kernels import recovered
from cellwise.estimate.sensing_kernels import (
    NO_VOLTAGE_YET,
    NOT_BEGUN,
    Sample,
    read_sample,
)
from cellwise.estimate.status import (
    CLAMPED,
    CURRENT_INVALID,
    VOLTAGE_FROZEN,
)
from cellwise.typing import BoolArray, FloatArray, IntArray

# Columns of the per-sample output: the EKF's, then value and deviation of each parameter.
OUT_SOC, OUT_STD, OUT_VOLTAGE, OUT_INNOVATION, OUT_VARIANCE, OUT_RATIO = range(6)
OUT_OFFSET, OUT_FAST, OUT_TAIL, OUT_CHARGE = range(6, 10)
OUT_OFFSET_STD, OUT_FAST_STD, OUT_TAIL_STD, OUT_CHARGE_STD = range(10, 14)
OUT_OFFSET_FREE, OUT_CHARGE_FREE = range(14, 16)
OUTPUTS = 16

# Why a parameter is held; the same values as in adaptive_settings.Held.
NOT_CHOSEN = 1
SOC_UNSURE = 2
NO_EXCITATION = 4
MODEL_MISFIT = 8
NO_VOLTAGE = 16
NO_CURRENT = 32


class AdaptiveStep(NamedTuple):
    """What may be looked at after a step; ``held_*`` are reasons, 0 where it is learnt."""

    voltage_V: float
    innovation_V: float
    innovation_variance_V2: float
    test_ratio: float
    status: int
    held_offset: int
    held_resistance: int
    held_charge: int


@njit(cache=True, error_model="numpy", inline="always")
def without_offset(s: Sample, load_A: float) -> Sample:
    """The sample with the current that the voltage has seen, less the sensor's offset."""
    # fmt: off
    return Sample(
        s.current_A, load_A, s.flow_A, s.gap_A2, s.lost_A, s.voltage_V, s.temperature_C,
        s.no_current_s, s.status,
    )
    # fmt: on


@njit(cache=True, error_model="numpy", inline="always")
def take_step(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    noise: NoiseScalars,
    learn: AdaptiveScalars,
    anew: EkfStart,
    x: FloatArray,
    p: FloatArray,
    memory: FloatArray,
    d: FloatArray,
    c: FloatArray,
    current_A: float,
    voltage_V: float,
    temperature_C: float,
    dt_s: float,
    gap: bool,
) -> AdaptiveStep:
    """One step: predict over the interval that ends now, then use the voltage read now."""
    needs_temperature = table.shape[0] > 1 or cell.activation_K != 0.0
    past = watch_of(memory)
    s = read_sample(
        cell, noise, past, anew.temperature_C, needs_temperature,
        current_A, voltage_V, temperature_C, dt_s, gap,
    )  # fmt: skip
    begins = past.evidence_s == NOT_BEGUN
    point, load, flow, warm, slope, bend, wide, more = predict(
        table, grid, cell, noise, learn, anew, x, p, memory, s, begins, dt_s, gap
    )
    status = s.status | more
    evidence = NO_VOLTAGE_YET if begins or more else past.evidence_s
    blind = gap or status & CURRENT_INVALID != 0
    use_rest(learn, x, p, memory, d, s.current_A, dt_s, blind)

    # Innovation and its variance.
    fast, behind = memory[FAST], memory[TAIL]
    drop = point.r0_ohm * load + x[V1]
    tail = x[V2] + x[V3]
    polarisation = fast * drop + behind * tail
    if cell.heating_K_per_W != 0.0:
        memory[HEAT_K] = heat_step(cell, memory[HEAT_K], flow, polarisation, dt_s)
    predicted = (point.ocv_V + point.m_V * x[H]) - polarisation
    by_offset = point.r0_ohm if s.lost_A == 0.0 else 0.0
    state_variance = observe(p, d, slope, point.m_V, fast, behind, by_offset)
    state_variance += 3.0 * bend * bend
    branches = abs(x[V1]) + (abs(x[V2]) + abs(x[V3]))
    r0 = fast * point.r0_ohm
    one = voltage_variance(noise, point.error_V, point.ocv_slope_V, r0, load, branches)
    one += drop * drop * memory[FAST_VAR] + tail * tail * memory[TAIL_VAR]
    one += s.lost_A * s.lost_A * r0 * r0
    variance = state_variance + one
    seen_as = weigh(
        cell, noise, past, without_offset(s, load), evidence, memory[REJECTIONS], memory[MISMATCH],
        s.voltage_V - predicted, state_variance, one, point.r0_ohm, branches, dt_s,
        p[SS] > WIDE_VARIANCE, 3.0 * bend * bend > one or slope < flat_slope(table),
    )  # fmt: skip
    status |= seen_as.status
    innovation = seen_as.innovation_V
    used = math.isfinite(innovation) and status & VOLTAGE_FROZEN == 0
    memory[REJECTIONS] = seen_as.rejections
    memory[MISMATCH] = seen_as.mismatch
    keep_watch(memory, seen_as.watch)

    # What the data cannot tell now is held.
    why = NO_CURRENT if status & CURRENT_INVALID else 0
    if not used:
        why |= NO_VOLTAGE
    if settled_variance(p) > learn.settled_variance:
        why |= SOC_UNSURE
    held_resistance = why | (0 if learn.learn_resistance else NOT_CHOSEN)
    if used and not gap:
        white = noise.voltage_V * noise.voltage_V
        if not watch_resistance(
            learn, memory, drop, tail, innovation, white, dt_s, held_resistance != 0
        ):
            held_resistance |= NO_EXCITATION
    if seen_as.mismatch > learn.misfit:
        why |= MODEL_MISFIT
    held_offset = why | (0 if learn.learn_offset else NOT_CHOSEN)
    held_charge = why | (0 if learn.learn_charge else NOT_CHOSEN)

    if seen_as.recover:
        # The gate may have locked the truth out: the SOC is looked for anew, with the voltage that
        # a cell with the model's own resistances would have shown.
        memory[LASTING] = 0.0
        x[SOC], ss, p11, p22, p33 = recovered(
            table, grid, cell, warm, load, s.voltage_V + (polarisation - (drop + tail)),
            (x[V1], x[V2], x[V3]), (p[P11], p[P22], p[P33]), x[H], p[PHH], one,
            abs(point.r0_ohm * load) + branches, evidence >= 0.0, x[SOC], p[SS],
        )  # fmt: skip
        begin_anew(p, ss, p11, p22, p33)
    elif seen_as.accepted:
        inverse = seen_as.inverse
        learnt = True
        if wide:
            # The gain is that of the slope here; what it is worth is said by the slope where it
            # leads, if that is flatter.
            flat = min(slope, point.ocv_slope_V)
            wander = math.sqrt(p[SS])
            move = d[SOC] * inverse * innovation
            if abs(move) > SMALL_MOVE * wander:
                there = x[SOC] + move
                landed = under_load(cell, look_up(table, grid, cell, there, warm), load)
                w = wide_slopes(table, grid, cell, there, landed, wander, warm, load)
                flat = min(min(w.voltage_V, landed.ocv_slope_V), slope)
            learnt = flatten(p, d, c, inverse, flat - slope)
        memory[LASTING] = lasting_step(
            noise, point.error_V, point.ocv_slope_V, seen_as.mismatch, d[SOC] * inverse, slope,
            memory[LASTING],
        )  # fmt: skip
        if learnt:
            correct(x, p, d, inverse, innovation, held_offset != 0, held_charge != 0)
        else:
            shift(x, d, inverse, innovation, held_offset != 0, held_charge != 0)
    if x[SOC] < 0.0 or x[SOC] > 1.0:
        x[SOC] = min(max(x[SOC], 0.0), 1.0)
        status |= CLAMPED
    return AdaptiveStep(
        predicted,
        innovation,
        variance,
        seen_as.ratio,
        status,
        held_offset,
        held_resistance,
        held_charge,
    )


@njit(cache=True, error_model="numpy")
def adaptive_step(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    noise: NoiseScalars,
    learn: AdaptiveScalars,
    anew: EkfStart,
    x: FloatArray,
    p: FloatArray,
    memory: FloatArray,
    d: FloatArray,
    c: FloatArray,
    current_A: float,
    voltage_V: float,
    temperature_C: float,
    dt_s: float,
    gap: bool,
) -> tuple[AdaptiveStep, Mixture]:
    """One step for online use; x, p and memory are moved on, d and c are room to work in."""
    info = take_step(
        table, grid, cell, noise, learn, anew, x, p, memory, d, c,
        current_A, voltage_V, temperature_C, dt_s, gap,
    )  # fmt: skip
    return info, mixture(learn, x, p, memory)


@njit(cache=True, error_model="numpy", nogil=True)
def adaptive_rows(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    noise: NoiseScalars,
    learn: AdaptiveScalars,
    anew: EkfStart,
    x: FloatArray,
    p: FloatArray,
    memory: FloatArray,
    d: FloatArray,
    c: FloatArray,
    current_A: FloatArray,
    voltage_V: FloatArray,
    temperature_C: FloatArray,
    dt_s: FloatArray,
    gap: BoolArray,
    out: FloatArray,
    status: IntArray,
    held: IntArray,
) -> None:
    """Every row of a log through one step each; ``out`` (OUTPUTS, rows), ``held`` (3, rows)."""
    for k in range(dt_s.size):
        info = take_step(
            table, grid, cell, noise, learn, anew, x, p, memory, d, c,
            current_A[k], voltage_V[k], temperature_C[k], dt_s[k], gap[k],
        )  # fmt: skip
        told = mixture(learn, x, p, memory)
        out[OUT_SOC, k] = min(max(told.soc, 0.0), 1.0)
        out[OUT_STD, k] = told_deviation(told, memory)
        out[OUT_VOLTAGE, k] = info.voltage_V
        out[OUT_INNOVATION, k] = info.innovation_V
        out[OUT_VARIANCE, k] = info.innovation_variance_V2
        out[OUT_RATIO, k] = info.test_ratio
        out[OUT_OFFSET, k] = told.offset_A
        out[OUT_FAST, k] = memory[FAST]
        out[OUT_TAIL, k] = memory[TAIL]
        out[OUT_CHARGE, k] = 1.0 + told.charge
        out[OUT_OFFSET_STD, k] = math.sqrt(max(told.offset_variance, 0.0))
        out[OUT_FAST_STD, k] = math.sqrt(memory[FAST_VAR])
        out[OUT_TAIL_STD, k] = math.sqrt(memory[TAIL_VAR])
        out[OUT_CHARGE_STD, k] = math.sqrt(max(told.charge_variance, 0.0))
        out[OUT_OFFSET_FREE, k] = told.offset_probability
        out[OUT_CHARGE_FREE, k] = told.charge_probability
        status[k] = info.status
        held[0, k] = info.held_offset
        held[1, k] = info.held_resistance
        held[2, k] = info.held_charge
