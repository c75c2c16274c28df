"""Covariance of the filters over SOC, branches and hysteresis: its upper triangle, as scalars.

Each function is a loop over the states, written out before it is compiled
(:mod:`cellwise.cell.unrolled`): in arrays a step takes half as long again. A test holds each
against the matrices that its first line names.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES, CELL, SOC, H, entry, triangle
from cellwise.cell.unrolled import row, unrolled
from cellwise.estimate.equations.constants import VARIANCE_FLOOR
from cellwise.estimate.equations.covariance import Column
from cellwise.estimate.equations.evidence import covariance_by_soc

# The upper triangle of P over the states, ss, s1 ... phh; one number for each of them, one for each
# branch. What follows from the table of states no type checker sees.
if TYPE_CHECKING:
    Covariance: TypeAlias = Any
    Branches: TypeAlias = Any
    CellState: TypeAlias = Any
    Transition: TypeAlias = Any
else:
    from cellwise.cell.equations import CellState, Transition

    Covariance = NamedTuple("Covariance", [(entry(a, b), float) for a, b in triangle(CELL)])
    Branches = NamedTuple("Branches", [(row(s), float) for s in BRANCHES])


@inline
@unrolled
def no_branches() -> Branches:
    """A zero for each branch."""
    return Branches(*(0.0 for i in BRANCHES))


@inline
@unrolled
def uncorrelated(ss: float, v: Branches, hh: float) -> Covariance:
    """States of these variances that know nothing of each other."""
    return Covariance(
        *(
            0.0 if i != j else v.row[i] if i in BRANCHES else ss if i == SOC else hh
            for i, j in triangle(CELL)
        )
    )


@inline
@unrolled
def decayed(p: Covariance, t: Transition) -> Covariance:
    """A P A' with the diagonal transition A."""
    return Covariance(*(t.a[i] * t.a[j] * p[i, j] for i, j in triangle(CELL)))


@inline
@unrolled
def noisy(
    p: Covariance,
    t: Transition,
    soc_A2: float,
    branch_A2: float,
    ws: float,
    w: Branches,
) -> Covariance:
    """A current of unknown size drives what it drives; ws and w are what a state gains alone."""
    return Covariance(
        *(
            p[i, j]
            if not j.drive
            else p[i, j]
            + (
                (soc_A2 if i == SOC else branch_A2) * t.g[i] * t.g[j]
                + (ws if i == SOC else w.row[i])
            )
            if i == j
            else p[i, j] + (soc_A2 if i == SOC else branch_A2) * t.g[i] * t.g[j]
            for i, j in triangle(CELL)
        )
    )


@inline
@unrolled
def driven_by_soc(p: Covariance, f: Branches) -> Covariance:
    """A SOC that is off drives the branches by the resistances' slopes: x_j += f_j soc."""
    return Covariance(
        *(
            p[i, j]
            if i not in BRANCHES and j not in BRANCHES
            else p[i, j] + f.row[j] * p.ss
            if i == SOC
            else p[i, j] + f.row[i] * p[SOC, j]
            if j not in BRANCHES
            else p[i, j]
            + covariance_by_soc(f.row[i], f.row[j], p[SOC, i], p[SOC, j] + f.row[j] * p.ss)
            for i, j in triangle(CELL)
        )
    )


@inline
@unrolled
def with_soc_row(p: Covariance, ss: float, c: Column, factor: float) -> Covariance:
    """The same with another variance of SOC, and factor c as its covariances."""
    return Covariance(
        *(p[i, j] if i != SOC else ss if j == SOC else factor * c.row[j] for i, j in triangle(CELL))
    )


@inline
@unrolled
def without_outer(p: Covariance, c: Column) -> Covariance:
    """P - c c' among the states beside SOC: the covariance given the SOC."""
    return Covariance(
        *(p[i, j] if i == SOC else p[i, j] - c.row[i] * c.row[j] for i, j in triangle(CELL))
    )


@inline
@unrolled
def with_outer(p: Covariance, c: Column, share: float, e: Column) -> Covariance:
    """P + c c' + share e e' among the states beside SOC."""
    return Covariance(
        *(
            p[i, j] if i == SOC else p[i, j] + c.row[i] * c.row[j] + share * e.row[i] * e.row[j]
            for i, j in triangle(CELL)
        )
    )


@inline
@unrolled
def corrected(p: Covariance, k: Column, d: Column) -> Covariance:
    """P - k d', d = P H', after a voltage with the gain k."""
    return Covariance(
        *(
            p[i, j] - k.row[i] * d.row[j]
            if i != j
            else max(p[i, j] - k.row[i] * d.row[j], VARIANCE_FLOOR if i == SOC else 0.0)
            for i, j in triangle(CELL)
        )
    )


@inline
@unrolled
def moved(x: CellState, k: Column, innovation_V: float) -> CellState:
    """State + k innovation."""
    return CellState(
        *(
            x.state[i] + k.row[i] * innovation_V
            if i != H
            else min(max(x.state[i] + k.row[i] * innovation_V, -1.0), 1.0)
            for i in CELL
        ),
        x.heat_K,
        x.slow_A,
    )
