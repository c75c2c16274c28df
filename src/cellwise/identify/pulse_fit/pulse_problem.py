"""A pulse window as a linear problem at given time constants, and the range of these."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.pulse_fit.pulse_data import (
    LEAST_SETTLED_ROWS,
    PulseData,
    Weighting,
    row_weights,
)
from cellwise.identify.pulse_fit.pulse_kernels import branch_response
from cellwise.identify.pulse_fit.pulse_parameters import PulseTrend, TauBounds
from cellwise.typing import BoolArray, FloatArray

FASTEST_TAU_S = 0.5
# Unknowns that enter linearly, in the order of the columns: the OCV and its slope, resistances,
# what the branches held at the window's first row, powers of the OCV inside the pulse.
UNKNOWNS = ("ocv", "slope", "r0", "r1", "r2", "v1", "v2", "bend2", "bend3", "bend4")


NO_TREND = PulseTrend()


class Problem(NamedTuple):
    """A window's channels, arrays of shape (n,)."""

    dt: FloatArray
    current: FloatArray
    known: FloatArray  # voltage minus tabulated OCV change minus `reference_V`
    dq: FloatArray
    weight: FloatArray
    centre: float  # dq at the pulse's mean SOC
    reference_V: float  # taken off so that sums of squares do not cancel
    trend: PulseTrend = NO_TREND


class Solution(NamedTuple):
    """A minimum, with all that its statistics need."""

    cost: float  # weighted sum of squares [V^2]
    log_tau: FloatArray  # (2,)
    coefficients: FloatArray  # (10,) of `UNKNOWNS`; OCV minus reference
    include: BoolArray  # (10,) which unknowns the model has
    passes: int
    converged: bool


def build_problem(data: PulseData, weighting: Weighting, trend: PulseTrend = NO_TREND) -> Problem:
    """Channels of one window, weights included.

    Raises
    ------
    InputError        fewer rows that count than unknowns
    """
    known = data.voltage_V if data.ocv_change_V is None else data.voltage_V - data.ocv_change_V
    reference = float(np.mean(known[: max(data.start, 1)]))
    weight = row_weights(data, weighting)
    if np.count_nonzero(weight) < LEAST_SETTLED_ROWS:
        raise InputError(
            f"{np.count_nonzero(weight)} settled rows of {len(data)} in pulse '{data.name}'",
            f"at least {LEAST_SETTLED_ROWS} rows for 7 unknowns",
            "Log the pulse faster or longer, or leave it out.",
        )
    return Problem(
        data.interval_s,
        data.current_A.copy(),  # writable as the rest: kernels compile once, not twice
        known - reference,
        data.charge_fraction,
        weight,
        data.pulse_centre,
        reference,
        trend,
    )


def columns(
    problem: Problem, log_tau: FloatArray, include: BoolArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the voltage to the linear unknowns, and of those to log tau.

    Parameters
    ----------
    problem : Problem
    log_tau : (2,) float
    include : (10,) bool          unknowns whose columns are asked for; others may be zero

    Returns
    -------
    linear : (10, n) float        by `UNKNOWNS`
    of_tau : (4, n) float         of R1, R2, V1 and V2 to log tau of their own branch
    """
    n = problem.dt.size
    linear, of_tau = np.zeros((len(UNKNOWNS), n)), np.zeros((4, n))
    linear[0] = 1.0
    linear[1] = problem.centre - problem.dq
    # The state of charge halfway through each interval.
    halfway = linear[1] + 0.5 * np.diff(problem.dq, prepend=problem.dq[0])
    linear[2] = -_changed(problem.current, problem.trend.r0, linear[1])
    r_trends, tau_trends = problem.trend[1:3], problem.trend[3:]
    for branch, tau in enumerate(np.exp(log_tau)):
        u, du = linear[3 + branch], of_tau[branch]
        share = problem.dt / _changed(tau, tau_trends[branch], halfway)
        branch_response(share, _changed(problem.current, r_trends[branch], halfway), u, du)
        np.negative(u, out=u)
        np.negative(du, out=du)
        if include is None or include[6]:
            since = np.cumsum(share)
            linear[5 + branch] = -np.exp(-since)
            of_tau[2 + branch] = linear[5 + branch] * since
    if include is None or include[7]:
        for power in range(7, 10):
            linear[power] = linear[1] * linear[1 if power == 7 else power - 1]
    return linear, of_tau


def _changed(value: FloatArray, trend: float, soc_offset: FloatArray) -> FloatArray:
    """A parameter, or what it multiplies, at a SOC offset from the pulse's mean SOC.

    exp(trend * offset) to second order: positive for every trend.
    """
    if trend == 0.0:
        return value
    x = trend * soc_offset
    return np.asarray(value * (1.0 + x * (1.0 + 0.5 * x)))


def tau_slopes(of_tau: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Derivatives of the voltage to log tau1 and log tau2, shape (2, n) [V]."""
    each = of_tau * coefficients[3:7, None]
    return np.asarray(each[:2] + each[2:])


def residual_V(problem: Problem, log_tau: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Measured minus modelled voltage [V], shape (n,)."""
    return np.subtract(
        problem.known, coefficients @ columns(problem, log_tau, coefficients != 0.0)[0]
    )


def window_tau_bounds(data: PulseData) -> TauBounds:
    """Time constants that a window can show.

    From two sampling intervals (at most `FASTEST_TAU_S`, where sampling allows) to the time from
    the pulse's start to the window's end, or twice the pulse where no relaxation follows.
    """
    sampling = float(np.median(data.interval_s[data.start : data.stop]))
    fastest = max(min(2.0 * sampling, FASTEST_TAU_S), 0.5 * sampling, 1e-3)
    seen = float(data.time_s[-1] - data.time_s[max(data.start - 1, 0)])
    slowest = max(seen, 2.0 * data.pulse_duration_s, 4.0 * fastest)
    return TauBounds(fastest, slowest, fastest, slowest)


def log_limits(bounds: TauBounds) -> FloatArray:
    """Limits of log tau1 and log tau2 and their least distance, shape (5,), made consistent.

    Raises
    ------
    InputError        bounds that leave no room
    """
    low1, high1, low2, high2, ratio = (
        bounds.tau1_min_s, bounds.tau1_max_s, bounds.tau2_min_s, bounds.tau2_max_s, bounds.ratio,
    )  # fmt: skip
    ordered = 0.0 < low1 <= high1 and 0.0 < low2 <= high2 and ratio > 1.0
    if not (ordered and np.isfinite(high2) and low1 * ratio <= high2):
        raise InputError(
            f"time constants between {low1} and {high1} s, {low2} and {high2} s, ratio {ratio}",
            "0 < minimum <= maximum, ratio > 1, and room for tau2 >= ratio * tau1",
            "Widen the bounds.",
        )
    high1, low2 = min(high1, high2 / ratio), max(low2, low1 * ratio)
    limits: FloatArray = np.log(np.array([low1, high1, low2, high2, ratio]))
    return limits
