"""What a filter does when nobody knows what was before: a start, or a gate that was locked out."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from cellwise.cell.compiled import inline, part
from cellwise.cell.description import BRANCHES
from cellwise.cell.equations import CellTables, loaded, look_up
from cellwise.cell.point_kernels import CellScalars
from cellwise.cell.unrolled import ByState, unrolled
from cellwise.estimate.filters.covariance_kernels import Branches, Covariance, uncorrelated
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


class Contradiction(NamedTuple):
    """A voltage that contradicts the estimate, and the current and temperature it was seen at.

    ``variance_V2`` is that of one voltage about a perfect state, ``drop_V`` the size of the whole
    polarisation; branches that have been ``followed`` may hold anything.
    """

    voltage_V: float
    current_A: float
    temperature_C: float
    variance_V2: float
    drop_V: float
    followed: bool


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


@part
@unrolled
def soc_of_voltage(
    tables: CellTables,
    x: ByState,
    soc_variance: float,
    h_variance: float,
    c: Contradiction,
    variance: float,
    held_A: float,
    limit_V: float,
) -> tuple[float, float]:
    """SOC and its variance when a voltage contradicts the estimate: over the whole of 0..1.

    Every SOC weighs as the estimate, of ``soc_variance``, and the voltage, of ``variance`` about
    the model's, say together; ``held_A`` is the current whose voltage the branches of that
    SOC may still hold, up to ``limit_V``. Beyond either end of the OCV that end is meant. On a
    plateau every SOC of it is as good: the variance is its width.
    """
    branches_V = sum(x.state[i] for i in BRANCHES)
    step = 1.0 / (RESTART_POINTS - 1)
    ends = look_up(tables, 0.0, c.temperature_C, x.slow_A)
    low = ends.ocv_V - ends.r0_ohm * c.current_A - branches_V + ends.m_V * x.h
    ends = look_up(tables, 1.0, c.temperature_C, x.slow_A)
    high = ends.ocv_V - ends.r0_ohm * c.current_A - branches_V + ends.m_V * x.h
    target = min(max(c.voltage_V, min(low, high)), max(low, high))
    least = math.inf
    total = 0.0
    first = 0.0
    second = 0.0
    for turn in range(2):
        for k in range(RESTART_POINTS):
            s = k * step
            point: ByState = loaded(tables, s, c.temperature_C, c.current_A, x.slow_A)
            seen = point.ocv_V - point.r0_ohm * c.current_A - branches_V + point.m_V * x.h
            about = variance + point.error_V * point.error_V
            about += point.m_V * point.m_V * h_variance
            past = held_A * held_A * sum(point.r[i] * point.r[i] for i in BRANCHES)
            about += min(past, limit_V * limit_V)
            off = target - seen
            away = s - x.soc
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


@inline
@unrolled
def recovered(
    tables: CellTables, x: ByState, p: Covariance, c: Contradiction
) -> tuple[float, Covariance]:
    """SOC after a lock-out, and the variances of all states."""
    held_A = START_REST_RATE * tables.cell.charge_As / 3600.0
    limit_V = REST_LIMIT_V
    branch = START_BRANCH_V * START_BRANCH_V
    if c.followed:
        held_A = RECOVERY_RATE * tables.cell.charge_As / 3600.0
        limit_V = LOAD_LIMIT_V
        # Under load the resistances may be what is wrong, by as much as they are.
        branch = c.drop_V * c.drop_V
        for i in BRANCHES:
            branch += x.state[i] * x.state[i]
        branch += sum(p[i, i] for i in BRANCHES)
    wide, about = max(p.ss, RECOVERY_VARIANCE), c.variance_V2 + branch
    soc, variance = soc_of_voltage(tables, x, wide, p.phh, c, about, held_A, limit_V)
    new: ByState = look_up(tables, soc, c.temperature_C, x.slow_A)
    branch = START_BRANCH_V * START_BRANCH_V
    v: dict[Any, float] = {}
    for i in BRANCHES:
        v[i] = branch + min(held_A * new.r[i], limit_V) ** 2
        if c.followed:
            v[i] += x.state[i] * x.state[i]
        if new.r[i] == 0.0:
            v[i] = 0.0
    return soc, uncorrelated(variance, Branches(*(v[i] for i in BRANCHES)), p.phh)
