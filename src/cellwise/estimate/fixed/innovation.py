"""What a measured voltage means to the fixed step; see ``arithmetic``."""

from __future__ import annotations

from typing import Any, NamedTuple

from cellwise.estimate.fixed.arithmetic import (
    COUNT_MOST,
    FIRST_VOLTAGE,
    FORGIVEN,
    FOUR,
    FROZEN,
    FROZEN_READINGS,
    HALF,
    ONE,
    REJECTION,
    SHARED_GROWTH,
    THREE,
    ZERO,
    F,
    U,
    clip,
    kernel,
    magnitude,
    out_of_range,
    within,
)
from cellwise.estimate.fixed.gain import Column, column_of
from cellwise.estimate.fixed.search import voltage_of
from cellwise.estimate.status import (
    GATE_RECOVERY,
    INNOVATION_REJECTED,
    VOLTAGE_FROZEN,
    VOLTAGE_INVALID,
    VOLTAGE_LOST,
)


class Innovation(NamedTuple):
    """Measured minus predicted voltage.

    ``variance`` is that of a single one, ``explained`` what the state and ``one`` what the voltage
    brings to it; ``polarisation`` how much of the voltage is current's doing.
    """

    status: int
    looked_at: bool
    innovation: float
    variance: float
    explained: float
    one: float
    polarisation: float
    column: Column


class Judgement(NamedTuple):
    """What an innovation leads to: SOC is looked for anew, or weighed by ``inverse`` if above 0."""

    status: int
    anew: bool
    inverse: float


@kernel
def watch_voltage(
    c: Any, x: Any, voltage: float, seen: float, r0_ohm: float, innovation: float
) -> Any:
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
        if x.repeats < COUNT_MOST:
            x.repeats = U(x.repeats + U(1))
        if (
            x.repeats >= FROZEN_READINGS
            and moved > c.frozen_V
            and magnitude(innovation) > (HALF * moved)
        ):
            x.repeats = FROZEN
            status = U(VOLTAGE_FROZEN)
    return status


@kernel
def shared_by(c: Any, x: Any, seen: float) -> Any:
    """How many samples share one model error.

    What the model gets wrong it gets wrong on every time scale, so the memory grows with the time
    since the first voltage until it is the model's own. The first voltage at rest is evidence by
    itself.
    """
    shared = ONE
    if x.evidence >= FIRST_VOLTAGE:
        since = F(U(x.evidence - FIRST_VOLTAGE))
        shared = clip(c.shared_start + (SHARED_GROWTH * since), ONE, c.shared)
    elif magnitude(seen) >= c.rest_A:
        shared = clip(c.shared_start, ONE, c.shared)
    return shared


@kernel
def innovate(
    c: Any,
    x: Any,
    p: Any,
    w: Any,
    s: Any,
    voltage: float,
    out: Any,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
    WATCH: int,
) -> Innovation:
    """Predicted voltage, innovation and their variances, told; whether the voltage can be used."""
    status = U(0)
    looked_at = False
    drop = p.r0_ohm * s.seen
    polarisation = (magnitude(drop) + magnitude(x.v1_V)) + magnitude(x.v2_V)
    away = U(0)
    if WATCH:
        away = x.no_voltage
        if s.news == 2 and away < COUNT_MOST:
            away = U(away + U(1))
    if SLOW:
        polarisation = polarisation + magnitude(x.v3_V)
    predicted = voltage_of(x, p, drop, SLOW, HYSTERESIS)
    one = p.noise_V2 + (
        (c.share_variance * (polarisation * polarisation))
        + ((c.current_variance_A2 + s.unmeasured_A2) * (p.r0_ohm * p.r0_ohm))
    )
    # An OCV that bends by c at one standard deviation is off its tangent by c z^2.
    d = column_of(x, p, w.slope_V, SLOW, HYSTERESIS, OFFSET)
    explained = d.variance + (THREE * (w.bend_V * w.bend_V))
    variance = explained + one
    innovation = ZERO
    if not within(voltage, c.voltage_low_V, c.voltage_high_V):
        status = U(U(VOLTAGE_INVALID) | out_of_range(voltage))
    else:
        innovation = voltage - predicted
        looked_at = s.news != 0  # a repeated sample is no evidence
        if WATCH and looked_at:
            status = watch_voltage(c, x, voltage, s.seen, p.r0_ohm, innovation)
            looked_at = status == U(0)
            if looked_at:
                away = U(0)
    if WATCH:
        if s.news != 0:
            x.no_voltage = away
        if away > c.hold_steps:
            status = U(status | U(VOLTAGE_LOST))
    out.voltage_V = predicted
    out.innovation_variance_V2 = variance
    out.innovation_V = innovation
    return Innovation(status, looked_at, innovation, variance, explained, one, polarisation, d)


@kernel
def judge(c: Any, x: Any, w: Any, i: Any, seen: float, news: int, WIDE: int) -> Judgement:
    """An innovation that is looked at: gate, recovery, weight.

    Under load the resistances may be what is wrong: what three times the polarisation can explain
    speaks against the SOC more slowly. What the innovations have lately shown beyond their variance
    makes evidence weigh less. A first sample under load tells of the load more than of the SOC.
    """
    square = i.innovation * i.innovation
    most = c.gate_square * i.variance
    status = U(0)
    unsure = False
    bent = False
    anew = False
    inverse = ZERO
    if WIDE:
        # A start that is unsure of itself believes the first voltage at rest at once, and looks
        # for it where the OCV bends too much for a slope.
        unsure = (w.spread > ZERO) & (x.evidence < FIRST_VOLTAGE) & (magnitude(seen) < c.rest_A)
        flat = w.slope_V < c.flat_slope_V
        bent = unsure & (((THREE * (w.bend_V * w.bend_V)) > i.one) | flat)
    if news == 2:
        ratio = square / i.variance
        ratio = ratio if ratio < c.mismatch_cap else c.mismatch_cap
        x.mismatch = x.mismatch + (c.lately * (ratio - x.mismatch))
    if square > most:
        status = U(INNOVATION_REJECTED)
        explicable = (square - most) <= (FOUR * (i.polarisation * i.polarisation))
        x.rejections = U(x.rejections + (c.under_load if explicable else REJECTION))
        if unsure:
            x.rejections = c.recovery_after
        if x.rejections >= c.recovery_after:
            status = U(status | U(GATE_RECOVERY))
            x.rejections = U(0)
            x.mismatch = ONE
            anew = True
    elif bent:
        anew = True
    else:
        shared = shared_by(c, x, seen)
        weight = i.one * shared
        if x.mismatch > ONE:
            weight = weight * x.mismatch
        if news == 2 or shared <= ONE:
            inverse = ONE / (i.explained + weight)
        x.rejections = U(x.rejections - FORGIVEN) if x.rejections > FORGIVEN else U(0)
        if x.evidence < FIRST_VOLTAGE:
            x.evidence = FIRST_VOLTAGE
    return Judgement(status, anew, inverse)
