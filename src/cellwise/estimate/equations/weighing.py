"""A voltage that is looked at: gate, recovery and weight, what it says against count and model.

``c`` are the constants of one time step, ``x`` is what is carried: records of either precision have
these fields. Time is in steps of the fixed step, in seconds elsewhere; so is a ``Count``, which is
a whole number there.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES, H
from cellwise.cell.equations.double import in_units, positive_above, unit_of
from cellwise.cell.equations.scalar import at_most
from cellwise.cell.unrolled import unrolled_by_option
from cellwise.estimate.equations.covariance import Column, Point
from cellwise.estimate.equations.evidence import (
    Shared,
    contradicted_step,
    inverse_weight,
    lately_shown,
    persistent_step,
    persistent_V,
)
from cellwise.estimate.status import GATE_RECOVERY, INNOVATION_REJECTED

SLOW = HYSTERESIS = True  # states that a fixed step may do without
U = int  # kinds of numbers; those of the fixed step are of four bytes
Count = float
Constants: TypeAlias = Any
State: TypeAlias = Any
OffsetFloat: TypeAlias = Any


@inline
@unrolled_by_option
def voltage_at(x: State, p: Point, drop: float) -> float:
    """The voltage that the state gives at a point of the tables [V]."""
    voltage = p.ocv_V - drop
    for i in BRANCHES:
        voltage = voltage - x.state[i]
    for i in (H,):
        voltage = voltage + (p.m_V * x.state[i])
    return voltage


class Innovation(NamedTuple):
    """What the state says of the next voltage, before it is looked at.

    ``variance_V2`` is that of a single innovation, ``explained_V2`` what the state brings to it and
    ``single_V2`` what the voltage; ``slope_V`` is the voltage's over SOC, ``column`` P H'. One
    deviation of an offset moves the voltage by ``of_offset_V``, all that is believed of offset (and
    capacity) has moved it by ``bias_V``.
    """

    voltage_V: float
    variance_V2: float
    explained_V2: float
    single_V2: float
    slope_V: float
    of_offset_V: OffsetFloat
    bias_V: OffsetFloat
    column: Column


class Verdict(NamedTuple):
    """What becomes of a voltage: a rejected one only moves the counts.

    After too long a time of them in a row the state ``recovers``: the SOC is open again. ``shown``
    is the mismatch in units of ``unit``, which :func:`weight_of` takes.
    """

    accepted: bool
    recovers: bool
    rejections: Count
    shown: float
    unit: float
    mismatch: float
    status: int


@inline
def judge(
    c: Constants, x: State, innovation: Innovation, innovation_V: float, lately: float, turn: Count
) -> Verdict:
    """Gate and count one innovation.

    It moves the running mismatch by ``lately`` and counts as a rejection for ``turn``.
    """
    square = innovation_V * innovation_V
    own_V2 = innovation.explained_V2 + innovation.single_V2
    unit = unit_of(own_V2)
    most = at_most(
        in_units(square, own_V2), c.mismatch_cap * unit
    )  # one counts for so much at most
    shown = lately_shown(x.mismatch * unit, most, lately)
    mismatch = shown / unit
    accepted = not positive_above(square, c.gate_square * innovation.variance_V2)
    recovers = False
    rejections = Count(0)
    status = U(0)
    if not accepted:
        status = U(INNOVATION_REJECTED)
        rejections = Count(x.rejections + turn)
        if rejections >= c.recovery_after:
            recovers = True
            status = U(INNOVATION_REJECTED | GATE_RECOVERY)
            rejections = Count(0)
            mismatch = 1.0
    return Verdict(accepted, recovers, rejections, shown, unit, mismatch, status)


@inline
def weight_of(innovation: Innovation, shown: float, unit: float, shared: Shared) -> float:
    """One over the variance that weighs an accepted voltage.

    What the innovations have lately shown beyond their variance makes evidence weigh less.
    """
    of_single = innovation.single_V2 * shared.above
    weight = unit * of_single
    if positive_above(shown, unit):
        weight = shown * of_single
    return inverse_weight(innovation.explained_V2, weight, unit * shared.below)


@inline
def contradicted_after(
    c: Constants, x: State, innovation: Innovation, innovation_V: float, since: float
) -> float:
    """SOC that the voltages say is missing, were the current off for all of the time ``since``."""
    drift = c.drift_soc * since
    return contradicted_step(
        x.contradicted,
        innovation_V,
        innovation.slope_V,
        innovation.single_V2,
        drift,
        c.contradicted_share,
    )


@inline
def persistent_after(
    c: Constants, x: State, innovation: Innovation, error_V2: float, mismatch: float, gain: float
) -> float:
    """SOC error by a persistent error of the model, after a voltage with a ``gain`` of the SOC."""
    error_V = persistent_V(c.persistent, error_V2, mismatch)
    return persistent_step(gain, innovation.slope_V, x.persistent, error_V)
