"""What a covariance says of a voltage, for every filter and for the C.

``x`` holds the upper triangle of P by its entries: a record of a state, or a named tuple.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES, CELL, SOC, V3, H, triangle
from cellwise.cell.unrolled import THERE, unrolled_by_option

SLOW = HYSTERESIS = True  # states that a fixed step may do without
SlowFloat: TypeAlias = Any
HysteresisFloat: TypeAlias = Any
State: TypeAlias = Any


class Column(NamedTuple):
    """P H', the covariance of every state with the voltage, or a gain."""

    s: float
    v1: float
    v2: float
    v3: SlowFloat
    h: HysteresisFloat

    @property
    def row(self) -> dict[Any, float]:
        """By the state."""
        return dict(zip(CELL, self, strict=True))


@inline
@unrolled_by_option
def column_of(x: State, slope_V: float, m_V: HysteresisFloat) -> Column:
    """P H' with H = [slope, -1, -1, -1, m]."""
    c: dict[Any, float] = {}
    for i in CELL:
        c[i] = (slope_V * x.p[SOC, i]) if THERE else 0.0
        for j in BRANCHES:
            c[i] = c[i] - x.p[i, j]
        for j in (H,):
            c[i] = c[i] + (m_V * x.p[i, j])
    return Column(*(c[i] for i in CELL))


@inline
@unrolled_by_option
def explained(d: Column, slope_V: float, m_V: HysteresisFloat) -> float:
    """H P H', the variance of the voltage that the state explains [V^2]."""
    variance = slope_V * d.s
    for j in BRANCHES:
        variance = variance - d.row[j]
    for j in (H,):
        variance = variance + (m_V * d.row[j])
    return variance if variance > 0.0 else 0.0


@inline
@unrolled_by_option
def scaled(d: Column, factor: float) -> Column:
    """A column times a number: a gain."""
    return Column(*((d.row[i] * factor) if THERE else 0.0 for i in CELL))


@inline
@unrolled_by_option
def column_of_slow_branch(x: State) -> Column:
    """P H' where the slow branch itself is measured."""
    c: dict[Any, float] = {}
    for i in CELL:
        c[i] = x.p[i, V3] if THERE else 0.0
    return Column(*(c[i] for i in CELL))


@inline
@unrolled_by_option
def forget_correlations(x: State) -> None:
    """Only the diagonal stays."""
    for i, j in triangle(CELL):
        if i != j:
            x.p[i, j] = 0.0
