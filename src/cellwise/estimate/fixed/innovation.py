"""What a measured voltage means to the fixed step: prediction, gate, recovery, weight."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.estimate.fixed.arithmetic import (
    COUNT_MOST,
    FIRST_VOLTAGE,
    FORGIVEN,
    FOUR,
    FROZEN,
    FROZEN_READINGS,
    HALF,
    INTERVAL,
    ONE,
    REJECTION,
    REPEATED,
    SHARED_GROWTH,
    THREE,
    ZERO,
    Constants,
    Count,
    F,
    Flag,
    Float,
    Output,
    State,
    U,
    clip,
    magnitude,
    out_of_range,
    positive_above,
    positive_within,
    size_below,
)
from cellwise.estimate.fixed.covariance import Column, column_of
from cellwise.estimate.fixed.lookup import Point, Slopes
from cellwise.estimate.fixed.options import SLOW, WATCH, WIDE
from cellwise.estimate.fixed.search import voltage_of
from cellwise.estimate.fixed.sensing import Reading
from cellwise.estimate.status import (
    GATE_RECOVERY,
    INNOVATION_REJECTED,
    VOLTAGE_FROZEN,
    VOLTAGE_INVALID,
    VOLTAGE_LOST,
)


class Innovation(NamedTuple):
    """Measured minus predicted voltage, and whether it is looked at.

    ``variance_V2`` is that of a single one, ``explained_V2`` what the state and ``one_V2`` what the
    voltage brings to it; ``polarisation_V`` how much of the voltage is current's doing.
    """

    status: Count
    looked_at: Flag
    value_V: Float
    variance_V2: Float
    explained_V2: Float
    one_V2: Float
    polarisation_V: Float
    column: Column


class Judgement(NamedTuple):
    """What an innovation leads to: SOC is searched, or corrected with ``inverse`` if above 0."""

    status: Count
    anew: Flag
    inverse: Float


def watch_voltage(
    c: Constants, x: State, voltage: Float, seen: Float, r0_ohm: Float, innovation: Float
) -> Count:
    """Whether the voltage is frozen.

    A reading that repeats itself is frozen once R0 times the change of current says that it must
    have moved, and the prediction is off by half of that: a held voltage repeats itself, too, but
    the model expects it there. It stays frozen until it changes.
    """
    status = U(0)
    if voltage < x.voltage_V or voltage > x.voltage_V:
        x.voltage_V = voltage
        x.frozen_A = seen
        x.repeats = U(0)
    elif x.repeats == FROZEN:
        status = U(VOLTAGE_FROZEN)
    else:
        moved = magnitude(r0_ohm * (seen - x.frozen_A))
        off = magnitude(innovation) > (HALF * moved)
        if x.repeats < COUNT_MOST:
            x.repeats = U(x.repeats + 1)
        if x.repeats >= FROZEN_READINGS and moved > c.frozen_V and off:
            x.repeats = FROZEN
            status = U(VOLTAGE_FROZEN)
    return status


def shared_by(c: Constants, x: State, seen: Float) -> Float:
    """How many samples share one model error.

    What the model gets wrong it gets wrong on every time scale, so the memory grows with the time
    since the first voltage until it is the model's own. The first voltage at rest is evidence by
    itself.
    """
    shared = ONE
    if x.evidence >= FIRST_VOLTAGE:
        since = F(U(x.evidence - FIRST_VOLTAGE))
        shared = clip(c.shared_start + (SHARED_GROWTH * since), ONE, c.shared)
    elif not size_below(seen, c.rest_A):
        shared = clip(c.shared_start, ONE, c.shared)
    return shared


def innovate(
    c: Constants, x: State, p: Point, w: Slopes, s: Reading, voltage: Float, out: Output
) -> Innovation:
    """Predicted voltage, innovation and their variances; whether the voltage can be used."""
    status = U(0)
    looked_at = False
    drop = p.r0_ohm * s.seen
    polarisation_V = (magnitude(drop) + magnitude(x.v1_V)) + magnitude(x.v2_V)
    if WATCH:
        away = x.no_voltage
        if s.news == INTERVAL and away < COUNT_MOST:
            away = U(away + 1)
    if SLOW:
        polarisation_V = polarisation_V + magnitude(x.v3_V)
    predicted = voltage_of(x, p, drop)
    one_V2 = p.noise_V2 + (
        (c.share_variance * (polarisation_V * polarisation_V))
        + ((c.current_variance_A2 + s.unmeasured_A2) * (p.r0_ohm * p.r0_ohm))
    )
    # An OCV that bends by c at one standard deviation is off its tangent by c z^2.
    column = column_of(x, p, w.slope_V)
    explained_V2 = column.variance + (THREE * (w.bend_V * w.bend_V))
    variance_V2 = explained_V2 + one_V2
    value_V = ZERO
    if not positive_within(voltage, c.voltage_low_V, c.voltage_high_V):
        status = U(VOLTAGE_INVALID | out_of_range(voltage))
    else:
        value_V = voltage - predicted
        looked_at = s.news != REPEATED  # a repeated sample is no evidence
        if WATCH and looked_at:
            status = watch_voltage(c, x, voltage, s.seen, p.r0_ohm, value_V)
            looked_at = status == U(0)
            if looked_at:
                away = U(0)
    if WATCH:
        if s.news != REPEATED:
            x.no_voltage = away
        if away > c.hold_steps:
            status = U(status | VOLTAGE_LOST)
    out.voltage_V = predicted
    out.innovation_V = value_V
    out.innovation_variance_V2 = variance_V2
    # fmt: off
    return Innovation(
        status, looked_at, value_V, variance_V2, explained_V2, one_V2, polarisation_V, column
    )
    # fmt: on


def judge(
    c: Constants, x: State, w: Slopes, i: Innovation, seen: Float, news: Count
) -> Judgement:
    """An innovation that is looked at: gate, recovery, weight.

    Under load the resistances may be what is wrong: what three times the polarisation can explain
    speaks against the SOC more slowly. What the innovations have lately shown beyond their variance
    makes evidence weigh less. A first sample under load tells of the load more than of the SOC.
    """
    square = i.value_V * i.value_V
    most = c.gate_square * i.variance_V2
    status = U(0)
    anew = False
    inverse = ZERO
    if WIDE:
        # A start that is unsure of itself believes the first voltage at rest at once, and looks
        # for it where the OCV bends too much for a slope.
        unsure = w.spread > ZERO and x.evidence < FIRST_VOLTAGE and size_below(seen, c.rest_A)
        bends = (THREE * (w.bend_V * w.bend_V)) > i.one_V2 or w.slope_V < c.flat_slope_V
        anew = unsure and bends
    if news == INTERVAL:
        ratio = square / i.variance_V2
        ratio = ratio if ratio < c.mismatch_cap else c.mismatch_cap
        x.mismatch = x.mismatch + (c.lately * (ratio - x.mismatch))
    if positive_above(square, most):
        status = U(INNOVATION_REJECTED)
        anew = False
        if (square - most) > (FOUR * (i.polarisation_V * i.polarisation_V)):
            x.rejections = U(x.rejections + REJECTION)
        else:
            x.rejections = U(x.rejections + c.under_load)
        if WIDE and unsure:
            x.rejections = c.recovery_after
        if x.rejections >= c.recovery_after:
            status = U(status | GATE_RECOVERY)
            x.rejections = U(0)
            x.mismatch = ONE
            anew = True
    elif not anew:
        shared = shared_by(c, x, seen)
        weight = i.one_V2 * shared
        if positive_above(x.mismatch, ONE):
            weight = weight * x.mismatch
        if news == INTERVAL or shared <= ONE:
            inverse = ONE / (i.explained_V2 + weight)
        x.rejections = U(x.rejections - FORGIVEN) if x.rejections > FORGIVEN else U(0)
        if x.evidence < FIRST_VOLTAGE:
            x.evidence = FIRST_VOLTAGE
    return Judgement(status, anew, inverse)
