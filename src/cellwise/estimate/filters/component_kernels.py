"""A component of a bank in float64: its memory, its step, what the bank asks of its state.

The bank itself is :mod:`cellwise.estimate.equations.bank`, for float64 and for C.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from cellwise.cell.compiled import inline, part
from cellwise.cell.description import BRANCHES, CARRIED, carry
from cellwise.cell.equations import CellTables, loaded
from cellwise.cell.equations.scalar import at_least, clip
from cellwise.cell.packed import names_of, put_record, record_at
from cellwise.cell.plausibility.validity_kernels import (
    extrapolation_V,
    is_outside,
    lost_temperature_V,
)
from cellwise.cell.unrolled import ByState, unrolled
from cellwise.estimate.equations.components import SlowBranch
from cellwise.estimate.equations.constants import LOST_RATE
from cellwise.estimate.equations.covariance import Point, Slopes
from cellwise.estimate.evidence_kernels import GateResult, StepConstants, slow_variance
from cellwise.estimate.filters.filter_state import EkfStart, EkfState
from cellwise.estimate.filters.step_kernels import innovate, predict, report
from cellwise.estimate.filters.update_kernels import without_voltage
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import (
    NOT_BEGUN_S,
    CheckedReading,
    watch_on,
    watch_voltage,
)
from cellwise.estimate.slopes_kernels import slopes_at
from cellwise.estimate.status import VOLTAGE_INVALID

# A state of a bank in memory, number by number: behind a state stand its cost, minus the logarithm
# of its likelihood beside the likeliest's, its weight, and the variance of one voltage.
OF_BANK = ("cost", "weight", "error_V2", *map(carry, CARRIED), "ss_carry")
STATE = np.dtype([(name, np.float64) for name in (*names_of(EkfState), *OF_BANK)])
State: TypeAlias = Any  # one such record
Out: TypeAlias = Any


class BankModel(NamedTuple):
    """What the components of a bank are steps of."""

    constant: StepConstants
    tables: CellTables
    noise: NoiseScalars
    start: EkfStart


class ComponentPlace(NamedTuple):
    """Where a component is within its tables, beside its SOC."""

    temperature_C: float
    slow_A: float


@inline
def place_now(m: BankModel, a: State) -> ComponentPlace:
    """The cell's temperature and the current behind the lag of its particles' surface."""
    temperature_C = a.temperature_C if math.isfinite(a.temperature_C) else m.start.temperature_C
    return ComponentPlace(temperature_C + a.heat_K, a.slow_A)


@part
@unrolled
def look_up(m: BankModel, place: ComponentPlace, soc: float, current_A: float) -> Point:
    """The tables at a SOC under a current; a gain is 1 / tau."""
    p: ByState = loaded(m.tables, soc, place.temperature_C, current_A, place.slow_A)
    return Point(
        p.ocv_V,
        p.ocv_slope_V,
        slow_variance(m.noise, m.constant.fixed_V2, p),
        p.r0_ohm,
        p.m_V,
        *(p.r[i] for i in BRANCHES),
        *(1.0 / p.tau[i] if p.tau[i] > 0.0 else 0.0 for i in BRANCHES),
    )


@inline
def no_slopes(p: Point) -> Slopes:
    """SOC is well known: the OCV's tangent, and nothing else."""
    return Slopes(p.slope_V, 0.0, 0.0, 0.0, 0.0, 0.0)


@part
@unrolled
def slopes_of(
    m: BankModel, place: ComponentPlace, soc: float, spread: float, current_A: float, p: Point
) -> Slopes:
    """While SOC is badly known slopes are chords over one standard deviation to either side."""
    here = loaded(m.tables, soc, place.temperature_C, current_A, place.slow_A)
    found = slopes_at(
        m.tables, soc, spread * spread, here, place.temperature_C, current_A, place.slow_A
    )
    return Slopes(found.slope_V, found.bend_V, found.spread, *(found.rise.row[i] for i in BRANCHES))


@part
def slow_branch(m: BankModel, place: ComponentPlace, soc: float, current_A: float) -> SlowBranch:
    """The slow branch at a SOC under a current."""
    point = loaded(m.tables, soc, place.temperature_C, current_A, place.slow_A)
    return SlowBranch(point.r3_ohm, 1.0 / point.tau3_s if point.tau3_s > 0.0 else 0.0)


@inline
def is_new(a: State) -> bool:
    """Whether it has seen no sample yet."""
    return bool(a.evidence_s == NOT_BEGUN_S)


@inline
def has_voltage(a: State) -> bool:
    """Whether it has used a voltage."""
    return bool(a.evidence_s >= 0.0)


@inline
def stand_in_bank(a: State) -> None:
    """In float64 a component is known by its place in memory, and rounding keeps nothing."""


@inline
def stand_alone(a: State) -> None:
    """So is the estimate."""


@inline
def hold_within(a: State) -> None:
    """SOC held within 0..1."""
    a.soc = clip(a.soc, 0.0, 1.0)


@inline
def uses_voltage(a: State, out: Out) -> bool:
    """Whether the last sample had a voltage that can be used."""
    return bool(math.isfinite(out.innovation_V))


@inline
def time_of_evidence(a: State) -> float:
    """Time since the first voltage, or since a recovery [s]."""
    return at_least(a.evidence_s, 0.0)


@inline
def unmeasured(m: BankModel, a: State) -> float:
    """Mean square of a current that nobody measures [A^2]."""
    lost_A = LOST_RATE * m.tables.cell.charge_As / 3600.0
    return lost_A * lost_A if a.no_current_s > m.noise.hold_s else 0.0


@inline
def beyond_data(m: BankModel, a: State, current_A: float, held_V: float) -> float:
    """What the model can be off by beyond its data, and without a temperature, one deviation."""
    valid, beyond_V = m.noise.valid, 0.0
    if is_outside(valid, a.soc, a.temperature_C, current_A):
        beyond_V = extrapolation_V(valid, a.temperature_C, current_A, held_V)
    if a.no_warm_s > 0.0:
        beyond_V = beyond_V + lost_temperature_V(a.no_warm_s, held_V)
    return beyond_V


@part
def coast(m: BankModel, a: State, reading: CheckedReading, out: Out) -> int:
    """The estimate over an interval, and the voltage it expects, which moves the components."""
    noise = m.noise
    old: EkfState = record_at(EkfState, a, 0, 1)
    predicted = predict(m.constant, m.tables, noise, None, None, m.start, old, None, reading, True)
    innovation = innovate(m.constant, m.tables, noise, None, reading, predicted)
    off_V = reading.voltage_V - innovation.voltage_V
    last, swings, frozen = watch_voltage(
        noise, predicted.state.watch, reading, off_V, predicted.point.r0_ohm
    )
    used = math.isfinite(off_V) and frozen == 0
    evidence_s = max(predicted.evidence_s, 0.0) if used else predicted.evidence_s
    if evidence_s >= 0.0:
        evidence_s += reading.dt_s
    away_s = predicted.state.watch.no_voltage_s
    after, away = watch_on(noise, reading, used, evidence_s, away_s, last, swings)
    status = frozen | away
    if not math.isfinite(off_V):
        status |= VOLTAGE_INVALID
    # fmt: off
    gate_result = GateResult(
        False, used, 0.0, off_V, math.nan, old.rejections, old.mismatch, after, status
    )
    # fmt: on
    state, info = report(
        innovation,
        gate_result,
        without_voltage(predicted),
        reading.status | predicted.status | status,
    )  # fmt: skip
    put_record(a, 0, 1, state, True)
    out.voltage_V = info.voltage_V
    out.innovation_V = off_V if used else math.nan
    out.innovation_variance_V2 = info.innovation_variance_V2
    return info.status
