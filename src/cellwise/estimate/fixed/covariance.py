"""Covariance of the fixed step: where it starts, whether it is sound.

Each function is a loop over the states, written out for numba and for C with every entry under the
option of its states (:mod:`cellwise.cell.unrolled`).
"""

from __future__ import annotations

from cellwise.cell.description import BRANCHES, CELL, SOC, H, triangle
from cellwise.cell.unrolled import unrolled_by_option
from cellwise.estimate.equations.covariance import forget_correlations
from cellwise.estimate.fixed.arithmetic import *


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
def forget_hysteresis(x: State) -> None:
    """Nothing is known of h."""
    for i in (H,):
        for j in (SOC, *BRANCHES):
            x.p[i, j] = 0.0
        x.p[i, i] = 1.0
