"""Parameters of pulses: one interface for three methods, and all pulses of a test together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.papers.segments import SegmentOptions, fit_segments
from cellwise.identify.papers.swarm import SwarmOptions, fit_swarm
from cellwise.identify.pulse_fit.pulse_data import PulseData
from cellwise.identify.pulse_fit.pulse_parameters import (
    PulseFit,
    PulseParameters,
    PulseTrend,
    TauBounds,
)
from cellwise.identify.pulse_fit.varpro import VarproOptions, fit_varpro
from cellwise.typing import FloatArray

Method = Literal["varpro", "segments", "pso"]
Options = VarproOptions | SegmentOptions | SwarmOptions


class _Trend(NamedTuple):
    """How neighbouring pulses show the change of the parameters with SOC."""

    level_gap: float = 0.03  # SOC: pulses closer than this belong to one level
    reach: float = 1.3  # bandwidth over the distance to the second other level
    error_floor: float = 0.02  # relative: scatter between pulses beyond their standard errors
    steepest: float = 20.0  # d log / d SOC; no cell changes tenfold in 12 % of SOC
    tolerance: float = 1e-3  # of the residual: a trend too small to be felt is still better


TREND = _Trend()
_NAMES = ("r0_ohm", "r1_ohm", "r2_ohm", "tau1_s", "tau2_s")

__all__ = [
    "PulseFit",
    "PulseParameters",
    "PulseTrend",
    "SegmentOptions",
    "SwarmOptions",
    "TauBounds",
    "VarproOptions",
    "fit_pulse",
    "fit_pulses",
]

_OPTIONS: dict[str, type[Options]] = {
    "varpro": VarproOptions,
    "segments": SegmentOptions,
    "pso": SwarmOptions,
}


def fit_pulse(
    data: PulseData,
    method: Method = "varpro",
    options: Options | None = None,
    *,
    trend: PulseTrend | None = None,
    rng: np.random.Generator | None = None,
) -> PulseFit:
    """Parameters of one pulse.

    Parameters
    ----------
    data : PulseData          see `cut_pulse`
    method : str              ``varpro``: least squares by variable projection (default);
                              ``segments``: closed formulas on three points; ``pso``: swarm
    options : VarproOptions, SegmentOptions or SwarmOptions       those of the method
    trend : PulseTrend        change of the parameters with SOC, for ``varpro`` only
    rng : numpy Generator     for ``pso``; by default one seeded with 0

    Returns
    -------
    PulseFit

    Raises
    ------
    InputError        unknown method, options of another method
    """
    if method not in _OPTIONS:
        raise InputError(
            f"method {method!r}", "'varpro', 'segments' or 'pso'", "Choose one of the three."
        )
    if options is not None and type(options) is not _OPTIONS[method]:
        raise InputError(
            f"{type(options).__name__} for method {method!r}",
            _OPTIONS[method].__name__,
            "Give the options of the method.",
        )
    if isinstance(options, SegmentOptions) or method == "segments":
        return fit_segments(data, options if isinstance(options, SegmentOptions) else None)
    if isinstance(options, SwarmOptions) or method == "pso":
        chosen = options if isinstance(options, SwarmOptions) else None
        return fit_swarm(data, chosen, rng or np.random.default_rng(0))
    return fit_varpro(data, options, trend)


def fit_pulses(
    pulses: Sequence[PulseData],
    method: Method = "varpro",
    options: Options | None = None,
    *,
    use_trend: bool = True,
    rng: np.random.Generator | None = None,
) -> list[PulseFit]:
    """Parameters of all pulses of a test.

    With ``varpro`` in two passes: each pulse by itself; then again, with the
    change of the parameters over SOC taken from its neighbours (see `local_trends`). A strong
    pulse near empty moves every parameter by some percent, which is the error without the second
    pass.

    Parameters
    ----------
    pulses : sequence of PulseData        of one cell at one temperature
    method, options, rng                  as in `fit_pulse`
    use_trend : bool                      False: first pass only

    Returns
    -------
    list of PulseFit          in the order given

    Raises
    ------
    InputError        as `fit_pulse`
    """
    rng = rng or np.random.default_rng(0)
    fits = [fit_pulse(data, method, options, rng=rng) for data in pulses]
    if method != "varpro" or not use_trend:
        return fits
    chosen = options if isinstance(options, VarproOptions) else None
    trends = local_trends(fits)
    return [
        fit if trend is None else _with_trend(data, fit, chosen, trend)
        for data, fit, trend in zip(pulses, fits, trends, strict=True)
    ]


def _with_trend(
    data: PulseData, alone: PulseFit, options: VarproOptions | None, trend: PulseTrend
) -> PulseFit:
    """The pulse fitted with its neighbours' trend, unless it fits worse than alone.

    On a real cell a trend between levels need not hold inside a pulse.
    """
    second = fit_varpro(data, options, trend, (alone.tau1_s, alone.tau2_s))
    return second if second.rmse_V <= (1.0 + TREND.tolerance) * alone.rmse_V else alone


def local_trends(fits: Sequence[PulseFit]) -> list[PulseTrend | None]:
    """Relative slope of each parameter over SOC at each pulse.

    Weighted local regression of log(parameter) on SOC (Cleveland's loess, tricube weights,
    doi:10.1080/01621459.1979.10481038), of second degree where three SOC levels are in reach, of
    first degree with two. Pulses that do not identify a parameter have no say in it.

    Returns
    -------
    list of PulseTrend or None        None where SOC is unknown or there is only one level
    """
    soc = np.array([fit.soc for fit in fits])
    if len(fits) < 2 or not np.all(np.isfinite(soc)):
        return [None] * len(fits)
    levels = _levels(soc)
    if len(levels) < 2:
        return [None] * len(fits)
    slopes = np.zeros((len(fits), len(_NAMES)))
    for column, name in enumerate(_NAMES):
        value = np.array([getattr(fit.value, name) for fit in fits])
        error = np.array([getattr(fit.error, name) for fit in fits])
        known = np.array([getattr(fit.identified, name) > 0.0 for fit in fits])
        if np.count_nonzero(known) < 3:
            continue
        relative = error[known] / value[known]
        weight = 1.0 / (relative**2 + TREND.error_floor**2)
        for row, at in enumerate(soc):
            reach = _reach(levels, at)
            slopes[row, column] = _slope(soc[known], np.log(value[known]), weight, at, reach)
    return [PulseTrend(*np.clip(row, -TREND.steepest, TREND.steepest).tolist()) for row in slopes]


def _levels(soc: FloatArray) -> FloatArray:
    """Mean SOC of each group of pulses that lie together."""
    ordered = np.sort(soc)
    groups = np.split(ordered, np.flatnonzero(np.diff(ordered) > TREND.level_gap) + 1)
    return np.array([np.mean(group) for group in groups])


def _reach(levels: FloatArray, at: float) -> float:
    """Bandwidth that takes in the pulse's own level and two others, where there are two."""
    distance = np.sort(np.abs(levels - at))
    return TREND.reach * float(distance[min(2, distance.size - 1)])


def _slope(
    soc: FloatArray, log_value: FloatArray, weight: FloatArray, at: float, reach: float
) -> float:
    """Slope of the local polynomial at one SOC, shrunk as far as its scatter leaves it uncertain.

    Shrunk by 1 - 1/t^2, with t the slope over its standard error: a slope below its error is none.
    """
    offset = (soc - at) / reach
    near = np.abs(offset) < 1.0
    if not near.any():
        return 0.0
    degree = min(2, _levels(soc[near]).size - 1)
    freedom = np.count_nonzero(near) - degree - 1
    if degree < 1 or freedom < 1:
        return 0.0
    x = offset[near]
    weight = weight[near] * (1.0 - np.abs(x) ** 3) ** 3
    columns = np.vander(x, degree + 1, increasing=True)
    inverse = np.linalg.pinv(columns.T @ (columns * weight[:, None]))
    solution = inverse @ (columns.T @ (weight * log_value[near]))
    residual = log_value[near] - columns @ solution
    variance = float(np.sum(weight * residual**2)) / freedom * inverse[1, 1]
    slope = float(solution[1])
    if slope * slope <= variance:
        return 0.0
    return float(slope * (1.0 - variance / (slope * slope)) / reach)
