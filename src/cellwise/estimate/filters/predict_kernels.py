"""The start of every filter's step: charge counted, tables looked up, branches of a new cell."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations import (
    CellState,
    CellTables,
    Transition,
    loaded,
    slow_step,
    soc_step,
    states_step,
    transition,
)
from cellwise.cell.point_kernels import CellPoint
from cellwise.estimate.evidence_kernels import share_at
from cellwise.estimate.filters.covariance_kernels import Covariance, uncorrelated
from cellwise.estimate.filters.drift_kernels import Drift, counted_on
from cellwise.estimate.filters.filter_state import EkfStart, EkfState, ekf_start
from cellwise.estimate.filters.past_kernels import Past, past_at_start
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.recovery_kernels import start_branch
from cellwise.estimate.sensing_kernels import NO_VOLTAGE_YET, NOT_BEGUN, Sample, unseen_soc
from cellwise.estimate.slopes_kernels import Slopes
from cellwise.estimate.status import OUTSIDE, STATE_RESET
from cellwise.estimate.validity_kernels import (
    extrapolation_V,
    is_outside,
    lost_temperature_V,
    widened,
)

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


class Begun(NamedTuple):
    """The state that a step goes on from: what was carried, or a new start."""

    state: EkfState
    now: Interval
    p: Covariance
    evidence_s: float
    past: Past
    drift: Drift
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
    branches_V = abs(end.v1_V) + (abs(end.v2_V) + abs(end.v3_V))
    status = 0
    if is_outside(noise.valid, soc, s.temperature_C, s.seen_A):
        status = OUTSIDE
        held = abs(point.r0_ohm * s.seen_A) + branches_V
        more = extrapolation_V(noise.valid, s.temperature_C, s.seen_A, held)
        point = widened(point, more)
    if s.no_warm_s > 0.0:
        held = abs(point.r0_ohm * s.seen_A) + branches_V
        point = widened(point, lost_temperature_V(s.no_warm_s, held))
    return Interval(old, point, t, end, warm, v11, v22, v33, status)


@inline
def begin_interval(
    tables: CellTables, noise: NoiseScalars, start: EkfStart, state: EkfState, s: Sample
) -> Begun:
    """Charge first; a state that is no longer finite starts again."""
    status = 0
    soc = soc_step(tables.cell, state.cell.soc, s.flow_A, s.dt_s)
    if not (math.isfinite(soc) and math.isfinite(state.p.ss)):
        state = ekf_start(start, s.current_A)
        soc = state.cell.soc
        status = STATE_RESET
    p = state.p
    evidence = state.watch.evidence_s
    past = state.past
    now = over_interval(tables, noise, state.cell, soc, s, evidence == NOT_BEGUN)
    status |= now.status
    if evidence == NOT_BEGUN:
        p = uncorrelated(p.ss, now.v11, now.v22, now.v33, p.phh)
        evidence = NO_VOLTAGE_YET
        past = past_at_start(tables.cell, s, now.end.soc, p.ss)
    counted_s = 0.0 if s.gap or s.lost_A > 0.0 else s.dt_s
    drift = counted_on(noise, state.drift, now.t, tables.cell.charge_As, counted_s, s.current_A)
    return Begun(state, now, p, evidence, past, drift, status)


@inline
def branch_variance(noise: NoiseScalars, s: Sample, r_ohm: float, a: float) -> float:
    """What a branch gains over an interval because its resistance, or a current, is uncertain.

    A resistance that is off by a share drives its branch like a current that is off by it, and so
    does a current that is lost; 1 - a^2 keeps the stationary spread independent of the interval.
    """
    share = share_at(noise, s.flow_A) * s.flow_A
    share = share * share + s.lost_A * s.lost_A
    return share * r_ohm * r_ohm * (1.0 - a * a)


@inline
def unseen_variance(tables: CellTables, noise: NoiseScalars, s: Sample, ss: float) -> float:
    """SOC's variance after a gap: nobody knows what flowed in it."""
    if s.gap:
        unseen = unseen_soc(noise, tables.cell.charge_As, s.gap_A2, s.dt_s)
        ss += unseen * unseen
    return ss


@inline
def driven_by_soc(at: Slopes, t: Transition, flow_A: float) -> tuple[float, float, float]:
    """What a SOC that is off adds to each branch, by the slope of its resistance [V]."""
    return (
        at.r1_ohm * (1.0 - t.a1) * flow_A,
        at.r2_ohm * (1.0 - t.a2) * flow_A,
        at.r3_ohm * (1.0 - t.a3) * flow_A,
    )


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
def soc_walk(noise: NoiseScalars, dt_s: float) -> float:
    """Variance that SOC gains over an interval."""
    return noise.soc_per_sqrt_s * noise.soc_per_sqrt_s * dt_s


@inline
def soc_wander(noise: NoiseScalars, no_voltage_s: float, dt_s: float) -> float:
    """The same where a constant offset is a hypothesis of its own, as long as voltages judge it."""
    lost = no_voltage_s > noise.hold_s
    per_sqrt_s = noise.soc_per_sqrt_s if lost else noise.wander_per_sqrt_s
    return per_sqrt_s * per_sqrt_s * dt_s
