"""Correction of the fixed step by a measured voltage; see fixed_step_kernels."""

from __future__ import annotations

from typing import Any

from cellwise.estimate.fixed_step_anew import (
    look_anew,
    voltage_of,
    widen,
)
from cellwise.estimate.fixed_step_gain import (
    column_of,
    move,
    narrow,
    rejudge,
)
from cellwise.estimate.fixed_step_kernels import (
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
from cellwise.estimate.status import (
    GATE_RECOVERY,
    INNOVATION_REJECTED,
    VOLTAGE_FROZEN,
    VOLTAGE_INVALID,
    VOLTAGE_LOST,
)


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
def weigh(
    c: Any,
    t: Any,
    place: Any,
    x: Any,
    p: Any,
    w: Any,
    d: Any,
    seen: float,
    voltage: float,
    news: int,
    explained: float,
    one: float,
    polarisation: float,
    innovation: float,
    variance: float,
    load: Any,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
    SCALED: int,
    WIDE: int,
) -> Any:
    """An innovation that is looked at: gate, recovery, weight.

    Under load the resistances may be what is wrong: what three times the polarisation can explain
    speaks against the SOC more slowly. What the innovations have lately shown beyond their variance
    makes evidence weigh less. A first sample under load tells of the load more than of the SOC.
    """
    square = innovation * innovation
    most = c.gate_square * variance
    status = U(0)
    unsure = False
    bent = False
    anew = False
    if WIDE:
        # A start that is unsure of itself believes the first voltage at rest at once, and looks
        # for it where the OCV bends too much for a slope.
        unsure = (w.spread > ZERO) & (x.evidence < FIRST_VOLTAGE) & (magnitude(seen) < c.rest_A)
        flat = w.slope_V < c.flat_slope_V
        bent = unsure & (((THREE * (w.bend_V * w.bend_V)) > one) | flat)
    if news == 2:
        ratio = square / variance
        ratio = ratio if ratio < c.mismatch_cap else c.mismatch_cap
        x.mismatch = x.mismatch + (c.lately * (ratio - x.mismatch))
    if square > most:
        status = U(INNOVATION_REJECTED)
        explicable = (square - most) <= (FOUR * (polarisation * polarisation))
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
        weight = one * shared
        if x.mismatch > ONE:
            weight = weight * x.mismatch
        if news == 2 or shared <= ONE:
            inverse = ONE / (explained + weight)
            learnt = True
            if WIDE and w.spread > ZERO:
                # fmt: off
                learnt = rejudge(t, place, x, p, w, d, inverse, innovation, seen, load, SLOW,
                                 HYSTERESIS, OFFSET, SCALED)
                # fmt: on
            move(c, x, d, inverse, innovation, SLOW, HYSTERESIS, OFFSET)
            if learnt:
                narrow(x, d, inverse, SLOW, HYSTERESIS, OFFSET, WIDE)
        x.rejections = U(x.rejections - FORGIVEN) if x.rejections > FORGIVEN else U(0)
        if x.evidence < FIRST_VOLTAGE:
            x.evidence = FIRST_VOLTAGE
    if anew and WIDE:
        # fmt: off
        look_anew(c, t, place, x, seen, voltage, one, polarisation, load, SLOW, HYSTERESIS, OFFSET,
                  SCALED)
        # fmt: on
    if anew and not WIDE:
        widen(c, x, p, seen, SLOW, HYSTERESIS, OFFSET)
    return status


@kernel
def correct(
    c: Any,
    t: Any,
    place: Any,
    x: Any,
    p: Any,
    w: Any,
    seen: float,
    unmeasured_A2: float,
    voltage: float,
    news: int,
    out: Any,
    load: Any,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
    SCALED: int,
    WIDE: int,
    WATCH: int,
) -> Any:
    """Predicted voltage, innovation, and what follows from it.

    ``news`` is 0 where the sample was seen before, 1 where it ends no interval, 2 where time has
    passed since the last one.
    """
    status = U(0)
    drop = p.r0_ohm * seen
    polarisation = (magnitude(drop) + magnitude(x.v1_V)) + magnitude(x.v2_V)
    away = U(0)
    if WATCH:
        away = x.no_voltage
        if news == 2 and away < COUNT_MOST:
            away = U(away + U(1))
    if SLOW:
        polarisation = polarisation + magnitude(x.v3_V)
    predicted = voltage_of(x, p, drop, SLOW, HYSTERESIS)
    one = p.noise_V2 + (
        (c.share_variance * (polarisation * polarisation))
        + ((c.current_variance_A2 + unmeasured_A2) * (p.r0_ohm * p.r0_ohm))
    )
    # An OCV that bends by c at one standard deviation is off its tangent by c z^2.
    d = column_of(x, p, w.slope_V, SLOW, HYSTERESIS, OFFSET)
    explained = d.variance + (THREE * (w.bend_V * w.bend_V))
    variance = explained + one
    out.voltage_V = predicted
    out.innovation_variance_V2 = variance
    out.innovation_V = ZERO
    if not within(voltage, c.voltage_low_V, c.voltage_high_V):
        status = U(U(VOLTAGE_INVALID) | out_of_range(voltage))
    else:
        innovation = voltage - predicted
        out.innovation_V = innovation
        if news != 0:  # a repeated sample is no evidence
            if WATCH:
                status = watch_voltage(c, x, voltage, seen, p.r0_ohm, innovation)
                if status == U(0):
                    away = U(0)
            if status == U(0):
                # fmt: off
                status = weigh(c, t, place, x, p, w, d, seen, voltage, news, explained, one,
                               polarisation, innovation, variance, load, SLOW, HYSTERESIS, OFFSET,
                               SCALED, WIDE)
                # fmt: on
    if WATCH:
        if news != 0:
            x.no_voltage = away
        if away > c.hold_steps:
            status = U(status | U(VOLTAGE_LOST))
    return status
