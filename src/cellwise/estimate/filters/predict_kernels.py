"""Over an interval: charge counted, tables looked up, branches of a new cell, covariance."""

from __future__ import annotations

from typing import Any, NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES
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
from cellwise.cell.point_kernels import CellPoint, CellScalars
from cellwise.cell.unrolled import ByState, unrolled
from cellwise.estimate.equations.constants import (
    LOST_RATE,
    REST_RATE,
    START_BRANCH_V,
    START_LOAD_RATE,
    START_REST_RATE,
)
from cellwise.estimate.equations.evidence import share_of, unknown_square
from cellwise.estimate.equations.sensors import drifted_variance, unseen_variance
from cellwise.estimate.equations.start import Before, held_variance, load_before
from cellwise.estimate.evidence_kernels import StepConstants
from cellwise.estimate.filters.covariance_kernels import (
    Branches,
    Covariance,
    decayed,
    driven_by_soc,
    noisy,
)
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import CheckedReading
from cellwise.estimate.slopes_kernels import VoltageSlopes, slopes_at
from cellwise.estimate.status import OUTSIDE

SOC_LOW = 0.0
SOC_HIGH = 1.0
RESTED_V2 = START_BRANCH_V * START_BRANCH_V


class PredictedInterval(NamedTuple):
    """An interval as a filter finds it: where it starts, what it does, the tables at its end.

    Where the cell is new to the filter, ``old`` holds what its branches may hold and ``unknown``
    their variances. Beyond the model's validity the point has more slow error, and ``status`` says
    so.
    """

    old: CellState
    point: CellPoint
    t: Transition
    end: CellState
    effective_temperature_C: float
    unknown: Branches
    status: int


@inline
def before_start(cell: CellScalars, delayed_current_A: float) -> Before:
    """What may have flowed in a cell before its first sample."""
    rate_A = cell.charge_As / 3600.0
    return load_before(
        delayed_current_A, REST_RATE * rate_A, START_REST_RATE * rate_A, START_LOAD_RATE * rate_A
    )


@inline
@unrolled
def over_interval(
    tables: CellTables,
    noise: NoiseScalars,
    x: ByState,
    soc: float,
    reading: CheckedReading,
    begins: bool,
) -> PredictedInterval:
    """Everything at the new SOC and the surface's new lag; heat is the start's."""
    cell = tables.cell
    effective_temperature_C = reading.temperature_C + x.heat_K
    slow = slow_step(cell, x.slow_A, reading.counted_current_A, reading.dt_s)
    point: ByState = loaded(tables, soc, effective_temperature_C, reading.delayed_current_A, slow)
    held: dict[Any, float] = {}
    unknown: dict[Any, float] = {}
    for i in BRANCHES:
        held[i], unknown[i] = x.state[i], 0.0
    if begins:
        before = before_start(cell, reading.delayed_current_A)
        for i in BRANCHES:
            held[i] = point.r[i] * before.mean_A
            unknown[i] = held_variance(RESTED_V2, point.r[i], before.spread_A, before.limit_V)
    t = transition(cell, point, reading.counted_current_A, reading.dt_s)
    old = CellState(x.soc, *(held[i] for i in BRANCHES), x.h, x.heat_K, x.slow_A)
    end = states_step(old, t, reading.counted_current_A, soc, slow)
    polarisation_V = abs(point.r0_ohm * reading.delayed_current_A) + held_in_branches(end)
    status = 0
    if is_outside(noise.valid, soc, reading.temperature_C, reading.delayed_current_A):
        status = OUTSIDE
        more = extrapolation_V(
            noise.valid, reading.temperature_C, reading.delayed_current_A, polarisation_V
        )
        point = widened(point, more)
    if reading.no_warm_s > 0.0:
        point = widened(point, lost_temperature_V(reading.no_warm_s, polarisation_V))
    variances = Branches(*(unknown[i] for i in BRANCHES))
    return PredictedInterval(old, point, t, end, effective_temperature_C, variances, status)


@inline
@unrolled
def with_noise(
    p: Covariance,
    c: StepConstants,
    noise: NoiseScalars,
    reading: CheckedReading,
    interval: PredictedInterval,
    no_voltage_s: float,
    charge_As: float,
) -> Covariance:
    """What an interval adds: by the current sensor, a gap, the resistances, SOC's own wandering.

    1 - a^2 keeps the stationary spread independent of the interval. A constant offset of the
    current is a hypothesis of its own, as long as voltages judge it.
    """
    point: ByState = interval.point
    t: ByState = interval.t
    lost = no_voltage_s > noise.hold_s
    per_sqrt_s = noise.soc_per_sqrt_s if lost else noise.wander_per_sqrt_s
    q = c.current_variance_A2
    # A capacity that is off puts every count off alike; over one discharge it adds up to as much.
    flowed = noise.capacity_soc * abs(reading.counted_current_A) * reading.dt_s / charge_As
    lost_A2 = unknown_square(
        share_of(c, reading.counted_current_A),
        reading.counted_current_A,
        reading.lost_A * reading.lost_A,
    )
    return noisy(
        p,
        t,
        q,
        q + reading.gap_A2,
        per_sqrt_s * per_sqrt_s * reading.dt_s + flowed,
        Branches(*(lost_A2 * point.r[i] * point.r[i] * (1.0 - t.a[i] * t.a[i]) for i in BRANCHES)),
    )


@inline
def gap_variance(gap_soc: float, charge_As: float, gap_A2: float, dt_s: float) -> float:
    """SOC's variance of what may have flowed unseen over a gap, at most ``gap_soc``."""
    lost_A = LOST_RATE * charge_As / 3600.0
    return unseen_variance(gap_soc * gap_soc, gap_A2, lost_A * lost_A, dt_s / charge_As)


@inline
def variance_after_gap(
    tables: CellTables, noise: NoiseScalars, reading: CheckedReading, ss: float
) -> float:
    """SOC's variance after a gap: nobody knows what flowed in it."""
    if reading.gap:
        ss += gap_variance(noise.gap_soc, tables.cell.charge_As, reading.gap_A2, reading.dt_s)
    return ss


@inline
def drifted(tables: CellTables, reading: CheckedReading, ss: float) -> float:
    """SOC's variance while the current is lost."""
    if reading.lost_A <= 0.0:
        return ss
    return drifted_variance(ss, reading.lost_A * reading.dt_s / tables.cell.charge_As)


@inline
@unrolled
def by_tangents(
    c: StepConstants,
    tables: CellTables,
    noise: NoiseScalars,
    reading: CheckedReading,
    interval: PredictedInterval,
    p: Covariance,
    no_voltage_s: float,
) -> tuple[CellState, Covariance, VoltageSlopes]:
    """Mean, covariance and slopes at the end, by first derivatives (EKF)."""
    end, point = interval.end, interval.point
    t: ByState = interval.t
    ss = drifted(tables, reading, variance_after_gap(tables, noise, reading, p.ss))
    p = changed(decayed(p, t), "ss", ss)
    slopes = slopes_at(
        tables,
        end.soc,
        ss,
        point,
        interval.effective_temperature_C,
        reading.delayed_current_A,
        end.slow_A,
    )
    if slopes.spread > 0.0:
        # A SOC that is off drives each branch by the slope of its resistance.
        drives = Branches(
            *(slopes.rise.row[i] * (1.0 - t.a[i]) * reading.counted_current_A for i in BRANCHES)
        )
        p = driven_by_soc(p, drives)
    return (
        end,
        with_noise(p, c, noise, reading, interval, no_voltage_s, tables.cell.charge_As),
        slopes,
    )
