"""Prediction of the fixed step; see ``arithmetic``."""

from __future__ import annotations

from typing import Any

from cellwise.estimate.fixed.arithmetic import (
    GROW,
    ONE,
    SOC_VARIANCE_MOST,
    TWO,
    ZERO,
    F,
    add,
    clip,
    kernel,
    magnitude,
    risen,
)
from cellwise.estimate.fixed.state import add_variance


@kernel
def relax(
    x: Any,
    p: Any,
    gain1: float,
    gain2: float,
    gain3: float,
    flow: float,
    square_A2: float,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
) -> None:
    """The branches over one interval of constant current, exactly, and their covariance.

    A current that is not known to ``square_A2`` drives them too; 1 - a^2 keeps the stationary
    spread independent of the time step. What decays slowly is told by how much it loses: 1 - 1e-5
    as a float is off by 0.3 % of that.
    """
    a1 = ONE - gain1
    a2 = ONE - gain2
    x.v1_V = x.v1_V + (gain1 * ((p.r1_ohm * flow) - x.v1_V))
    x.v2_V = x.v2_V + (gain2 * ((p.r2_ohm * flow) - x.v2_V))
    x.s1 = x.s1 - (gain1 * x.s1)
    x.s2 = x.s2 - (gain2 * x.s2)
    x.p11 = x.p11 + ((gain1 * (ONE + a1)) * ((square_A2 * (p.r1_ohm * p.r1_ohm)) - x.p11))
    x.p12 = (a1 * a2) * x.p12
    x.p22 = x.p22 + ((gain2 * (ONE + a2)) * ((square_A2 * (p.r2_ohm * p.r2_ohm)) - x.p22))
    if SLOW:
        a3 = ONE - gain3
        x.v3_V, x.v3_carry_V = add(x.v3_V, x.v3_carry_V, gain3 * ((p.r3_ohm * flow) - x.v3_V))
        x.s3 = x.s3 - (gain3 * x.s3)
        x.p13 = (a1 * a3) * x.p13
        x.p23 = x.p23 - ((gain2 + (gain3 * a2)) * x.p23)
        x.p33 = x.p33 + ((gain3 * (ONE + a3)) * ((square_A2 * (p.r3_ohm * p.r3_ohm)) - x.p33))
        if HYSTERESIS:
            x.p3h = x.p3h - (gain3 * x.p3h)
        if OFFSET:
            x.p3o = x.p3o - (gain3 * x.p3o)
    if HYSTERESIS:
        x.p1h = x.p1h - (gain1 * x.p1h)
        x.p2h = x.p2h - (gain2 * x.p2h)
    if OFFSET:
        x.p1o = x.p1o - (gain1 * x.p1o)
        x.p2o = x.p2o - (gain2 * x.p2o)


@kernel
def taken(c: Any, current: float, EFFICIENCY: int, LEAK: int) -> Any:
    """Charge that leaves the cell in one step, in SOC."""
    used = current
    if EFFICIENCY and used < ZERO:
        used = used * c.charge_efficiency
    if LEAK:
        return (c.soc_per_A * used) + c.leak_soc
    return c.soc_per_A * used


@kernel
def cross_gap(
    c: Any,
    x: Any,
    p: Any,
    missing: Any,
    current: float,
    bridge: float,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
    WIDE: int,
) -> None:
    """Samples are missing: the branches may hold what the currents on both sides can have left.

    With WIDE they relax towards the mean of these currents, too.
    """
    unknown_A2 = (current * current) + (x.current_A * x.current_A)
    steps = F(missing)
    spread = c.gap_variance
    if missing <= c.gap_steps:
        moved = c.soc_per_A * steps
        spread = (moved * moved) * unknown_A2
    x.ss = x.ss + spread
    if WIDE:
        gain3 = ZERO
        if SLOW:
            gain3 = risen(steps * p.gain3)
        gain1 = risen(steps * p.gain1)
        gain2 = risen(steps * p.gain2)
        relax(x, p, gain1, gain2, gain3, bridge, unknown_A2, SLOW, HYSTERESIS, OFFSET)
    else:
        x.p11 = x.p11 + (unknown_A2 * (p.r1_ohm * p.r1_ohm))
        x.p22 = x.p22 + (unknown_A2 * (p.r2_ohm * p.r2_ohm))
        if SLOW:
            x.p33 = x.p33 + (unknown_A2 * (p.r3_ohm * p.r3_ohm))
    if HYSTERESIS:
        x.sh = ZERO
        x.p1h = ZERO
        x.p2h = ZERO
        x.phh = ONE
    if HYSTERESIS and SLOW:
        x.p3h = ZERO
    if HYSTERESIS and OFFSET:
        x.pho = ZERO


@kernel
def tilt(x: Any, p: Any, w: Any, flow: float, SLOW: int, HYSTERESIS: int, OFFSET: int) -> None:
    """A SOC that is off drives the branches by the resistances' slopes."""
    f1 = (w.rise1 * p.gain1) * flow
    f2 = (w.rise2 * p.gain2) * flow
    x.p11 = x.p11 + (f1 * ((TWO * x.s1) + (f1 * x.ss)))
    x.p12 = x.p12 + (((f1 * x.s2) + (f2 * x.s1)) + ((f1 * f2) * x.ss))
    x.p22 = x.p22 + (f2 * ((TWO * x.s2) + (f2 * x.ss)))
    if SLOW:
        f3 = (w.rise3 * p.gain3) * flow
        x.p13 = x.p13 + (((f1 * x.s3) + (f3 * x.s1)) + ((f1 * f3) * x.ss))
        x.p23 = x.p23 + (((f2 * x.s3) + (f3 * x.s2)) + ((f2 * f3) * x.ss))
        x.p33 = x.p33 + (f3 * ((TWO * x.s3) + (f3 * x.ss)))
        x.s3 = x.s3 + (f3 * x.ss)
        if HYSTERESIS:
            x.p3h = x.p3h + (f3 * x.sh)
        if OFFSET:
            x.p3o = x.p3o + (f3 * x.so)
    if HYSTERESIS:
        x.p1h = x.p1h + (f1 * x.sh)
        x.p2h = x.p2h + (f2 * x.sh)
    if OFFSET:
        x.p1o = x.p1o + (f1 * x.so)
        x.p2o = x.p2o + (f2 * x.so)
    x.s1 = x.s1 + (f1 * x.ss)
    x.s2 = x.s2 + (f2 * x.ss)


@kernel
def spread_offset(c: Any, x: Any, p: Any, SLOW: int, HYSTERESIS: int) -> None:
    """The sensor's offset drives every state that the current drives.

    The offset's column of P has decayed already; e is what one ampere of offset does to a state in
    one step.
    """
    es = c.soc_per_A
    e1 = -(p.gain1 * p.r1_ohm)
    e2 = -(p.gain2 * p.r2_ohm)
    cs = x.so + (es * x.poo)
    c1 = x.p1o + (e1 * x.poo)
    c2 = x.p2o + (e2 * x.poo)
    x.ss = x.ss + (es * (x.so + cs))
    x.s1 = x.s1 + ((e1 * x.so) + (es * c1))
    x.s2 = x.s2 + ((e2 * x.so) + (es * c2))
    x.p11 = x.p11 + (e1 * (x.p1o + c1))
    x.p12 = x.p12 + ((e2 * x.p1o) + (e1 * c2))
    x.p22 = x.p22 + (e2 * (x.p2o + c2))
    if SLOW:
        e3 = -(p.gain3 * p.r3_ohm)
        c3 = x.p3o + (e3 * x.poo)
        x.s3 = x.s3 + ((e3 * x.so) + (es * c3))
        x.p13 = x.p13 + ((e3 * x.p1o) + (e1 * c3))
        x.p23 = x.p23 + ((e3 * x.p2o) + (e2 * c3))
        x.p33 = x.p33 + (e3 * (x.p3o + c3))
        if HYSTERESIS:
            x.p3h = x.p3h + (e3 * x.pho)
        x.p3o = c3
    if HYSTERESIS:
        x.sh = x.sh + (es * x.pho)
        x.p1h = x.p1h + (e1 * x.pho)
        x.p2h = x.p2h + (e2 * x.pho)
    x.so = cs
    x.p1o = c1
    x.p2o = c2
    x.poo = x.poo * GROW
    if x.poo < c.offset_variance_A2:
        x.poo = x.poo + c.offset_walk_A2


@kernel
def predict(
    c: Any,
    x: Any,
    p: Any,
    w: Any,
    flow: float,
    unmeasured_A2: float,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
    WIDE: int,
) -> None:
    """One interval of constant current.

    A resistance that is off by a share drives its branch like a current that is off by it, and so
    does a current that nobody measured.
    """
    square_A2 = (c.share_variance * (flow * flow)) + unmeasured_A2
    relax(x, p, p.gain1, p.gain2, p.gain3, flow, square_A2, SLOW, HYSTERESIS, OFFSET)
    if HYSTERESIS:
        rise = risen(c.hysteresis_per_A * magnitude(flow))
        ah = ONE - rise
        x.h = clip((ah * x.h) + (rise if flow < ZERO else -rise), -ONE, ONE)
        x.sh = ah * x.sh
        x.p1h = ah * x.p1h
        x.p2h = ah * x.p2h
        x.phh = (ah * ah) * x.phh
        if SLOW:
            x.p3h = ah * x.p3h
        if OFFSET:
            x.pho = ah * x.pho
    if WIDE and w.spread > ZERO:
        tilt(x, p, w, flow, SLOW, HYSTERESIS, OFFSET)
    if x.ss < SOC_VARIANCE_MOST:  # SOC lies in 0..1: more says nothing
        add_variance(x, c.soc_walk, WIDE)
    if OFFSET:
        spread_offset(c, x, p, SLOW, HYSTERESIS)
