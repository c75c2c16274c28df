"""How much a voltage weighs: its variance, the memory of the model's error, what stays of it."""

from __future__ import annotations

import math

from cellwise.cell.compiled import inline
from cellwise.cell.point_kernels import CellPoint
from cellwise.estimate.noise import NoiseScalars

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
def model_memory(noise: NoiseScalars, evidence_s: float) -> float:
    """For how long the model's error is remembered, ``evidence_s`` after the first voltage [s].

    The error is a sum of processes with memories of a second to half an hour. The quick ones
    average out first, so the rest of a mean has an ever longer memory.
    """
    after_s = max(evidence_s, 0.0)
    return noise.slow_s * (after_s + noise.early_s) / (after_s + noise.half_s)


@inline
def repeated_evidence(noise: NoiseScalars, evidence_s: float, dt_s: float, resting: bool) -> float:
    """How many samples share one model error: the factor on a voltage's variance.

    An error of memory tau counts once in 2 tau (its spectral density at rest). A repeated stamp
    repeats the error.
    """
    if noise.slow_s <= 0.0:
        return 1.0
    if evidence_s < 0.0 and resting:
        return 1.0  # the first voltage at rest is evidence by itself
    if dt_s <= 0.0:
        return math.inf
    return max(2.0 * model_memory(noise, evidence_s) / dt_s, 1.0)


@inline
def mismatch_step(noise: NoiseScalars, mismatch: float, excess: float, dt_s: float) -> float:
    """Running mean over ``slow_s`` of ``excess``, the squared innovation over its variance.

    A model of another temperature, age or cell is wrong all the time: evidence weighs less by what
    the innovations have lately shown beyond their variance.
    """
    if noise.mismatch_cap <= 0.0 or noise.slow_s <= 0.0:
        return mismatch
    lately = min(dt_s * noise.per_slow_s, 1.0)
    return mismatch + lately * (min(excess, noise.mismatch_cap) - mismatch)


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
