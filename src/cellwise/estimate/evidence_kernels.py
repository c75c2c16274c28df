"""Variance of a voltage, the memory of the model's error, and the station ``gate`` of a step."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations.double import size_below
from cellwise.cell.point_kernels import CellPoint, CellScalars
from cellwise.estimate.equations.constants import (
    BANK_RATE,
    BLOCK_S,
    CONTRADICTED_S,
    COUNT_ROUNDING,
    LEAST_USE_RATE,
    LOOK_S,
    PAST_RATE,
    PERSISTENT_MOST,
    REST_RATE,
    START_BRANCH_V,
    START_LOAD_RATE,
    START_REST_RATE,
)
from cellwise.estimate.equations.evidence import (
    Shared,
    error_variance,
    shared_evidence,
    single_variance,
    stated_variance,
)
from cellwise.estimate.equations.weighing import Innovation, judge, weight_of
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import (
    CheckedReading,
    SensorMonitor,
    watch_on,
    watch_voltage,
)
from cellwise.estimate.status import VOLTAGE_FROZEN, VOLTAGE_INVALID

if TYPE_CHECKING:
    from cellwise.estimate.filters.filter_state import EkfState


@inline
def slow_variance(noise: NoiseScalars, fixed_V2: float, point: CellPoint) -> float:
    """Of one voltage, by what is fixed and the model's error at this SOC [V^2]."""
    slow = noise.error_scale * point.error_V
    ocv_soc2 = noise.ocv_soc * noise.ocv_soc
    return error_variance(fixed_V2, slow, ocv_soc2, point.ocv_slope_V)


class StepConstants(NamedTuple):
    """What a step of one length reads of cell and noise; fields as of the fixed step."""

    rest_A: float
    bank_A: float
    past_A: float
    least_use_A: float
    soc_per_A: float
    look_steps: float
    block_steps: float
    start_rest_A: float
    start_load_A: float
    branch_variance_V2: float
    hysteresis_per_A: float
    fixed_V2: float
    gate_square: float
    recovery_after: float
    mismatch_cap: float
    lately: float
    shared: float
    shared_early: float
    shared_half: float
    fades: float
    stays: float
    persistent: float
    drift_soc: float
    contradicted_share: float
    share_variance: float
    charge_variance: float
    current_variance_A2: float
    voltage_low_V: float
    voltage_high_V: float


def constants_of(
    charge_As: float, hysteresis_rate: float, noise: NoiseScalars, dt_s: float, unit_s: float
) -> StepConstants:
    """The constants of a step of ``dt_s``, time in units of ``unit_s``: seconds, or steps."""
    rate_A = charge_As * (1.0 / 3600.0)
    adapts = noise.mismatch_cap > 0.0 and noise.slow_s > 0.0
    shared_s = max(2.0 * noise.slow_s, max(dt_s, 1e-9))
    stays = min(noise.persistent * noise.persistent, PERSISTENT_MOST) if noise.slow_s > 0.0 else 0.0
    return StepConstants(
        REST_RATE * rate_A,
        BANK_RATE * rate_A,
        PAST_RATE * rate_A,
        LEAST_USE_RATE * rate_A,
        unit_s / charge_As,
        LOOK_S / unit_s,
        BLOCK_S / unit_s,
        START_REST_RATE * rate_A,
        START_LOAD_RATE * rate_A,
        START_BRANCH_V * START_BRANCH_V,
        hysteresis_rate * (unit_s / charge_As),
        noise.voltage_V * noise.voltage_V,
        noise.gate * noise.gate,
        noise.recovery_after - COUNT_ROUNDING,
        noise.mismatch_cap,
        unit_s * noise.per_slow_s if adapts else 0.0,
        shared_s / unit_s,
        shared_s * noise.early_s / (unit_s * unit_s),
        noise.half_s / unit_s,
        (1.0 - stays) * (shared_s / unit_s),
        stays,
        noise.persistent,
        noise.offset_soc_per_s * unit_s,
        min(dt_s * (1.0 / CONTRADICTED_S), 1.0),
        noise.branch_share * noise.branch_share,
        noise.charge_share * noise.charge_share,
        noise.current_A * noise.current_A,
        noise.voltage_low_V,
        noise.voltage_high_V,
    )


in_seconds = inline(constants_of)


@inline
def step_constants(cell: CellScalars, noise: NoiseScalars, dt_s: float) -> StepConstants:
    """The constants of one step of a filter."""
    return in_seconds(cell.charge_As, cell.hysteresis_rate, noise, dt_s, 1.0)


@inline
def variance_about(
    c: StepConstants,
    noise: NoiseScalars,
    point: CellPoint,
    delayed_current_A: float,
    lost_A: float,
    branches_V: float,
) -> float:
    """Variance of one measured voltage about a perfect state [V^2]."""
    error_V2 = slow_variance(noise, noise.voltage_V * noise.voltage_V, point)
    held_V = abs(point.r0_ohm * delayed_current_A) + branches_V
    return single_variance(c, error_V2, delayed_current_A, held_V, lost_A * lost_A, point.r0_ohm)


@inline
def repeated_evidence(
    c: StepConstants, noise: NoiseScalars, evidence_s: float, dt_s: float, delayed_current_A: float
) -> Shared:
    """How many samples share one model error ``evidence_s`` after the first one.

    A sample shares its error with itself at least: where intervals are long that rules.
    """
    alone = noise.slow_s <= 0.0 or (evidence_s < 0.0 and size_below(delayed_current_A, c.rest_A))
    # The first row of a log has no interval.
    shared = shared_evidence(c, max(evidence_s, 0.0), 1.0 if alone else dt_s, alone)
    return Shared(max(shared.above, shared.below), shared.below)


@inline
def stated_deviation(
    soc_variance: float, mismatch: float, persistent: float, contradicted: float
) -> float:
    """Standard deviation of the SOC: P's, a persistent error's, and what voltages contradict."""
    return math.sqrt(stated_variance(soc_variance, mismatch, persistent, contradicted))


class GateResult(NamedTuple):
    """What becomes of a voltage: the `Verdict` on it, and what is kept of the sensors.

    ``inverse`` is one over the variance that weighs it where it is accepted.
    """

    accepted: bool
    used: bool
    inverse: float
    innovation_V: float
    ratio: float
    rejections: float
    mismatch: float
    watch: SensorMonitor
    status: int


@inline
def gate(
    c: StepConstants,
    noise: NoiseScalars,
    old: EkfState,
    reading: CheckedReading,
    evidence_s: float,
    r0_ohm: float,
    innovation: Innovation,
) -> GateResult:
    """Gate, count, and weigh the voltage of one sample, if there is one that can be used."""
    innovation_V = reading.voltage_V - innovation.voltage_V
    ratio = innovation_V * innovation_V / innovation.variance_V2 * noise.per_gate2
    last, swings, status = watch_voltage(noise, old.watch, reading, innovation_V, r0_ohm)
    used = False
    accepted = False
    inverse, rejections, mismatch = 0.0, old.rejections, old.mismatch
    if not math.isfinite(innovation_V):
        status |= VOLTAGE_INVALID
        innovation_V = math.nan
        ratio = math.nan
    elif status & VOLTAGE_FROZEN == 0:
        used = True
        # Ten samples a second repeat one error: each counts for its time, at most for one.
        lately = min(c.lately * reading.dt_s, 1.0)
        verdict = judge(c, old, innovation, innovation_V, lately, min(reading.dt_s, 1.0))
        status |= verdict.status
        accepted, rejections, mismatch = verdict.accepted, verdict.rejections, verdict.mismatch
        if accepted:
            shared = repeated_evidence(
                c, noise, evidence_s, reading.dt_s, reading.delayed_current_A
            )
            inverse = weight_of(innovation, verdict.shown, verdict.unit, shared)
            evidence_s = max(evidence_s, 0.0)
        elif verdict.recovers:
            evidence_s = 0.0
    if evidence_s >= 0.0:
        evidence_s += reading.dt_s
    after, away = watch_on(noise, reading, used, evidence_s, old.watch.no_voltage_s, last, swings)
    status |= away
    # fmt: off
    return GateResult(
        accepted, used, inverse, innovation_V, ratio, rejections, mismatch, after, status
    )
    # fmt: on
