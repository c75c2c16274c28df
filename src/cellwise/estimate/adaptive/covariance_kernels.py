"""Covariance of the adaptive filter: that of the EKF, and offset and capacity.

Printed from :mod:`cellwise.cell.description` by `python -m cellwise.printing`; do not edit.
"""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations import Transition

VARIANCE_FLOOR = 1e-12


class AdaptiveCovariance(NamedTuple):
    """Upper triangle of P over soc, v1_V, v2_V, v3_V, h, offset_A, charge."""

    ss: float
    s1: float
    s2: float
    s3: float
    sh: float
    so: float
    sq: float
    p11: float
    p12: float
    p13: float
    p1h: float
    p1o: float
    p1q: float
    p22: float
    p23: float
    p2h: float
    p2o: float
    p2q: float
    p33: float
    p3h: float
    p3o: float
    p3q: float
    phh: float
    pho: float
    phq: float
    poo: float
    poq: float
    pqq: float


class AdaptiveColumn(NamedTuple):
    """One number for each state: P H', or a gain."""

    s: float  # state of charge
    v1: float  # voltage of the fast branch
    v2: float  # voltage of the second branch
    v3: float  # voltage of the slow branch
    h: float  # hysteresis, -1 to 1
    o: float  # what the current sensor adds
    q: float  # the model's capacity over the cell's


@inline
def uncorrelated(
    ss: float, p11: float, p22: float, p33: float, phh: float, poo: float, pqq: float
) -> AdaptiveCovariance:
    """States that know nothing of each other."""
    return AdaptiveCovariance(
        ss,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        p11,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        p22,
        0.0,
        0.0,
        0.0,
        0.0,
        p33,
        0.0,
        0.0,
        0.0,
        phh,
        0.0,
        0.0,
        poo,
        0.0,
        pqq,
    )


@inline
def decayed(p: AdaptiveCovariance, t: Transition) -> AdaptiveCovariance:
    """A P A' with the diagonal transition A."""
    return AdaptiveCovariance(
        p.ss,
        t.a1 * p.s1,
        t.a2 * p.s2,
        t.a3 * p.s3,
        t.ah * p.sh,
        p.so,
        p.sq,
        t.a1 * t.a1 * p.p11,
        t.a1 * t.a2 * p.p12,
        t.a1 * t.a3 * p.p13,
        t.a1 * t.ah * p.p1h,
        t.a1 * p.p1o,
        t.a1 * p.p1q,
        t.a2 * t.a2 * p.p22,
        t.a2 * t.a3 * p.p23,
        t.a2 * t.ah * p.p2h,
        t.a2 * p.p2o,
        t.a2 * p.p2q,
        t.a3 * t.a3 * p.p33,
        t.a3 * t.ah * p.p3h,
        t.a3 * p.p3o,
        t.a3 * p.p3q,
        t.ah * t.ah * p.phh,
        t.ah * p.pho,
        t.ah * p.phq,
        p.poo,
        p.poq,
        p.pqq,
    )


@inline
def branches_noisy(p: AdaptiveCovariance, w1: float, w2: float, w3: float) -> AdaptiveCovariance:
    """What each branch gains by itself."""
    return AdaptiveCovariance(
        p.ss,
        p.s1,
        p.s2,
        p.s3,
        p.sh,
        p.so,
        p.sq,
        p.p11 + w1,
        p.p12,
        p.p13,
        p.p1h,
        p.p1o,
        p.p1q,
        p.p22 + w2,
        p.p23,
        p.p2h,
        p.p2o,
        p.p2q,
        p.p33 + w3,
        p.p3h,
        p.p3o,
        p.p3q,
        p.phh,
        p.pho,
        p.phq,
        p.poo,
        p.poq,
        p.pqq,
    )


@inline
def noisy(
    p: AdaptiveCovariance,
    t: Transition,
    soc_A2: float,
    branch_A2: float,
    ws: float,
    w1: float,
    w2: float,
    w3: float,
) -> AdaptiveCovariance:
    """A current of unknown size drives what the current drives; w is what each gains alone."""
    return AdaptiveCovariance(
        p.ss + (soc_A2 * t.gs * t.gs + ws),
        p.s1 + soc_A2 * t.gs * t.g1,
        p.s2 + soc_A2 * t.gs * t.g2,
        p.s3 + soc_A2 * t.gs * t.g3,
        p.sh,
        p.so,
        p.sq,
        p.p11 + (branch_A2 * t.g1 * t.g1 + w1),
        p.p12 + branch_A2 * t.g1 * t.g2,
        p.p13 + branch_A2 * t.g1 * t.g3,
        p.p1h,
        p.p1o,
        p.p1q,
        p.p22 + (branch_A2 * t.g2 * t.g2 + w2),
        p.p23 + branch_A2 * t.g2 * t.g3,
        p.p2h,
        p.p2o,
        p.p2q,
        p.p33 + (branch_A2 * t.g3 * t.g3 + w3),
        p.p3h,
        p.p3o,
        p.p3q,
        p.phh,
        p.pho,
        p.phq,
        p.poo,
        p.poq,
        p.pqq,
    )


@inline
def with_soc_variance(p: AdaptiveCovariance, ss: float) -> AdaptiveCovariance:
    """The same with another variance of SOC."""
    return AdaptiveCovariance(
        ss,
        p.s1,
        p.s2,
        p.s3,
        p.sh,
        p.so,
        p.sq,
        p.p11,
        p.p12,
        p.p13,
        p.p1h,
        p.p1o,
        p.p1q,
        p.p22,
        p.p23,
        p.p2h,
        p.p2o,
        p.p2q,
        p.p33,
        p.p3h,
        p.p3o,
        p.p3q,
        p.phh,
        p.pho,
        p.phq,
        p.poo,
        p.poq,
        p.pqq,
    )


@inline
def leaned(p: AdaptiveCovariance, f1: float, f2: float, f3: float) -> AdaptiveCovariance:
    """A SOC that is off drives the branches by the resistances' slopes: x_j += f_j soc."""
    return AdaptiveCovariance(
        p.ss,
        p.s1 + f1 * p.ss,
        p.s2 + f2 * p.ss,
        p.s3 + f3 * p.ss,
        p.sh,
        p.so,
        p.sq,
        p.p11 + f1 * (2.0 * p.s1 + f1 * p.ss),
        p.p12 + (f1 * p.s2 + f2 * p.s1 + f1 * f2 * p.ss),
        p.p13 + (f1 * p.s3 + f3 * p.s1 + f1 * f3 * p.ss),
        p.p1h + f1 * p.sh,
        p.p1o + f1 * p.so,
        p.p1q + f1 * p.sq,
        p.p22 + f2 * (2.0 * p.s2 + f2 * p.ss),
        p.p23 + (f2 * p.s3 + f3 * p.s2 + f2 * f3 * p.ss),
        p.p2h + f2 * p.sh,
        p.p2o + f2 * p.so,
        p.p2q + f2 * p.sq,
        p.p33 + f3 * (2.0 * p.s3 + f3 * p.ss),
        p.p3h + f3 * p.sh,
        p.p3o + f3 * p.so,
        p.p3q + f3 * p.sq,
        p.phh,
        p.pho,
        p.phq,
        p.poo,
        p.poq,
        p.pqq,
    )


@inline
def offset_driven(
    p: AdaptiveCovariance, cs: float, c1: float, c2: float, c3: float
) -> AdaptiveCovariance:
    """The sensor's offset drives what the current drives: x_i += c_i offset."""
    return AdaptiveCovariance(
        p.ss + cs * (2.0 * p.so + cs * p.poo),
        p.s1 + (cs * p.p1o + c1 * p.so + cs * c1 * p.poo),
        p.s2 + (cs * p.p2o + c2 * p.so + cs * c2 * p.poo),
        p.s3 + (cs * p.p3o + c3 * p.so + cs * c3 * p.poo),
        p.sh + cs * p.pho,
        p.so + cs * p.poo,
        p.sq + cs * p.poq,
        p.p11 + c1 * (2.0 * p.p1o + c1 * p.poo),
        p.p12 + (c1 * p.p2o + c2 * p.p1o + c1 * c2 * p.poo),
        p.p13 + (c1 * p.p3o + c3 * p.p1o + c1 * c3 * p.poo),
        p.p1h + c1 * p.pho,
        p.p1o + c1 * p.poo,
        p.p1q + c1 * p.poq,
        p.p22 + c2 * (2.0 * p.p2o + c2 * p.poo),
        p.p23 + (c2 * p.p3o + c3 * p.p2o + c2 * c3 * p.poo),
        p.p2h + c2 * p.pho,
        p.p2o + c2 * p.poo,
        p.p2q + c2 * p.poq,
        p.p33 + c3 * (2.0 * p.p3o + c3 * p.poo),
        p.p3h + c3 * p.pho,
        p.p3o + c3 * p.poo,
        p.p3q + c3 * p.poq,
        p.phh,
        p.pho,
        p.phq,
        p.poo,
        p.poq,
        p.pqq,
    )


@inline
def charge_driven(p: AdaptiveCovariance, cs: float) -> AdaptiveCovariance:
    """The capacity drives the SOC: soc += cs charge."""
    return AdaptiveCovariance(
        p.ss + cs * (2.0 * p.sq + cs * p.pqq),
        p.s1 + cs * p.p1q,
        p.s2 + cs * p.p2q,
        p.s3 + cs * p.p3q,
        p.sh + cs * p.phq,
        p.so + cs * p.poq,
        p.sq + cs * p.pqq,
        p.p11,
        p.p12,
        p.p13,
        p.p1h,
        p.p1o,
        p.p1q,
        p.p22,
        p.p23,
        p.p2h,
        p.p2o,
        p.p2q,
        p.p33,
        p.p3h,
        p.p3o,
        p.p3q,
        p.phh,
        p.pho,
        p.phq,
        p.poo,
        p.poq,
        p.pqq,
    )


@inline
def rejudged(
    p: AdaptiveCovariance, k: AdaptiveColumn, c: AdaptiveColumn, e: float
) -> AdaptiveCovariance:
    """P where a gain k of one slope is judged by another (Joseph): + e k k' - k c' - c k'."""
    return AdaptiveCovariance(
        p.ss + k.s * (k.s * e - 2.0 * c.s),
        p.s1 + (k.s * k.v1 * e - k.s * c.v1 - k.v1 * c.s),
        p.s2 + (k.s * k.v2 * e - k.s * c.v2 - k.v2 * c.s),
        p.s3 + (k.s * k.v3 * e - k.s * c.v3 - k.v3 * c.s),
        p.sh + (k.s * k.h * e - k.s * c.h - k.h * c.s),
        p.so,
        p.sq,
        p.p11 + k.v1 * (k.v1 * e - 2.0 * c.v1),
        p.p12 + (k.v1 * k.v2 * e - k.v1 * c.v2 - k.v2 * c.v1),
        p.p13 + (k.v1 * k.v3 * e - k.v1 * c.v3 - k.v3 * c.v1),
        p.p1h + (k.v1 * k.h * e - k.v1 * c.h - k.h * c.v1),
        p.p1o,
        p.p1q,
        p.p22 + k.v2 * (k.v2 * e - 2.0 * c.v2),
        p.p23 + (k.v2 * k.v3 * e - k.v2 * c.v3 - k.v3 * c.v2),
        p.p2h + (k.v2 * k.h * e - k.v2 * c.h - k.h * c.v2),
        p.p2o,
        p.p2q,
        p.p33 + k.v3 * (k.v3 * e - 2.0 * c.v3),
        p.p3h + (k.v3 * k.h * e - k.v3 * c.h - k.h * c.v3),
        p.p3o,
        p.p3q,
        p.phh + k.h * (k.h * e - 2.0 * c.h),
        p.pho,
        p.phq,
        p.poo,
        p.poq,
        p.pqq,
    )


@inline
def with_parameters(
    p: AdaptiveCovariance, poo: float, poq: float, pqq: float
) -> AdaptiveCovariance:
    """The same with other variances of offset and capacity."""
    return AdaptiveCovariance(
        p.ss,
        p.s1,
        p.s2,
        p.s3,
        p.sh,
        p.so,
        p.sq,
        p.p11,
        p.p12,
        p.p13,
        p.p1h,
        p.p1o,
        p.p1q,
        p.p22,
        p.p23,
        p.p2h,
        p.p2o,
        p.p2q,
        p.p33,
        p.p3h,
        p.p3o,
        p.p3q,
        p.phh,
        p.pho,
        p.phq,
        poo,
        poq,
        pqq,
    )


@inline
def offset_column(p: AdaptiveCovariance) -> AdaptiveColumn:
    """Covariance of every state with the offset."""
    return AdaptiveColumn(p.so, p.p1o, p.p2o, p.p3o, p.pho, p.poo, p.poq)


@inline
def charge_column(p: AdaptiveCovariance) -> AdaptiveColumn:
    """Covariance of every state with the charge."""
    return AdaptiveColumn(p.sq, p.p1q, p.p2q, p.p3q, p.phq, p.poq, p.pqq)


@inline
def column(
    p: AdaptiveCovariance, slope_V: float, m_V: float, fast: float, r0_ohm: float
) -> AdaptiveColumn:
    """P H', the covariance of every state with the voltage."""
    s = (slope_V * p.ss + m_V * p.sh) + (r0_ohm * p.so - (fast * p.s1 + (p.s2 + p.s3)))
    v1 = (slope_V * p.s1 + m_V * p.p1h) + (r0_ohm * p.p1o - (fast * p.p11 + (p.p12 + p.p13)))
    v2 = (slope_V * p.s2 + m_V * p.p2h) + (r0_ohm * p.p2o - (fast * p.p12 + (p.p22 + p.p23)))
    v3 = (slope_V * p.s3 + m_V * p.p3h) + (r0_ohm * p.p3o - (fast * p.p13 + (p.p23 + p.p33)))
    h = (slope_V * p.sh + m_V * p.phh) + (r0_ohm * p.pho - (fast * p.p1h + (p.p2h + p.p3h)))
    o = (slope_V * p.so + m_V * p.pho) + (r0_ohm * p.poo - (fast * p.p1o + (p.p2o + p.p3o)))
    q = (slope_V * p.sq + m_V * p.phq) + (r0_ohm * p.poq - (fast * p.p1q + (p.p2q + p.p3q)))
    return AdaptiveColumn(s, v1, v2, v3, h, o, q)


@inline
def explained(d: AdaptiveColumn, slope_V: float, m_V: float, fast: float, r0_ohm: float) -> float:
    """H P H', the variance of the voltage that the state explains [V^2]."""
    return (slope_V * d.s + m_V * d.h) + (r0_ohm * d.o - (fast * d.v1 + (d.v2 + d.v3)))


@inline
def scaled(d: AdaptiveColumn, factor: float) -> AdaptiveColumn:
    """A column times a number: a gain."""
    return AdaptiveColumn(
        d.s * factor,
        d.v1 * factor,
        d.v2 * factor,
        d.v3 * factor,
        d.h * factor,
        d.o * factor,
        d.q * factor,
    )


@inline
def corrected(p: AdaptiveCovariance, k: AdaptiveColumn, d: AdaptiveColumn) -> AdaptiveCovariance:
    """P - k d', d = P H', after a voltage with the gain k."""
    return AdaptiveCovariance(
        max(p.ss - k.s * d.s, VARIANCE_FLOOR),
        p.s1 - k.s * d.v1,
        p.s2 - k.s * d.v2,
        p.s3 - k.s * d.v3,
        p.sh - k.s * d.h,
        p.so - k.s * d.o,
        p.sq - k.s * d.q,
        max(p.p11 - k.v1 * d.v1, 0.0),
        p.p12 - k.v1 * d.v2,
        p.p13 - k.v1 * d.v3,
        p.p1h - k.v1 * d.h,
        p.p1o - k.v1 * d.o,
        p.p1q - k.v1 * d.q,
        max(p.p22 - k.v2 * d.v2, 0.0),
        p.p23 - k.v2 * d.v3,
        p.p2h - k.v2 * d.h,
        p.p2o - k.v2 * d.o,
        p.p2q - k.v2 * d.q,
        max(p.p33 - k.v3 * d.v3, 0.0),
        p.p3h - k.v3 * d.h,
        p.p3o - k.v3 * d.o,
        p.p3q - k.v3 * d.q,
        max(p.phh - k.h * d.h, 0.0),
        p.pho - k.h * d.o,
        p.phq - k.h * d.q,
        max(p.poo - k.o * d.o, 0.0),
        p.poq - k.o * d.q,
        max(p.pqq - k.q * d.q, 0.0),
    )


@inline
def soc_row(p: AdaptiveCovariance, factor: float) -> AdaptiveColumn:
    """SOC's row of P times a number."""
    return AdaptiveColumn(
        p.ss * factor,
        p.s1 * factor,
        p.s2 * factor,
        p.s3 * factor,
        p.sh * factor,
        p.so * factor,
        p.sq * factor,
    )
