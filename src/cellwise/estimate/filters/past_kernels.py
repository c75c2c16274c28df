"""A start under load, looked at again: what flowed before it is taken to be like what flows after.

A filter that begins under load knows neither the SOC nor what a slow branch holds, and in the cold
both move the voltage alike. A branch's voltage follows from the resistance at the true SOC, which
no tangent at a wrong start knows. So the first minutes are looked at again, at a few times, each
four times as long after the start as the one before: every SOC of 0..1 is weighed by the start
that was stated, counted on, and by the level of the voltage, with the resistances of that SOC and
branches that a load like the one seen since would have left. The covariance between SOC and slow
branch comes with it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline, part
from cellwise.cell.description import BRANCHES, CELL, V3
from cellwise.cell.equations import CellState, CellTables, loaded, rc_step
from cellwise.cell.packed import changed
from cellwise.cell.plausibility.validity_kernels import extrapolation_V
from cellwise.cell.point_kernels import CellScalars
from cellwise.cell.unrolled import unrolled
from cellwise.estimate.evidence_kernels import share_at
from cellwise.estimate.filters.covariance_kernels import (
    Branches,
    Column,
    Covariance,
    moved,
    scaled,
    uncorrelated,
)
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.recovery_kernels import RESTART_POINTS, START_BRANCH_V
from cellwise.estimate.sensing_kernels import REST_RATE, Sample
from cellwise.estimate.slopes_kernels import WIDE_VARIANCE

FIRST_LOOK_S = 15.0  # by then the fast branches follow the load
LOOK_FACTOR = 4.0
LOOKS = 3
RECONSIDERED = 1  # times after the looks, each four times as long after the start, too
LEVEL_SHARE = 0.3  # of the time since the start: the mean of the innovations is as young
# A log that begins under load was cut out of a use like it. May be its beginning: nothing is in
# the branch then, two deviations away.
PAST_SPREAD = 0.5
PAST_RATE = 0.05  # may have flowed before beside it
TAIL = 4.0  # degrees of freedom of a stated start: how sure it is, is itself not sure
LEAST_RATE = 0.02  # a use takes no longer from full to empty, or back
RESISTANCE_OF_SOC = 0.3  # of what resistances differ between two SOCs may be the tables' error


class Past(NamedTuple):
    """What is carried while a start under load is looked at again.

    ``mean_A`` is the mean current since the start, ``looked_A`` what it was at the last look,
    ``miss_V`` the mean innovation of late, ``first_soc`` the stated start counted on, known to
    ``first_variance``: negative when nothing is to be looked at (any more).
    """

    mean_A: float
    looked_A: float
    miss_V: float
    first_soc: float
    first_variance: float


@inline
def no_past() -> Past:
    """Nothing to look at."""
    return Past(0.0, 0.0, 0.0, 0.0, -1.0)


@inline
def past_at_start(cell: CellScalars, s: Sample, soc: float, soc_variance: float) -> Past:
    """Looked at again is a start under load that is unsure of itself."""
    loaded_start = abs(s.seen_A) * 3600.0 >= REST_RATE * cell.charge_As
    if loaded_start and soc_variance > WIDE_VARIANCE:
        return Past(s.seen_A, 0.0, 0.0, soc, soc_variance)
    return no_past()


@inline
def past_step(
    cell: CellScalars, past: Past, s: Sample, since_s: float, used: bool, innovation_V: float
) -> Past:
    """Means and count over one interval, ``since_s`` after the first voltage.

    A gap, or a current that is lost, leaves nothing to go by.
    """
    if past.first_variance <= 0.0 or since_s <= 0.0 or s.dt_s <= 0.0:
        return past
    if s.gap or s.lost_A > 0.0:
        return no_past()
    mean = past.mean_A + (s.flow_A - past.mean_A) * min(s.dt_s / since_s, 1.0)
    miss = past.miss_V
    if used:
        miss += (innovation_V - miss) * min(s.dt_s / (LEVEL_SHARE * since_s), 1.0)
    counted = past.first_soc - s.flow_A * s.dt_s / cell.charge_As
    return Past(mean, past.looked_A, miss, counted, past.first_variance)


@inline
def time_passed(before_s: float, since_s: float, first: int, times: int) -> bool:
    """Whether one of the times falls into the interval that ends ``since_s`` after the start."""
    at = FIRST_LOOK_S * LOOK_FACTOR**first
    for _ in range(times):
        if before_s < at <= since_s:
            return True
        at *= LOOK_FACTOR
    return False


@inline
def looked_for_long(since_s: float) -> bool:
    """Whether nothing more is to come."""
    return since_s >= FIRST_LOOK_S * LOOK_FACTOR ** (LOOKS + RECONSIDERED - 1)


@inline
def having_looked(past: Past, since_s: float) -> Past:
    """After a look, or a reconsideration, at the mean current so far."""
    if looked_for_long(since_s):
        return no_past()
    return changed(past, "looked_A", past.mean_A)


@inline
def branch_of_past(
    cell: CellScalars, r_ohm: float, left: float, mean_A: float, before_V: float
) -> tuple[float, float]:
    """What a branch holds when ``left`` of the past's ``before_V`` is left: mean, variance."""
    held = r_ohm * (1.0 - left) * mean_A + left * before_V
    spread = left * (PAST_SPREAD * abs(before_V) + r_ohm * PAST_RATE * cell.charge_As / 3600.0)
    return held, spread * spread


@inline
def usual_size_A(cell: CellScalars, mean_A: float) -> float:
    """The past's charge fits on the SOC axis: a discharge from full, a charge from empty."""
    return max(abs(mean_A), LEAST_RATE * cell.charge_As / 3600.0)


@inline
def left_by_load(
    tables: CellTables, mean_A: float, soc: float, temperature_C: float, slow_A: float
) -> float:
    """What a load from full, or a charge from empty, has left in the slow branch at a SOC [V]."""
    step = 1.0 / (RESTART_POINTS - 1)
    size = usual_size_A(tables.cell, mean_A)
    flowed_A = size if mean_A >= 0.0 else -size
    step_s = step * tables.cell.charge_As / size
    before = 0.0
    points = int((1.0 - soc if mean_A >= 0.0 else soc) / step + 0.5)
    for k in range(1, points + 1):
        s = 1.0 - k * step if mean_A >= 0.0 else k * step
        at = loaded(tables, s, temperature_C, mean_A, slow_A)
        before = rc_step(before, flowed_A, at.r3_ohm, at.tau3_s, step_s)
    return before


@part
def reconsidered(
    tables: CellTables, past: Past, temperature_C: float, x: CellState, since_s: float
) -> tuple[float, float]:
    """How far the rest of the past is from what the last look took it for, and its variance.

    Minutes of a load that changes say little of its mean: with a longer one, a past like it has
    left another voltage in a branch of hours.
    """
    soc = x.soc + past.mean_A * since_s / tables.cell.charge_As
    soc = min(max(soc, 0.0), 1.0)
    at = loaded(tables, soc, temperature_C, past.mean_A, x.slow_A)
    if at.r3_ohm <= 0.0:
        return 0.0, 0.0
    taken = left_by_load(tables, past.looked_A, soc, temperature_C, x.slow_A)
    held = left_by_load(tables, past.mean_A, soc, temperature_C, x.slow_A)
    left = math.exp(-since_s / at.tau3_s)
    _, variance = branch_of_past(tables.cell, at.r3_ohm, left, 0.0, taken)
    return left * (held - taken), variance


@part
def soc_of_level(
    tables: CellTables,
    noise: NoiseScalars,
    past: Past,
    temperature_C: float,
    x: CellState,
    since_s: float,
    h_variance: float = 0.0,
) -> tuple[float, float, float, float, float]:
    """SOC and slow branch, their variances and covariance, by start and level together.

    The level is what OCV, hysteresis and slow branch are together, by the estimate and its mean
    innovation; on which branch of the hysteresis a past has left the cell is known to
    ``h_variance``.
    """
    mean_A = past.mean_A
    step = 1.0 / (RESTART_POINTS - 1)
    here = loaded(tables, x.soc, temperature_C, mean_A, x.slow_A)
    fast = ((here.r0_ohm + here.r1_ohm) + here.r2_ohm) * mean_A
    level = (here.ocv_V + here.m_V * x.h - x.v3_V) - fast + past.miss_V
    share = share_at(noise, mean_A)
    least = math.inf
    total, soc1, soc2, v1, v2, cross = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    size = usual_size_A(tables.cell, mean_A)
    usual_A = size if mean_A >= 0.0 else -size
    per_start = 1.0 / (TAIL * past.first_variance)
    step_s = step * tables.cell.charge_As / size
    for turn in range(2):
        before = 0.0
        for k in range(RESTART_POINTS):
            s = 1.0 - k * step if mean_A >= 0.0 else k * step
            at = loaded(tables, s, temperature_C, mean_A, x.slow_A)
            drop = ((at.r0_ohm + at.r1_ohm) + at.r2_ohm) * mean_A
            held, spread2 = 0.0, 0.0
            if at.r3_ohm > 0.0:
                if k > 0:
                    before = rc_step(before, usual_A, at.r3_ohm, at.tau3_s, step_s)
                left = math.exp(-since_s / at.tau3_s)
                held, spread2 = branch_of_past(tables.cell, at.r3_ohm, left, mean_A, before)
            slow = noise.error_scale * at.error_V
            wrong = share * drop
            other = RESISTANCE_OF_SOC * (drop - fast)
            beyond = extrapolation_V(noise.valid, temperature_C, mean_A, abs(drop) + abs(held))
            about = (slow * slow + beyond * beyond) + (wrong * wrong + other * other)
            about += START_BRANCH_V * START_BRANCH_V + at.m_V * at.m_V * h_variance
            off = ((at.ocv_V + at.m_V * x.h - drop) - level) - held
            variance = about + spread2
            away = s - past.first_soc
            far = math.log(1.0 + away * away * per_start)
            cost = (TAIL + 1.0) * far + off * off / variance + math.log(variance)
            if turn == 0:
                least = min(least, cost)
            else:
                weight = math.exp(-0.5 * (cost - least))
                branch = held + off * (spread2 / variance)
                total += weight
                soc1 += weight * s
                soc2 += weight * (s * s)
                v1 += weight * branch
                v2 += weight * (branch * branch + about * (spread2 / variance))
                cross += weight * (s * branch)
    per = 1.0 / total
    soc, v3 = soc1 * per, v1 * per
    soc_variance = max(soc2 * per - soc * soc, 0.0) + step * step / 12.0
    v3_variance = max(v2 * per - v3 * v3, 0.0)
    return soc, soc_variance, v3, v3_variance, cross * per - soc * v3


class Looked(NamedTuple):
    """State and covariance after a look, or as they were; ``searched``: SOC and P are its own."""

    x: CellState
    p: Covariance
    past: Past
    searched: bool


@inline
@unrolled
def look_again(
    tables: CellTables,
    noise: NoiseScalars,
    s: Sample,
    warm_C: float,
    before_s: float,
    since_s: float,
    past: Past,
    used: bool,
    innovation_V: float,
    x: CellState,
    p: Covariance,
) -> Looked:
    """What becomes of a start under load over an interval, from ``before_s`` to ``since_s`` of it.

    The fast branches are what the voltage says of them; ``used``: it had one.
    """
    past = past_step(tables.cell, past, s, since_s, used, innovation_V)
    if past.first_variance > 0.0 and time_passed(before_s, since_s, 0, LOOKS):
        soc, ss, v3, p33, s3 = soc_of_level(tables, noise, past, warm_C, x, since_s, p.phh)
        x = changed(changed(x, "soc", soc), "v3_V", v3)
        v = Branches(*(p33 if i == V3 else p[i, i] for i in BRANCHES))
        p = changed(uncorrelated(ss, v, p.phh), "s3", s3)
        return Looked(x, p, having_looked(past, since_s), True)
    if past.first_variance > 0.0 and time_passed(before_s, since_s, LOOKS, RECONSIDERED):
        more_V, variance = reconsidered(tables, past, warm_C, x, since_s)
        if variance > 0.0:
            k = Column(*(p[i, V3] for i in CELL))
            x = moved(x, scaled(k, 1.0 / max(variance, p.p33)), more_V)
        past = having_looked(past, since_s)
    return Looked(x, p, past, False)
