"""How much a voltage weighs: its variance, the memory of the model's error, gate, what stays."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations.scalar import at_most
from cellwise.cell.point_kernels import CellPoint, CellScalars
from cellwise.estimate.equations.constants import (
    CONTRADICTED_S,
    COUNT_ROUNDING,
    REST_RATE,
)
from cellwise.estimate.equations.evidence import (
    Shared,
    contradicted_step,
    error_variance,
    inverse_weight,
    lately_shown,
    persistent_V,
    shared_evidence,
    stated_variance,
    voltage_variance,
)
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import (
    CheckedReading,
    SensorMonitor,
    watch_on,
    watch_voltage,
)
from cellwise.estimate.status import (
    GATE_RECOVERY,
    INNOVATION_REJECTED,
    VOLTAGE_FROZEN,
    VOLTAGE_INVALID,
)


@inline
def share_variance(noise: NoiseScalars, current_A: float) -> float:
    """By what share the resistances may be wrong under a current, squared."""
    share = noise.branch_share if current_A >= 0.0 else noise.charge_share
    return share * share


@inline
def slow_variance(noise: NoiseScalars, fixed_V2: float, point: CellPoint) -> float:
    """Of one voltage, by what is fixed and the model's error at this SOC [V^2]."""
    slow = noise.error_scale * point.error_V
    ocv_soc2 = noise.ocv_soc * noise.ocv_soc
    return error_variance(fixed_V2, slow, ocv_soc2, point.ocv_slope_V)


@inline
def variance_about(
    noise: NoiseScalars,
    point: CellPoint,
    r0_ohm: float,
    seen_A: float,
    lost_A: float,
    branches_V: float,
) -> float:
    """Variance of one measured voltage about a perfect state [V^2]."""
    error_V2 = slow_variance(noise, noise.voltage_V * noise.voltage_V, point)
    held_V = abs(r0_ohm * seen_A) + branches_V
    current_A2 = noise.current_A * noise.current_A + lost_A * lost_A
    return voltage_variance(error_V2, share_variance(noise, seen_A), held_V, current_A2, r0_ohm)


@inline
def repeated_evidence(noise: NoiseScalars, evidence_s: float, dt_s: float, resting: bool) -> Shared:
    """How many samples share one model error ``evidence_s`` after the first one."""
    alone = noise.slow_s <= 0.0 or (evidence_s < 0.0 and resting)
    since_s, period_s = max(evidence_s, 0.0), dt_s
    if alone:  # the first row of a log has no interval
        period_s = 1.0
    shared_s = 2.0 * noise.slow_s
    # A sample shares its error with itself at least: where intervals are long that rules.
    one_s2 = (since_s + noise.half_s) * dt_s - shared_s * since_s
    early_s2 = max(shared_s * noise.early_s, one_s2)
    return shared_evidence(shared_s, early_s2, noise.half_s, since_s, period_s, alone)


@inline
def mismatch_step(
    noise: NoiseScalars, mismatch: float, square: float, variance: float, dt_s: float
) -> float:
    """The mismatch after an innovation, times its variance.

    The division by it is left to the caller, who does not wait for it.
    """
    if noise.mismatch_cap <= 0.0 or noise.slow_s <= 0.0:
        return mismatch * variance
    lately = min(dt_s * noise.per_slow_s, 1.0)
    counted = at_most(square, noise.mismatch_cap * variance)  # one counts for so much at most
    return lately_shown(mismatch * variance, counted, lately)


@inline
def lasting_V(noise: NoiseScalars, point: CellPoint, mismatch: float) -> float:
    """Persistent model error, one deviation [V]."""
    return persistent_V(noise.persistent, slow_variance(noise, 0.0, point), mismatch)


@inline
def contradicted_after(
    noise: NoiseScalars,
    contradicted: float,
    innovation_V: float,
    slope_V: float,
    one: float,
    since_s: float,
    dt_s: float,
) -> float:
    """SOC that the voltages say is missing, were the current off by ``offset_share``."""
    drift = noise.offset_soc_per_s * max(since_s, 0.0)
    lately = min(dt_s * (1.0 / CONTRADICTED_S), 1.0)
    return contradicted_step(contradicted, innovation_V, slope_V, one, drift, lately)


@inline
def stated_deviation(
    soc_variance: float, mismatch: float, persistent: float, contradicted: float
) -> float:
    """Standard deviation of the SOC: P's, a persistent error's, and what voltages contradict."""
    return math.sqrt(stated_variance(soc_variance, mismatch, persistent, contradicted))


class InnovationSources(NamedTuple):
    """Measured minus predicted voltage, and what it may be due to.

    ``state_variance`` is what the state's uncertainty explains of it, ``one`` the variance of a
    single voltage, ``free_variance`` what an offset or a capacity that is not known explains;
    ``branches_V`` what the branches hold in absolute value. One deviation of the offset moves the
    voltage by ``of_offset_V``, all that is believed has moved it by ``followed_V``.
    """

    predicted_V: float
    innovation_V: float
    state_variance: float
    one: float
    free_variance: float
    r0_ohm: float
    branches_V: float
    of_offset_V: float
    followed_V: float


class GateResult(NamedTuple):
    """What becomes of a voltage.

    ``inverse`` is one over the variance that weighs it; a rejected one only moves the counts.
    """

    accepted: bool
    used: bool
    inverse: float
    innovation_V: float
    variance: float
    ratio: float
    rejections: float
    mismatch: float
    watch: SensorMonitor
    status: int


@inline
def gate(
    cell: CellScalars,
    noise: NoiseScalars,
    watch: SensorMonitor,
    s: CheckedReading,
    evidence_s: float,
    rejections: float,
    mismatch: float,
    i: InnovationSources,
) -> GateResult:
    """Gate, count, and weigh one innovation."""
    status = 0
    innovation_V = i.innovation_V
    variance = i.state_variance + (i.one + i.free_variance)
    square = innovation_V * innovation_V
    ratio = square / variance * noise.per_gate2
    own = i.state_variance + i.one
    last, swings, frozen = watch_voltage(noise, watch, s, innovation_V, i.r0_ohm)
    status |= frozen
    used = False
    accepted = False
    inverse = 0.0
    resting = abs(s.seen_A) * 3600.0 < REST_RATE * cell.charge_As
    if not math.isfinite(innovation_V):
        status |= VOLTAGE_INVALID
        innovation_V = math.nan
        ratio = math.nan
    elif status & VOLTAGE_FROZEN == 0:
        used = True
        off = mismatch_step(noise, mismatch, square, own, s.dt_s)
        mismatch = off / own
        if ratio > 1.0:
            status |= INNOVATION_REJECTED
            # Ten samples a second repeat one error: each counts for its time, at most for one.
            rejections += min(s.dt_s, 1.0)
            if rejections >= noise.recovery_after - COUNT_ROUNDING:
                status |= GATE_RECOVERY
                rejections = 0.0
                mismatch = 1.0
                evidence_s = 0.0
        else:
            accepted = True
            rejections = 0.0
            # Both times the innovation's variance: of the mismatch without its division.
            shared = repeated_evidence(noise, evidence_s, s.dt_s, resting)
            weight = i.one * max(off, own) * shared.above
            inverse = inverse_weight(i.state_variance, weight, own * shared.below)
            evidence_s = max(evidence_s, 0.0)
    if evidence_s >= 0.0:
        evidence_s += s.dt_s
    after, away = watch_on(noise, s, used, evidence_s, watch.no_voltage_s, last, swings)
    status |= away
    # fmt: off
    return GateResult(
        accepted, used, inverse, innovation_V, variance, ratio, rejections,
        mismatch, after, status,
    )
    # fmt: on
