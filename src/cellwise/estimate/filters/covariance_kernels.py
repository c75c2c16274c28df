"""Covariance of the filters over SOC, branches and hysteresis: its upper triangle, as scalars.

Written by hand, entry by entry: in arrays a step takes half as long again. A test holds each
function against the matrices that its first line names.
"""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations import CellState, Transition

VARIANCE_FLOOR = 1e-12


class Covariance(NamedTuple):
    """Upper triangle of P over soc, v1_V, v2_V, v3_V, h."""

    ss: float
    s1: float
    s2: float
    s3: float
    sh: float
    p11: float
    p12: float
    p13: float
    p1h: float
    p22: float
    p23: float
    p2h: float
    p33: float
    p3h: float
    phh: float


class Column(NamedTuple):
    """One number for each state: P H', or a gain."""

    s: float  # state of charge
    v1: float  # voltage of the fast branch
    v2: float  # voltage of the second branch
    v3: float  # voltage of the slow branch
    h: float  # hysteresis, -1 to 1


@inline
def uncorrelated(ss: float, p11: float, p22: float, p33: float, phh: float) -> Covariance:
    """States that know nothing of each other."""
    return Covariance(ss, 0.0, 0.0, 0.0, 0.0, p11, 0.0, 0.0, 0.0, p22, 0.0, 0.0, p33, 0.0, phh)


@inline
def decayed(p: Covariance, t: Transition) -> Covariance:
    """A P A' with the diagonal transition A."""
    return Covariance(
        p.ss,
        t.a1 * p.s1,
        t.a2 * p.s2,
        t.a3 * p.s3,
        t.ah * p.sh,
        t.a1 * t.a1 * p.p11,
        t.a1 * t.a2 * p.p12,
        t.a1 * t.a3 * p.p13,
        t.a1 * t.ah * p.p1h,
        t.a2 * t.a2 * p.p22,
        t.a2 * t.a3 * p.p23,
        t.a2 * t.ah * p.p2h,
        t.a3 * t.a3 * p.p33,
        t.a3 * t.ah * p.p3h,
        t.ah * t.ah * p.phh,
    )


@inline
def noisy(
    p: Covariance,
    t: Transition,
    soc_A2: float,
    branch_A2: float,
    ws: float,
    w1: float,
    w2: float,
    w3: float,
) -> Covariance:
    """A current of unknown size drives what it drives; the w are what a state gains alone."""
    return Covariance(
        p.ss + (soc_A2 * t.gs * t.gs + ws),
        p.s1 + soc_A2 * t.gs * t.g1,
        p.s2 + soc_A2 * t.gs * t.g2,
        p.s3 + soc_A2 * t.gs * t.g3,
        p.sh,
        p.p11 + (branch_A2 * t.g1 * t.g1 + w1),
        p.p12 + branch_A2 * t.g1 * t.g2,
        p.p13 + branch_A2 * t.g1 * t.g3,
        p.p1h,
        p.p22 + (branch_A2 * t.g2 * t.g2 + w2),
        p.p23 + branch_A2 * t.g2 * t.g3,
        p.p2h,
        p.p33 + (branch_A2 * t.g3 * t.g3 + w3),
        p.p3h,
        p.phh,
    )


@inline
def driven_by_soc(p: Covariance, f1: float, f2: float, f3: float) -> Covariance:
    """A SOC that is off drives the branches by the resistances' slopes: x_j += f_j soc."""
    return Covariance(
        p.ss,
        p.s1 + f1 * p.ss,
        p.s2 + f2 * p.ss,
        p.s3 + f3 * p.ss,
        p.sh,
        p.p11 + f1 * (2.0 * p.s1 + f1 * p.ss),
        p.p12 + (f1 * p.s2 + f2 * p.s1 + f1 * f2 * p.ss),
        p.p13 + (f1 * p.s3 + f3 * p.s1 + f1 * f3 * p.ss),
        p.p1h + f1 * p.sh,
        p.p22 + f2 * (2.0 * p.s2 + f2 * p.ss),
        p.p23 + (f2 * p.s3 + f3 * p.s2 + f2 * f3 * p.ss),
        p.p2h + f2 * p.sh,
        p.p33 + f3 * (2.0 * p.s3 + f3 * p.ss),
        p.p3h + f3 * p.sh,
        p.phh,
    )


@inline
def with_soc_row(p: Covariance, ss: float, c: Column, factor: float) -> Covariance:
    """The same with another variance of SOC, and factor c as its covariances."""
    return Covariance(
        ss,
        factor * c.v1,
        factor * c.v2,
        factor * c.v3,
        factor * c.h,
        p.p11,
        p.p12,
        p.p13,
        p.p1h,
        p.p22,
        p.p23,
        p.p2h,
        p.p33,
        p.p3h,
        p.phh,
    )


@inline
def without_outer(p: Covariance, c: Column) -> Covariance:
    """P - c c' among the states beside SOC: the covariance given the SOC."""
    return Covariance(
        p.ss,
        p.s1,
        p.s2,
        p.s3,
        p.sh,
        p.p11 - c.v1 * c.v1,
        p.p12 - c.v1 * c.v2,
        p.p13 - c.v1 * c.v3,
        p.p1h - c.v1 * c.h,
        p.p22 - c.v2 * c.v2,
        p.p23 - c.v2 * c.v3,
        p.p2h - c.v2 * c.h,
        p.p33 - c.v3 * c.v3,
        p.p3h - c.v3 * c.h,
        p.phh - c.h * c.h,
    )


@inline
def with_outer(p: Covariance, c: Column, share: float, e: Column) -> Covariance:
    """P + c c' + share e e' among the states beside SOC."""
    return Covariance(
        p.ss,
        p.s1,
        p.s2,
        p.s3,
        p.sh,
        p.p11 + c.v1 * c.v1 + share * e.v1 * e.v1,
        p.p12 + c.v1 * c.v2 + share * e.v1 * e.v2,
        p.p13 + c.v1 * c.v3 + share * e.v1 * e.v3,
        p.p1h + c.v1 * c.h + share * e.v1 * e.h,
        p.p22 + c.v2 * c.v2 + share * e.v2 * e.v2,
        p.p23 + c.v2 * c.v3 + share * e.v2 * e.v3,
        p.p2h + c.v2 * c.h + share * e.v2 * e.h,
        p.p33 + c.v3 * c.v3 + share * e.v3 * e.v3,
        p.p3h + c.v3 * c.h + share * e.v3 * e.h,
        p.phh + c.h * c.h + share * e.h * e.h,
    )


@inline
def joseph(p: Covariance, k: Column, c: Column, e: float) -> Covariance:
    """P where a gain k of one slope is judged by another: + e k k' - k c' - c k'."""
    return Covariance(
        p.ss + k.s * (k.s * e - 2.0 * c.s),
        p.s1 + (k.s * k.v1 * e - k.s * c.v1 - k.v1 * c.s),
        p.s2 + (k.s * k.v2 * e - k.s * c.v2 - k.v2 * c.s),
        p.s3 + (k.s * k.v3 * e - k.s * c.v3 - k.v3 * c.s),
        p.sh + (k.s * k.h * e - k.s * c.h - k.h * c.s),
        p.p11 + k.v1 * (k.v1 * e - 2.0 * c.v1),
        p.p12 + (k.v1 * k.v2 * e - k.v1 * c.v2 - k.v2 * c.v1),
        p.p13 + (k.v1 * k.v3 * e - k.v1 * c.v3 - k.v3 * c.v1),
        p.p1h + (k.v1 * k.h * e - k.v1 * c.h - k.h * c.v1),
        p.p22 + k.v2 * (k.v2 * e - 2.0 * c.v2),
        p.p23 + (k.v2 * k.v3 * e - k.v2 * c.v3 - k.v3 * c.v2),
        p.p2h + (k.v2 * k.h * e - k.v2 * c.h - k.h * c.v2),
        p.p33 + k.v3 * (k.v3 * e - 2.0 * c.v3),
        p.p3h + (k.v3 * k.h * e - k.v3 * c.h - k.h * c.v3),
        p.phh + k.h * (k.h * e - 2.0 * c.h),
    )


@inline
def column(p: Covariance, slope_V: float, m_V: float) -> Column:
    """P H', the covariance of every state with the voltage."""
    s = (slope_V * p.ss + m_V * p.sh) - ((p.s1 + p.s2) + p.s3)
    v1 = (slope_V * p.s1 + m_V * p.p1h) - ((p.p11 + p.p12) + p.p13)
    v2 = (slope_V * p.s2 + m_V * p.p2h) - ((p.p12 + p.p22) + p.p23)
    v3 = (slope_V * p.s3 + m_V * p.p3h) - ((p.p13 + p.p23) + p.p33)
    h = (slope_V * p.sh + m_V * p.phh) - ((p.p1h + p.p2h) + p.p3h)
    return Column(s, v1, v2, v3, h)


@inline
def explained(d: Column, slope_V: float, m_V: float) -> float:
    """H P H', the variance of the voltage that the state explains [V^2]."""
    return (slope_V * d.s + m_V * d.h) - ((d.v1 + d.v2) + d.v3)


@inline
def scaled(d: Column, factor: float) -> Column:
    """A column times a number: a gain."""
    return Column(d.s * factor, d.v1 * factor, d.v2 * factor, d.v3 * factor, d.h * factor)


@inline
def corrected(p: Covariance, k: Column, d: Column) -> Covariance:
    """P - k d', d = P H', after a voltage with the gain k."""
    return Covariance(
        max(p.ss - k.s * d.s, VARIANCE_FLOOR),
        p.s1 - k.s * d.v1,
        p.s2 - k.s * d.v2,
        p.s3 - k.s * d.v3,
        p.sh - k.s * d.h,
        max(p.p11 - k.v1 * d.v1, 0.0),
        p.p12 - k.v1 * d.v2,
        p.p13 - k.v1 * d.v3,
        p.p1h - k.v1 * d.h,
        max(p.p22 - k.v2 * d.v2, 0.0),
        p.p23 - k.v2 * d.v3,
        p.p2h - k.v2 * d.h,
        max(p.p33 - k.v3 * d.v3, 0.0),
        p.p3h - k.v3 * d.h,
        max(p.phh - k.h * d.h, 0.0),
    )


@inline
def soc_row(p: Covariance, factor: float) -> Column:
    """SOC's row of P times a number."""
    return Column(p.ss * factor, p.s1 * factor, p.s2 * factor, p.s3 * factor, p.sh * factor)


@inline
def moved(x: CellState, k: Column, innovation_V: float) -> CellState:
    """State + k innovation."""
    return CellState(
        x.soc + k.s * innovation_V,
        x.v1_V + k.v1 * innovation_V,
        x.v2_V + k.v2 * innovation_V,
        x.v3_V + k.v3 * innovation_V,
        min(max(x.h + k.h * innovation_V, -1.0), 1.0),
        x.heat_K,
        x.slow_A,
    )
