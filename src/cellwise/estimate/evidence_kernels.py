"""How much a voltage weighs: its variance, the memory of the model's error, gate, what stays."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.point_kernels import CellPoint, CellScalars
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import (
    REST_RATE,
    Sample,
    Watch,
    watch_on,
    watch_voltage,
)
from cellwise.estimate.status import (
    GATE_RECOVERY,
    INNOVATION_REJECTED,
    VOLTAGE_FROZEN,
    VOLTAGE_INVALID,
)

CONTRADICTED_S = 600.0  # a change of load is over, a drift of the counted charge has hardly begun


@inline
def share_at(noise: NoiseScalars, current_A: float) -> float:
    """By what share the resistances may be wrong under a current: charged or discharged."""
    return noise.branch_share if current_A >= 0.0 else noise.charge_share


@inline
def voltage_variance(
    noise: NoiseScalars,
    point: CellPoint,
    r0_ohm: float,
    seen_A: float,
    lost_A: float,
    branches_V: float,
) -> float:
    """Variance of one measured voltage about a perfect state [V^2].

    Sensor, the model's slow error at this SOC, a SOC scale that is off by ``ocv_soc`` (it matters
    where the OCV is steep), resistances that are off by a share: of the ohmic drop and
    of what the branches hold; and a current that nobody measured.
    """
    scale = noise.ocv_soc * point.ocv_slope_V
    drop = share_at(noise, seen_A) * (abs(r0_ohm * seen_A) + branches_V)
    jitter = noise.current_A * r0_ohm
    slow = noise.error_scale * point.error_V
    fixed = noise.voltage_V * noise.voltage_V + slow * slow
    one = fixed + (scale * scale + (drop * drop + jitter * jitter))
    return one + lost_A * lost_A * r0_ohm * r0_ohm


@inline
def repeated_evidence(
    noise: NoiseScalars, evidence_s: float, dt_s: float, resting: bool
) -> tuple[float, float]:
    """How many samples share one model error, as a fraction, ``evidence_s`` after the first one.

    An error of memory tau counts once in 2 tau (its spectral density at rest). It is a sum of
    processes with memories of a second to half an hour: the quick ones average out first, so the
    rest of a mean has an ever longer memory. A repeated stamp repeats the error: over zero.
    """
    if noise.slow_s <= 0.0 or (evidence_s < 0.0 and resting):
        return 1.0, 1.0  # the first voltage at rest is evidence by itself
    after_s = max(evidence_s, 0.0)
    below = (after_s + noise.half_s) * dt_s
    return max(2.0 * noise.slow_s * (after_s + noise.early_s), below), below


@inline
def mismatch_step(
    noise: NoiseScalars, mismatch: float, square: float, variance: float, dt_s: float
) -> float:
    """Running mean over ``slow_s`` of the squared innovation over its variance, times that.

    A model of another temperature, age or cell is wrong all the time: evidence weighs less by what
    the innovations have lately shown beyond their variance. The division by it is left to the
    caller, who does not wait for it.
    """
    if noise.mismatch_cap <= 0.0 or noise.slow_s <= 0.0:
        return mismatch * variance
    lately = min(dt_s * noise.per_slow_s, 1.0)
    most = noise.mismatch_cap * variance
    return (1.0 - lately) * (mismatch * variance) + lately * min(square, most)


@inline
def persistent_V(noise: NoiseScalars, point: CellPoint, mismatch: float) -> float:
    """Persistent model error, one deviation [V]: at this SOC, and along its axis."""
    slow = noise.error_scale * point.error_V
    scale = noise.ocv_soc * point.ocv_slope_V
    return noise.persistent * math.sqrt((slow * slow + scale * scale) * max(mismatch, 1.0))


@inline
def persistent_step(gain: float, slope_V: float, persistent: float, error_V: float) -> float:
    """SOC error brought in by a persistent model error, after an update with a gain of the SOC.

    No further voltage averages such an error out: with every voltage the SOC goes where the
    error leads, error over slope in the end. Beside P, which takes each memory of the error for
    new, it makes up the stated variance (consider covariance; Schmidt 1966, p. 293).

    Where the SOC hangs on a branch its gain can be negative, and what the branch takes of the error
    holds the two back; it is not followed here, so nothing is amplified.
    """
    kept = min(max(1.0 - gain * slope_V, 0.0), 1.0)
    return kept * persistent + gain * error_V


@inline
def contradicted_step(
    noise: NoiseScalars,
    contradicted: float,
    innovation_V: float,
    slope_V: float,
    one: float,
    since_s: float,
    dt_s: float,
) -> float:
    """Running mean of the SOC that the voltages say is missing, as far as the count may be off.

    A known start and a small P leave a voltage little weight, and rightly so while the current is
    right: what innovations show is the model's error then. They show the same where the counted
    charge drifts. Were the current off by ``offset_share``, the count would be off by q after
    ``since_s``, and of an innovation q^2 slope^2 of q^2 slope^2 + ``one`` would be the count's.
    """
    drift = noise.offset_soc_per_s * max(since_s, 0.0)
    swing = drift * drift * slope_V
    missing = swing * innovation_V / (swing * slope_V + one)
    return contradicted + min(dt_s * (1.0 / CONTRADICTED_S), 1.0) * (missing - contradicted)


@inline
def stated_deviation(
    soc_variance: float, mismatch: float, persistent: float, contradicted: float
) -> float:
    """Standard deviation of the SOC: P's, a persistent error's, and what voltages contradict.

    P trusted the errors as stated. Where innovations show ``mismatch`` times as much, so much more
    may be wrong with the SOC (Birge 1932, doi:10.1103/PhysRev.40.207).
    """
    beside = persistent * persistent + contradicted * contradicted
    return math.sqrt(soc_variance * max(mismatch, 1.0) + beside)


COUNT_ROUNDING = 1e-6  # a sum of thousands of small counts reaches a whole number


class Innovation(NamedTuple):
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


class Verdict(NamedTuple):
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
    watch: Watch
    status: int


@inline
def gate(
    cell: CellScalars,
    noise: NoiseScalars,
    watch: Watch,
    s: Sample,
    evidence_s: float,
    rejections: float,
    mismatch: float,
    i: Innovation,
) -> Verdict:
    """Gate, count, and weigh one innovation."""
    status = 0
    innovation_V = i.innovation_V
    variance = i.state_variance + (i.one + i.free_variance)
    square = innovation_V * innovation_V
    ratio = square / variance * noise.per_gate2
    own = i.state_variance + i.one
    reading = watch_voltage(noise, watch, s, innovation_V, i.r0_ohm)
    status |= reading[4]
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
            # 1 / (state_variance + one max(mismatch, 1) above / below), with one division.
            above, below = repeated_evidence(noise, evidence_s, s.dt_s, resting)
            below *= own
            inverse = below / (i.state_variance * below + i.one * max(off, own) * above)
            evidence_s = max(evidence_s, 0.0)
    if evidence_s >= 0.0:
        evidence_s += s.dt_s
    after, away = watch_on(noise, s, used, evidence_s, watch.no_voltage_s, reading)
    status |= away
    # fmt: off
    return Verdict(
        accepted, used, inverse, innovation_V, variance, ratio, rejections,
        mismatch, after, status,
    )
    # fmt: on
