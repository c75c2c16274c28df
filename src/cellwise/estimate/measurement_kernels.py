"""What a voltage is worth: slopes while the SOC is badly known, its variance, unknown branches."""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from cellwise.cell.kernels import OCV, CellPoint, CellScalars, look_up, under_load
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import REST_RATE
from cellwise.typing import FloatArray

SHORTEST_CHORD = 1e-6
# A cell that starts at rest still carries a few millivolts of its past in each branch, and what a
# tenth of a rate would leave there.
RESTART_POINTS = 201
FLAT_SHARE = 0.25
START_BRANCH_V = 0.005
START_REST_RATE = 0.1
REST_LIMIT_V = 0.03  # a rested branch holds no more, whatever its resistance
LOAD_LIMIT_V = 0.3
# One that starts under load holds anything from nothing to the load's steady voltage.
START_LOAD_SHARE = 0.5
START_LOAD_RATE = 0.25


@njit(cache=True, error_model="numpy", inline="always")
def start_branch(cell: CellScalars, r_ohm: float, current_A: float) -> tuple[float, float]:
    """What a branch holds when nobody knows what was before: mean [V] and variance [V^2]."""
    capacity = cell.charge_As / 3600.0
    if r_ohm <= 0.0:
        return 0.0, 0.0
    if abs(current_A) < REST_RATE * capacity:
        past = min(START_REST_RATE * capacity * r_ohm, REST_LIMIT_V)
        return 0.0, START_BRANCH_V * START_BRANCH_V + past * past
    spread = max(START_LOAD_SHARE * abs(current_A), START_LOAD_RATE * capacity) * r_ohm
    return (
        START_LOAD_SHARE * current_A * r_ohm,
        START_BRANCH_V * START_BRANCH_V + spread * spread,
    )


@njit(cache=True, error_model="numpy", inline="always")
def chord(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    soc: float,
    ocv_V: float,
    spread: float,
    temperature_C: float,
) -> tuple[float, float]:
    """OCV slope over one standard deviation of SOC on either side, and how far the OCV bends [V].

    A far-off start must not be corrected with the slope of the spot where it happens to stand, nor
    be thought of as right afterwards when the OCV is no straight line. The bend is the distance
    from the OCV here to the chord, inside 0..1; for a small spread the slope is the tangent's.
    """
    low = min(max(soc - spread, 0.0), 1.0)
    high = min(max(soc + spread, 0.0), 1.0)
    a = look_up(table, grid, cell, low, temperature_C)
    if high - low < SHORTEST_CHORD:  # both beyond the same end
        return a.ocv_slope_V, 0.0
    b = look_up(table, grid, cell, high, temperature_C)
    slope = (b.ocv_V - a.ocv_V) / (high - low)
    return slope, a.ocv_V + slope * (soc - low) - ocv_V


class WideSlopes(NamedTuple):
    """Slopes over SOC while it is badly known: of the voltage, its bend, of the branches."""

    voltage_V: float
    bend_V: float
    r1_ohm: float
    r2_ohm: float
    r3_ohm: float


@njit(cache=True, error_model="numpy")
def wide_slopes(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    soc: float,
    point: CellPoint,
    spread: float,
    temperature_C: float,
    current_A: float,
) -> WideSlopes:
    """Chords over one standard deviation of SOC on either side; see :func:`chord`.

    A SOC that is far off brings the resistances of another SOC with it: R0's slope joins the
    OCV's, those of the branches drive the branch voltages.
    """
    low = min(max(soc - spread, 0.0), 1.0)
    high = min(max(soc + spread, 0.0), 1.0)
    if high - low < SHORTEST_CHORD:  # both beyond the same end
        return WideSlopes(point.ocv_slope_V, 0.0, 0.0, 0.0, 0.0)
    a = under_load(cell, look_up(table, grid, cell, low, temperature_C), current_A)
    b = under_load(cell, look_up(table, grid, cell, high, temperature_C), current_A)
    per = 1.0 / (high - low)
    ocv = (b.ocv_V - a.ocv_V) * per
    return WideSlopes(
        ocv - (b.r0_ohm - a.r0_ohm) * per * current_A,
        a.ocv_V + ocv * (soc - low) - point.ocv_V,
        (b.r1_ohm - a.r1_ohm) * per,
        (b.r2_ohm - a.r2_ohm) * per,
        (b.r3_ohm - a.r3_ohm) * per,
    )


@njit(cache=True, error_model="numpy", inline="always")
def voltage_variance(
    noise: NoiseScalars,
    error_V: float,
    slope_V: float,
    r0_ohm: float,
    current_A: float,
    branches_V: float = 0.0,
) -> float:
    """Variance of one measured voltage about a perfect state [V^2].

    Sensor, the model's slow error at this SOC, a SOC scale that is off by ``ocv_soc`` (it matters
    where the OCV is steep), and resistances that are off by ``branch_share``: of the ohmic drop and
    of what the branches hold.
    """
    scale = noise.ocv_soc * slope_V
    drop = noise.branch_share * (abs(r0_ohm * current_A) + branches_V)
    jitter = noise.current_A * r0_ohm
    slow = noise.error_scale * error_V
    fixed = noise.voltage_V * noise.voltage_V + slow * slow
    return fixed + (scale * scale + (drop * drop + jitter * jitter))


@njit(cache=True, error_model="numpy", inline="always")
def lasting_step(
    noise: NoiseScalars,
    error_V: float,
    ocv_slope_V: float,
    mismatch: float,
    gain: float,
    slope_V: float,
    lasting: float,
) -> float:
    """What an error that stays has brought into the SOC, after an update with a gain of the SOC.

    No further voltage averages such an error out: with every voltage the SOC goes where the
    error leads, error over slope in the end. Beside P, which takes each memory of the error for
    new, it makes up the variance that is told (consider covariance; Schmidt 1966, p. 293).
    """
    slow = noise.error_scale * error_V
    scale = noise.ocv_soc * ocv_slope_V
    error = noise.lasting * math.sqrt((slow * slow + scale * scale) * max(mismatch, 1.0))
    return lasting + gain * (error - slope_V * lasting)


@njit(cache=True, error_model="numpy", inline="always")
def flat_slope(table: FloatArray) -> float:
    """OCV slope below which the OCV is flat for its kind: a quarter of its mean slope [V]."""
    return FLAT_SHARE * float(table[0, table.shape[1] - 1, OCV] - table[0, 0, OCV])


@njit(cache=True, error_model="numpy")
def soc_of_voltage(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    temperature_C: float,
    current_A: float,
    voltage_V: float,
    branches_V: float,
    h: float,
    h_variance: float,
    variance: float,
    held_A: float,
    limit_V: float,
    soc: float,
    soc_variance: float,
) -> tuple[float, float]:
    """SOC and its variance when a voltage contradicts the estimate: over the whole of 0..1.

    Every SOC weighs as the estimate, widened to ``soc_variance``, and the voltage, of ``variance``
    about the model's, say together; ``held_A`` is the current whose voltage the branches of that
    SOC may still hold, up to ``limit_V``. Beyond either end of the OCV that end is meant. On a
    plateau every SOC of it is as good: the variance is its width.
    """
    step = 1.0 / (RESTART_POINTS - 1)
    ends = look_up(table, grid, cell, 0.0, temperature_C)
    low = ends.ocv_V - ends.r0_ohm * current_A - branches_V + ends.m_V * h
    ends = look_up(table, grid, cell, 1.0, temperature_C)
    high = ends.ocv_V - ends.r0_ohm * current_A - branches_V + ends.m_V * h
    target = min(max(voltage_V, min(low, high)), max(low, high))
    least = math.inf
    total = 0.0
    first = 0.0
    second = 0.0
    for turn in range(2):
        for k in range(RESTART_POINTS):
            s = k * step
            point = under_load(cell, look_up(table, grid, cell, s, temperature_C), current_A)
            seen = point.ocv_V - point.r0_ohm * current_A - branches_V + point.m_V * h
            about = variance + point.error_V * point.error_V
            about += point.m_V * point.m_V * h_variance
            r = point.r1_ohm * point.r1_ohm + point.r2_ohm * point.r2_ohm
            past = held_A * held_A * (r + point.r3_ohm * point.r3_ohm)
            about += min(past, limit_V * limit_V)
            off = target - seen
            away = s - soc
            cost = away * away / soc_variance + off * off / about + math.log(about)
            if turn == 0:
                least = min(least, cost)
            else:
                weight = math.exp(-0.5 * (cost - least))
                total += weight
                first += weight * s
                second += weight * s * s
    mean = first / total
    return mean, max(second / total - mean * mean, 0.0) + step * step / 12.0
