"""How the parameters change with SOC at each pulse, read off the neighbouring pulses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellwise.identify.pulse_fit.pulse_parameters import PulseFit, PulseTrend
from cellwise.typing import FloatArray

LEVEL_GAP = 0.03  # SOC: pulses closer than this belong to one level
REACH = 1.3  # bandwidth over the distance to the second other level
ERROR_FLOOR = 0.02  # relative: scatter between pulses beyond their standard errors
STEEPEST = 20.0  # d log / d SOC; no cell changes tenfold in 12 % of SOC
_NAMES = ("r0_ohm", "r1_ohm", "r2_ohm", "tau1_s", "tau2_s")


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
        weight = 1.0 / (relative**2 + ERROR_FLOOR**2)
        for row, at in enumerate(soc):
            reach = _reach(levels, at)
            slopes[row, column] = _slope(soc[known], np.log(value[known]), weight, at, reach)
    return [PulseTrend(*np.clip(row, -STEEPEST, STEEPEST).tolist()) for row in slopes]


def _levels(soc: FloatArray) -> FloatArray:
    """Mean SOC of each group of pulses that lie together."""
    ordered = np.sort(soc)
    groups = np.split(ordered, np.flatnonzero(np.diff(ordered) > LEVEL_GAP) + 1)
    return np.array([np.mean(group) for group in groups])


def _reach(levels: FloatArray, at: float) -> float:
    """Bandwidth that takes in the pulse's own level and two others, where there are two."""
    distance = np.sort(np.abs(levels - at))
    return REACH * float(distance[min(2, distance.size - 1)])


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
