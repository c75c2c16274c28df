"""Over an interval: charge counted, tables looked up, branches of a new cell, covariance."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations import (
    CellState,
    CellTables,
    Transition,
    held_in_branches,
    loaded,
    slow_step,
    states_step,
    transition,
)
from cellwise.cell.packed import changed
from cellwise.cell.plausibility.validity_kernels import (
    extrapolation_V,
    is_outside,
    lost_temperature_V,
    widened,
)
from cellwise.cell.point_kernels import CellPoint
from cellwise.estimate.evidence_kernels import share_at
from cellwise.estimate.filters.covariance_kernels import (
    Covariance,
    decayed,
    driven_by_soc,
    noisy,
)
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.recovery_kernels import start_branch
from cellwise.estimate.sensing_kernels import Sample, unseen_soc
from cellwise.estimate.slopes_kernels import Slopes, slopes_at
from cellwise.estimate.status import OUTSIDE

SOC_LOW = 0.0
SOC_HIGH = 1.0


class Interval(NamedTuple):
    """An interval as a filter finds it: where it starts, what it does, the tables at its end.

    Where the cell is new to the filter, ``old`` holds what its branches may hold and ``v`` their
    variances. Beyond the model's validity the point has more slow error, and ``status`` says so.
    """

    old: CellState
    point: CellPoint
    t: Transition
    end: CellState
    warm_C: float
    v11: float
    v22: float
    v33: float
    status: int


@inline
def over_interval(
    tables: CellTables, noise: NoiseScalars, x: CellState, soc: float, s: Sample, begins: bool
) -> Interval:
    """Everything at the new SOC and the surface's new lag; heat is the start's."""
    cell = tables.cell
    warm = s.temperature_C + x.heat_K
    slow = slow_step(cell, x.slow_A, s.flow_A, s.dt_s)
    point = loaded(tables, soc, warm, s.seen_A, slow)
    old1, old2, old3 = x.v1_V, x.v2_V, x.v3_V
    v11, v22, v33 = 0.0, 0.0, 0.0
    if begins:
        old1, v11 = start_branch(cell, point.r1_ohm, s.seen_A)
        old2, v22 = start_branch(cell, point.r2_ohm, s.seen_A)
        old3, v33 = start_branch(cell, point.r3_ohm, s.seen_A)
    t = transition(cell, point, s.flow_A, s.dt_s)
    old = CellState(x.soc, old1, old2, old3, x.h, x.heat_K, x.slow_A)
    end = states_step(old, t, s.flow_A, soc, slow)
    held = abs(point.r0_ohm * s.seen_A) + held_in_branches(end)
    status = 0
    if is_outside(noise.valid, soc, s.temperature_C, s.seen_A):
        status = OUTSIDE
        more = extrapolation_V(noise.valid, s.temperature_C, s.seen_A, held)
        point = widened(point, more)
    if s.no_warm_s > 0.0:
        point = widened(point, lost_temperature_V(s.no_warm_s, held))
    return Interval(old, point, t, end, warm, v11, v22, v33, status)


@inline
def with_noise(
    p: Covariance, noise: NoiseScalars, s: Sample, now: Interval, no_voltage_s: float
) -> Covariance:
    """What an interval adds: by the current sensor, a gap, the resistances, SOC's own wandering.

    A resistance that is off by a share drives its branch like a current that is off by it, and so
    does a current that is lost; 1 - a^2 keeps the stationary spread independent of the interval. A
    constant offset of the current is a hypothesis of its own, as long as voltages judge it.
    """
    point, t = now.point, now.t
    lost = no_voltage_s > noise.hold_s
    per_sqrt_s = noise.soc_per_sqrt_s if lost else noise.wander_per_sqrt_s
    q = noise.current_A * noise.current_A
    share = share_at(noise, s.flow_A) * s.flow_A
    share = share * share + s.lost_A * s.lost_A
    return noisy(
        p,
        t,
        q,
        q + s.gap_A2,
        per_sqrt_s * per_sqrt_s * s.dt_s,
        share * point.r1_ohm * point.r1_ohm * (1.0 - t.a1 * t.a1),
        share * point.r2_ohm * point.r2_ohm * (1.0 - t.a2 * t.a2),
        share * point.r3_ohm * point.r3_ohm * (1.0 - t.a3 * t.a3),
    )


@inline
def unseen_variance(tables: CellTables, noise: NoiseScalars, s: Sample, ss: float) -> float:
    """SOC's variance after a gap: nobody knows what flowed in it."""
    if s.gap:
        unseen = unseen_soc(noise, tables.cell.charge_As, s.gap_A2, s.dt_s)
        ss += unseen * unseen
    return ss


@inline
def drifted(tables: CellTables, s: Sample, ss: float) -> float:
    """SOC's variance while the current is lost.

    It may keep one sign for as long as it is away: the deviation grows, not the variance.
    """
    if s.lost_A <= 0.0:
        return ss
    drift = math.sqrt(ss) + s.lost_A * s.dt_s / tables.cell.charge_As
    return drift * drift


@inline
def by_tangents(
    tables: CellTables,
    noise: NoiseScalars,
    s: Sample,
    now: Interval,
    p: Covariance,
    no_voltage_s: float,
) -> tuple[CellState, Covariance, Slopes]:
    """Mean, covariance and slopes at the end, by first derivatives (EKF)."""
    t, end, point = now.t, now.end, now.point
    ss = drifted(tables, s, unseen_variance(tables, noise, s, p.ss))
    p = changed(decayed(p, t), "ss", ss)
    at = slopes_at(tables, end.soc, ss, point, now.warm_C, s.seen_A, end.slow_A)
    if at.spread > 0.0:
        # A SOC that is off drives each branch by the slope of its resistance.
        p = driven_by_soc(
            p,
            at.r1_ohm * (1.0 - t.a1) * s.flow_A,
            at.r2_ohm * (1.0 - t.a2) * s.flow_A,
            at.r3_ohm * (1.0 - t.a3) * s.flow_A,
        )
    return end, with_noise(p, noise, s, now, no_voltage_s), at
