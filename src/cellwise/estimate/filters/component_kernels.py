"""A component of a bank in float64: its memory, its step, what the bank asks of its state.

The bank itself is :mod:`cellwise.estimate.equations.bank`, for float64 and for C.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from cellwise.cell.compiled import inline, part
from cellwise.cell.equations import CellState, CellTables, loaded
from cellwise.cell.equations.scalar import clip
from cellwise.cell.packed import names_of, place_of, put_record, record_at
from cellwise.estimate.equations.components import SlowBranch
from cellwise.estimate.equations.covariance import Column
from cellwise.estimate.equations.weighing import Innovation, judge_component
from cellwise.estimate.evidence_kernels import GateResult, StepConstants, repeated_evidence
from cellwise.estimate.filters.covariance_kernels import (
    Covariance,
    corrected,
    moved,
)
from cellwise.estimate.filters.filter_state import EkfStart, EkfState
from cellwise.estimate.filters.sigma_kernels import SigmaScalars
from cellwise.estimate.filters.step_kernels import innovate, predict, report
from cellwise.estimate.filters.update_kernels import Predicted, update, without_voltage
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import (
    NOT_BEGUN_S,
    CheckedReading,
    watch_on,
    watch_voltage,
)
from cellwise.estimate.status import VOLTAGE_INVALID

# A state of a bank in memory, number by number: behind a state stand its cost, minus the logarithm
# of its likelihood beside the likeliest's, its weight, and the variance of one voltage.
OF_BANK = ("cost", "weight", "error_V2")
STATE = np.dtype([(name, np.float64) for name in (*names_of(EkfState), *OF_BANK)])
P_AT = place_of(EkfState, "p")
State: TypeAlias = Any  # one such record
Out: TypeAlias = Any


class BankModel(NamedTuple):
    """What the components of a bank are steps of."""

    constant: StepConstants
    tables: CellTables
    noise: NoiseScalars
    sigma: SigmaScalars | None
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
def move(x: State, k: Column, innovation_V: float) -> None:
    """State + K innovation."""
    old: CellState = record_at(CellState, x, 0, 1)
    put_record(x, 0, 1, moved(old, k, innovation_V), True)


@inline
def narrow(x: State, k: Column, d: Column) -> None:
    """P - K d'."""
    old: Covariance = record_at(Covariance, x, P_AT, 1)
    put_record(x, P_AT, 1, corrected(old, k, d), True)


class WeighedVoltage(NamedTuple):
    """What a component makes of a sample: how the voltage weighs, what it says against it."""

    gate_result: GateResult
    cost: float


@inline
def use_in_bank(
    m: BankModel,
    a: State,
    state: EkfState,
    reading: CheckedReading,
    predicted: Predicted,
    innovation: Innovation,
) -> WeighedVoltage:
    """A voltage to a component, if there is one that can be used."""
    noise, evidence_s = m.noise, predicted.evidence_s
    innovation_V = reading.voltage_V - innovation.voltage_V
    last, swings, frozen = watch_voltage(
        noise, state.watch, reading, innovation_V, predicted.point.r0_ohm
    )
    used = math.isfinite(innovation_V) and frozen == 0
    inverse, cost, ratio = 0.0, 0.0, math.nan
    if used:
        ratio = innovation_V * innovation_V / innovation.variance_V2 * noise.per_gate2
        shared = repeated_evidence(
            m.constant, noise, evidence_s, reading.dt_s, reading.delayed_current_A
        )
        evidence_s = max(evidence_s, 0.0)
        innovation_V, inverse, cost = judge_component(
            m.constant, a, innovation, innovation_V, evidence_s, shared
        )
    if evidence_s >= 0.0:
        evidence_s += reading.dt_s
    after, away = watch_on(noise, reading, used, evidence_s, state.watch.no_voltage_s, last, swings)
    status = frozen | away
    if not math.isfinite(innovation_V):
        status |= VOLTAGE_INVALID
    # fmt: off
    gate_result = GateResult(
        used, used, inverse, innovation_V, ratio, 0.0, a.mismatch, after, status
    )
    # fmt: on
    return WeighedVoltage(gate_result, cost)


@part
def step(m: BankModel, a: State, reading: CheckedReading, out: Out) -> int:
    """A component over an interval: its status; ``out`` is what it has predicted."""
    noise = m.noise
    old: EkfState = record_at(EkfState, a, 0, 1)
    predicted = predict(m.constant, m.tables, noise, m.sigma, None, m.start, old, None, reading)
    innovation = innovate(m.constant, m.tables, noise, m.sigma, reading, predicted)
    if not (a.error_V2 > 0.0):
        a.error_V2 = innovation.single_V2
    weighed = use_in_bank(m, a, predicted.state, reading, predicted, innovation)
    gate_result = weighed.gate_result
    estimate = (
        update(m.constant, noise, None, reading, predicted, innovation, gate_result)
        if gate_result.accepted
        else without_voltage(predicted)
    )
    after, info = report(
        innovation, gate_result, estimate, reading.status | predicted.status | gate_result.status
    )
    put_record(a, 0, 1, after, True)
    a.cost += weighed.cost
    out.voltage_V = info.voltage_V
    out.innovation_variance_V2 = info.innovation_variance_V2
    return info.status
