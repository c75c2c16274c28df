"""What a filter does when nobody knows what was before: a start, or a gate that was locked out."""

from __future__ import annotations

import math

from cellwise.cell.compiled import inline, kernel
from cellwise.cell.equations import CellTables, loaded, look_up
from cellwise.cell.point_kernels import CellScalars
from cellwise.estimate.sensing_kernels import REST_RATE

RECOVERY_VARIANCE = 0.09
RECOVERY_RATE = 0.3
# A cell that starts at rest still carries a few millivolts of its past in each branch, and what a
# tenth of a rate would leave there.
RESTART_POINTS = 201
START_BRANCH_V = 0.005
START_REST_RATE = 0.1
REST_LIMIT_V = 0.03  # a rested branch holds no more, whatever its resistance
LOAD_LIMIT_V = 0.3
# One that starts under load holds anything from nothing to the load's steady voltage.
START_LOAD_SHARE = 0.5
START_LOAD_RATE = 0.25


@inline
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


@kernel
def soc_of_voltage(
    tables: CellTables,
    temperature_C: float,
    current_A: float,
    slow_A: float,
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
    ends = look_up(tables, 0.0, temperature_C, slow_A)
    low = ends.ocv_V - ends.r0_ohm * current_A - branches_V + ends.m_V * h
    ends = look_up(tables, 1.0, temperature_C, slow_A)
    high = ends.ocv_V - ends.r0_ohm * current_A - branches_V + ends.m_V * h
    target = min(max(voltage_V, min(low, high)), max(low, high))
    least = math.inf
    total = 0.0
    first = 0.0
    second = 0.0
    for turn in range(2):
        for k in range(RESTART_POINTS):
            s = k * step
            point = loaded(tables, s, temperature_C, current_A, slow_A)
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


@kernel
def recovered(
    tables: CellTables,
    temperature_C: float,
    current_A: float,
    slow_A: float,
    voltage_V: float,
    branches_V: tuple[float, float, float],
    variances: tuple[float, float, float],
    h: float,
    h_variance: float,
    one: float,
    drop_V: float,
    followed: bool,
    soc: float,
    soc_variance: float,
) -> tuple[float, float, float, float, float]:
    """SOC, its variance and those of the three branches after a lock-out.

    ``one`` is the variance of one voltage about a perfect state, ``drop_V`` the size of the whole
    polarisation. Branches that have been ``followed`` may hold anything.
    """
    v1, v2, v3 = branches_V
    p11, p22, p33 = variances
    held_A = START_REST_RATE * tables.cell.charge_As / 3600.0
    limit_V = REST_LIMIT_V
    branch = START_BRANCH_V * START_BRANCH_V
    if followed:
        held_A = RECOVERY_RATE * tables.cell.charge_As / 3600.0
        limit_V = LOAD_LIMIT_V
        # Under load the resistances may be what is wrong, by as much as they are.
        branch = drop_V * drop_V + v1 * v1 + v2 * v2 + v3 * v3 + ((p11 + p22) + p33)
    # fmt: off
    soc, soc_variance = soc_of_voltage(
        tables, temperature_C, current_A, slow_A, voltage_V, (v1 + v2) + v3, h, h_variance,
        one + branch, held_A, limit_V, soc, max(soc_variance, RECOVERY_VARIANCE),
    )
    # fmt: on
    new = look_up(tables, soc, temperature_C, slow_A)
    branch = START_BRANCH_V * START_BRANCH_V
    p11 = branch + min(held_A * new.r1_ohm, limit_V) ** 2
    p22 = branch + min(held_A * new.r2_ohm, limit_V) ** 2
    p33 = branch + min(held_A * new.r3_ohm, limit_V) ** 2
    if followed:
        p11 += v1 * v1
        p22 += v2 * v2
        p33 += v3 * v3
    if new.r3_ohm == 0.0:
        p33 = 0.0
    return soc, soc_variance, p11, p22, p33
