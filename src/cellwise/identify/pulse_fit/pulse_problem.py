"""A pulse window as the compiled kernels see it, and the range in which tau is searched."""

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
from cellwise.identify.pulse_fit.pulse_parameters import PulseTrend, TauBounds
from cellwise.identify.pulse_fit.varpro_kernels import Window, predict
from cellwise.typing import BoolArray, FloatArray

FASTEST_TAU_S = 0.5


class Problem(NamedTuple):
    """A window's channels, arrays of shape (n,)."""

    dt: FloatArray
    current: FloatArray
    known: FloatArray  # voltage minus tabulated OCV change minus `reference_V`
    dq: FloatArray
    weight: FloatArray
    trend: FloatArray
    centre: float  # dq at the pulse's mean SOC
    reference_V: float  # taken off so that sums of squares do not cancel

    @property
    def window(self) -> Window:
        """The channels as the kernels take them."""
        return Window(*self[:7])


class Solution(NamedTuple):
    """A minimum, with all that its statistics need.

    Linear unknowns: OCV minus reference, OCV slope, R0, R1, R2, three bends of the OCV, V1 and V2
    at the window's first row.
    """

    cost: float
    log_tau: FloatArray  # (2,)
    coefficients: FloatArray  # (10,)
    include: BoolArray  # (10,) which unknowns the model has
    gram: FloatArray  # (15, 15) weighted products of all columns
    passes: int
    converged: bool


def build_problem(data: PulseData, weighting: Weighting, trend: PulseTrend) -> Problem:
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
        np.array(trend, dtype=np.float64),
        data.pulse_centre,
        reference,
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


def residual_V(problem: Problem, log_tau: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Measured minus modelled voltage [V], shape (n,)."""
    model = np.empty_like(problem.dt)
    tau1, tau2 = np.exp(log_tau)
    predict(problem.window, tau1, tau2, coefficients, model)
    return np.subtract(problem.known, model)
