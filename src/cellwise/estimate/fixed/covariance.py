"""Covariance of the fixed step: what a step does to P and to the state through it.

Each function is a loop over the states, written out for numba and for C with every entry under the
option of its states (:mod:`cellwise.cell.unrolled`).
"""

from __future__ import annotations

from typing import Any

from cellwise.cell.description import BRANCHES, CARRIED, CELL, SOC, H, triangle
from cellwise.cell.unrolled import unrolled_by_option
from cellwise.estimate.equations.covariance import Column, forget_correlations
from cellwise.estimate.equations.evidence import covariance_by_soc
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.lookup import Point, Slopes


def add_variance(x: State, value: float) -> None:
    """A variance of SOC that is large changes by less than rounding keeps of it."""
    if WIDE:
        x.ss, x.ss_carry = add(x.ss, x.ss_carry, value)
    else:
        x.ss = x.ss + value


@unrolled_by_option
def covariance_is_sound(x: State) -> bool:
    """Every entry in its range. A variance of SOC is never 0: that is memory that was cleared."""
    for i, j in triangle(CELL):
        if i == j:
            if i == SOC:
                if not positive_within(x.p[i, j], VARIANCE_FLOOR, LARGE):
                    return False
            else:
                if not not_negative(x.p[i, j], LARGE):
                    return False
        else:
            if not size_within(x.p[i, j], LARGE):
                return False
    return True


@unrolled_by_option
def start_covariance(x: State, soc_variance: float) -> None:
    """SOC known with a variance, branches at rest, nothing known of hysteresis."""
    forget_correlations(x)
    x.ss = soc_variance
    for i in BRANCHES:
        x.p[i, i] = 0.0
    for i in (H,):
        x.p[i, i] = 1.0


@unrolled_by_option
def relax(
    x: State,
    p: Point,
    gain1: float,
    gain2: float,
    gain3: SlowFloat,
    counted_current_A: float,
    square_A2: float,
) -> None:
    """The branches over one interval of constant current, exactly, and their covariance.

    A current that is not known to ``square_A2`` drives them too; 1 - a^2 keeps the stationary
    spread independent of the time step. What decays slowly is stated by how much it loses: 1 - 1e-5
    as a float is off by 0.3 % of that.
    """
    gain: dict[Any, float] = {}  # as handed over
    a: dict[Any, float] = {}
    for i in BRANCHES:
        a[i] = 1.0 - gain[i]
        if i in CARRIED:
            x.state[i], x.carry[i] = add(
                x.state[i], x.carry[i], gain[i] * ((p.r[i] * counted_current_A) - x.state[i])
            )
        else:
            x.state[i] = x.state[i] + (gain[i] * ((p.r[i] * counted_current_A) - x.state[i]))
        for j in (SOC, H):
            x.p[i, j] = x.p[i, j] - (gain[i] * x.p[i, j])
        x.p[i, i] = x.p[i, i] + (
            (gain[i] * (1.0 + a[i])) * ((square_A2 * (p.r[i] * p.r[i])) - x.p[i, i])
        )
    for i, j in triangle(BRANCHES):
        if i != j:
            x.p[i, j] = x.p[i, j] - ((gain[i] + (gain[j] * a[i])) * x.p[i, j])


@unrolled_by_option
def fade_hysteresis(x: State, keep: float) -> None:
    """The row of h where a share of h is kept."""
    for i in (H,):
        for j in (SOC, *BRANCHES):
            x.p[i, j] = keep * x.p[i, j]
        x.p[i, i] = (keep * keep) * x.p[i, i]


@unrolled_by_option
def forget_hysteresis(x: State) -> None:
    """Nothing is known of h."""
    for i in (H,):
        for j in (SOC, *BRANCHES):
            x.p[i, j] = 0.0
        x.p[i, i] = 1.0


@unrolled_by_option
def tilt(x: State, p: Point, slopes: Slopes, counted_current_A: float) -> None:
    """A SOC that is off drives the branches by the resistances' slopes."""
    f: dict[Any, float] = {}
    after: dict[Any, float] = {}
    for i in BRANCHES:
        f[i] = (slopes.rise[i] * p.gain[i]) * counted_current_A
        after[i] = x.p[SOC, i] + (f[i] * x.ss)
    for i, j in triangle(BRANCHES):
        x.p[i, j] = x.p[i, j] + covariance_by_soc(f[i], f[j], x.p[SOC, i], after[j])
    for i in BRANCHES:
        for j in (H,):
            x.p[i, j] = x.p[i, j] + (f[i] * x.p[SOC, j])
        x.p[SOC, i] = after[i]


@unrolled_by_option
def move(x: State, k: Column, innovation_V: float) -> None:
    """State + K innovation."""
    for i in CELL:
        if i in CARRIED:
            x.state[i], x.carry[i] = add(x.state[i], x.carry[i], k.row[i] * innovation_V)
        else:
            x.state[i] = x.state[i] + (k.row[i] * innovation_V)
    for i in (H,):
        x.state[i] = clip(x.state[i], -1.0, 1.0)


@unrolled_by_option
def narrow(x: State, k: Column, d: Column) -> None:
    """P - K d', row by row."""
    for i in CELL:
        for j in CELL[CELL.index(i) :]:
            if i == j == SOC:
                add_variance(x, -(k.s * d.s))
                x.ss = clip(x.ss, VARIANCE_FLOOR, LARGE) if WIDE else at_least(x.ss, VARIANCE_FLOOR)
            elif i == j:
                x.p[i, j] = at_least(x.p[i, j] - (k.row[i] * d.row[j]), 0.0)
            else:
                x.p[i, j] = x.p[i, j] - (k.row[i] * d.row[j])
