"""Points of voltage over SOC, made ready for a fit: checked, thinned, grouped, led to the ends."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from cellwise.errors import InputError
from cellwise.typing import FloatArray


class _Points(NamedTuple):
    """What a curve is fitted to."""

    slope_V: float = 1e-3  # per unit of SOC: flatter carries no information, it keeps the sign
    fewest: int = 4
    most: int = 400  # a low-rate log has thousands of rows that say the same: so many are kept
    same_soc: float = 1e-4
    folds: int = 5
    stretch: float = 0.05  # below the lowest point: over so much SOC the slope may double


class _Levels(NamedTuple):
    """Rests that lie together are of one level."""

    most: int = 120  # more points than this are a low-rate curve, not rests
    close: float = 0.3  # of the widest step between rests


POINTS, LEVELS = _Points(), _Levels()


def checked_points(
    soc: FloatArray, voltage_V: FloatArray, weight: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points without missing values, by rising SOC, weights of mean 1.

    Raises
    ------
    InputError        unequal lengths, too few points, SOC far outside 0..1, all at one SOC,
                      voltage that does not rise with SOC
    """
    s = np.asarray(soc, dtype=np.float64)
    v = np.asarray(voltage_V, dtype=np.float64)
    w = np.ones(s.shape) if weight is None else np.asarray(weight, dtype=np.float64)
    if s.ndim != 1 or s.shape != v.shape or s.shape != w.shape:
        raise InputError(
            f"soc, voltage_V, weight of shapes {s.shape}, {v.shape}, {w.shape}",
            "three arrays of one length",
            "Give one voltage (and one weight) per SOC.",
        )
    good = np.isfinite(s) & np.isfinite(v) & (w > 0)
    s, v, w = s[good], v[good], w[good]
    if s.size < POINTS.fewest:
        raise InputError(
            f"{s.size} usable point(s) of OCV over SOC",
            f"at least {POINTS.fewest}",
            "Use a log with rests at more levels of SOC, or a low-rate discharge.",
        )
    order = np.argsort(s, kind="stable")
    s, v, w = s[order], v[order], w[order]
    if s[0] < -0.25 or s[-1] > 1.25:
        raise InputError(
            f"SOC from {s[0]:.3f} to {s[-1]:.3f} in the points of an OCV curve",
            "SOC within 0..1",
            "Check the capacity that SOC was counted with, and percent against fraction.",
        )
    if s[-1] - s[0] < 0.05 or np.polyfit(s, v, 1)[0] <= 0.0:
        raise InputError(
            f"OCV points from SOC {s[0]:.3f} to {s[-1]:.3f} whose voltage does not rise with SOC",
            "points spread over SOC, with the voltage rising",
            "Check the sign of the current: SOC must fall on discharge.",
        )
    return s, v, w / np.mean(w)


def condense(
    s: FloatArray, v: FloatArray, w: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Means of points that say the same: equal SOC, or more than 400 along the curve."""
    group: NDArray[np.intp] = np.append(0, np.cumsum(np.diff(s) > POINTS.same_soc))
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    if np.max(s[np.append(starts[1:], s.size) - 1] - s[starts]) > 10.0 * POINTS.same_soc:
        # Rows of a slow log lie so close that each says the same as the next, and all as one.
        group = np.append(0, np.cumsum(np.diff(np.floor((s - s[0]) / POINTS.same_soc)) > 0))
    if group[-1] >= POINTS.most:
        rising = isotonic_regression(v, weights=w).x
        length = np.append(0.0, np.cumsum(np.hypot(np.diff(s), np.diff(rising) / np.ptp(rising))))
        bins = (length / length[-1] * (POINTS.most - 1)).astype(np.intp)
        group = np.append(0, np.cumsum((np.diff(bins) > 0) & (np.diff(s) > 0.0)))
    total: FloatArray = np.bincount(group, w).astype(np.float64)
    return np.bincount(group, w * s) / total, np.bincount(group, w * v) / total, total


def leave_out_turns(s: FloatArray) -> NDArray[np.intp]:
    """Turn at which each point is left out, shape (n,).

    Rests that lie close together, as those between the pulses of one level do, take one turn
    together: a neighbour a millivolt away would predict anything.
    """
    group = np.arange(s.size)
    if s.size <= LEVELS.most:
        step = np.diff(s)
        levels = np.append(0, np.cumsum(step > LEVELS.close * np.max(step)))
        group = levels if levels[-1] >= POINTS.fewest + 1 else group
    return np.asarray(group % min(POINTS.folds, int(group[-1]) - 1))


def beyond_ends(
    evaluate: Callable[[FloatArray], FloatArray], first: float, last: float
) -> tuple[FloatArray, FloatArray]:
    """Points that carry a curve known over [first, last] on to SOC 0 and 1.

    Upward straight on. Downward the slope goes on growing as it does at the end, up to twofold
    per 5 % of SOC: on measured low-rate curves of NCA, NMC, LMO and LFP, cut off at 5 %,
    that halves the straight line's error.
    """
    h = min(POINTS.stretch, (last - first) / 3.0)
    s_end, v_end = np.zeros(0), np.zeros(0)
    if first > 0.0:
        v0, v1, v2 = evaluate(first + h * np.arange(3.0))
        growth = np.log(np.clip((v1 - v0) / max(v2 - v1, 1e-9), 1.0, 2.0)) / h
        steep = (v1 - v0) / h * np.exp(growth * h / 2.0)
        d = first * (1.0 - np.arange(np.ceil(first / 0.01)) / np.ceil(first / 0.01))
        s_end = first - d
        v_end = v0 - steep * (np.expm1(growth * d) / growth if growth > 1e-6 else d)
    if last < 1.0:
        v0, v1 = evaluate(np.array([last - h, last]))
        d = (
            (1.0 - last)
            * (1.0 + np.arange(np.ceil((1.0 - last) / 0.01)))
            / np.ceil((1.0 - last) / 0.01)
        )
        s_end = np.append(s_end, last + d)
        v_end = np.append(v_end, v1 + d * max((v1 - v0) / h, POINTS.slope_V))
    return s_end, v_end


def strictly_rising(s: FloatArray, v: FloatArray, w: FloatArray | None = None) -> FloatArray:
    """The rising sequence nearest to ``v``, rising by at least the least slope."""
    level = POINTS.slope_V * s
    return np.asarray(isotonic_regression(v - level, weights=w).x + 1.001 * level)
