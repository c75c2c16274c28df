"""Levels of a current: runs of rows at one level, as far as the noise allows.

Loads between rests are cut in two where the current changes most, and the parts again, until a part
holds one level: nothing in it is a change, or none that the scatter of its rows would not make
(binary segmentation; Scott and Knott 1974, doi:10.2307/2529204). Each part has its own noise,
because the device that makes it may be another one.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.compiled import cached
from cellwise.typing import FloatArray

PhaseKind = Literal["rest", "cc", "cv", "dynamic"]
RowArray = NDArray[np.int64]


class _PlateauLimits(NamedTuple):
    """What separates the levels of a current: multiples of its noise, or shares of its range."""

    near_zero: float = 0.01  # of the range: up to here a steady reading may be the sensor's zero
    moving: float = 0.05  # of the range: noise or resolution that is more is a moving current
    rest: float = 1e-3  # of the range: nearer to zero it is a rest
    step: float = 2e-3  # of the range: the least change
    glitch: float = 0.1  # of a glitch: its neighbours differ by less
    coarse_rows: float = 0.01  # a resolution goes back and forth in at least this share of the rows
    flat: float = 0.01  # of a level: a held current may drift by so much
    slope: float = 0.1  # of a level: a smaller change may be the step of a slope
    knee: float = 1e-3  # of a level: as near to it is its last row before a slope


class _White(NamedTuple):
    """When the rows of a part are one level and noise, sigma that of their second differences.

    The sum of deviations from the mean, over sigma sqrt(n), is the bridge of Kolmogorov: of white
    noise 0.83 in the median, beyond 1.25 in one part of twelve, beyond 2 in one of 1,500.
    """

    rows: int = 32  # of a part whose noise can be known ...
    change: float = 4.0  # ... with noise that need not be white: so large a sum is a change
    scatter: float = 0.2  # of the level, at most: more is a drive
    few: float = 0.05  # of the level: the range of fewer rows whose sum is below half of that
    growth: float = 1.5  # of second differences at twice the distance: more is no noise
    alone: float = 0.3  # of the level: scatter of a whole load between rests ...
    quiet: float = 1.25  # ... whose sum is below this


LIMITS, WHITE = _PlateauLimits(), _White()
SIGMAS = 6.0  # of the noise: beyond them it is none
DRIFT = 0.03  # of a current: so much it may drift, or differ from its siblings
MEAN_BEND = math.sqrt(12.0 / math.pi)  # mean size of a second difference of noise of unit sigma
LOWER_BEND = 1.367  # mean of the smaller four fifths of them
# Up to this long, what lies between two plateaus is the tester's rise.
RISE_ROWS, RISE_S = 8, 3.0


class CurrentScale(NamedTuple):
    """What the noise and the range of a current allow to be separated [A].

    zero_A : what the sensor reads at rest
    rest_A : distance from ``zero_A`` within which a sample is a rest
    step_A : smallest difference of two samples that is not noise
    """

    zero_A: float
    rest_A: float
    step_A: float


class PlateauSpan(NamedTuple):
    """Rows ``start`` to ``stop`` (not included) of one kind, and their mean current [A]."""

    kind: PhaseKind
    start: int
    stop: int
    level_A: float


def current_scale(current_A: FloatArray) -> CurrentScale:
    """Zero and tolerances of a current, from the samples alone.

    Parameters
    ----------
    current_A : (n,) float       finite [A]
    """
    top = float(np.max(np.abs(current_A)))
    moved = np.abs(np.diff(current_A))
    moved = moved[moved > 1e-9 * top]
    lsb = float(moved.min()) if moved.size else 0.0
    coarse = np.count_nonzero(moved < 1.01 * lsb) > LIMITS.coarse_rows * current_A.size
    if not coarse or lsb > LIMITS.moving * top:
        lsb = 0.0
    near = current_A[np.abs(current_A) <= LIMITS.near_zero * top]
    zero = scatter = 0.0
    if near.size:
        zero = float(np.median(near))
        scatter = 1.4826 * float(np.median(np.abs(near - zero)))
    if abs(zero) > LIMITS.step * top:  # the end of a CV part, or a small load: not the zero
        zero = 0.0
    near_mean, far_mean = (_lower_mean(current_A, lag) for lag in (1, 2))
    noise = SIGMAS * near_mean / LOWER_BEND
    if noise > LIMITS.moving * top or far_mean > WHITE.growth * near_mean:
        noise = 0.0  # a current that moves
    rest = max(noise, min(SIGMAS * scatter, LIMITS.near_zero * top))
    rest = max(rest, LIMITS.rest * top, 1.5 * lsb)
    return CurrentScale(zero, rest, max(LIMITS.step * top, 2.5 * lsb))


def _lower_mean(x: FloatArray, lag: int) -> float:
    """Mean of the smaller four fifths of the second differences, whose larger ones hold steps."""
    n = max(x.size - 2 * lag, 0)
    bends = np.sort(np.abs(x[2 * lag :] - 2.0 * x[lag : lag + n] + x[:n]))
    lower = bends[: int(0.8 * bends.size)]
    return float(np.mean(lower)) if lower.size else 0.0


def find_plateaus(current_A: FloatArray, scale: CurrentScale) -> list[PlateauSpan]:
    """Rests and constant currents of at least two rows, in order; what lies between them moves.

    Parameters
    ----------
    current_A : (n,) float       finite [A]
    """
    # One row alone, far off two neighbours that are alike, is a glitch of the sensor.
    x = current_A.copy()
    middle = 0.5 * (x[2:] + x[:-2])
    off = np.abs(x[1:-1] - middle)
    glitch = (off > scale.step_A) & (np.abs(x[2:] - x[:-2]) < LIMITS.glitch * off)
    x[1:-1][glitch] = middle[glitch]
    rest = np.abs(x - scale.zero_A) <= scale.rest_A
    cuts = np.flatnonzero((rest[1:] != rest[:-1]) | (x[1:] * x[:-1] < 0.0) & ~rest[1:]) + 1
    bounds = np.concatenate(([0], cuts, [x.size]))
    total = np.concatenate(([0.0], np.cumsum(x)))
    found: list[tuple[int, int]] = []
    parts = np.empty((x.size, 2), dtype=np.int64)
    for a, b in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        if rest[a]:
            found.append((a, b))
        else:
            count = _levels(x, total, a, b, scale.step_A, parts)
            found += _without_slopes(x, total, parts[:count])
    # The first row of a log may be all that is seen of the rest before.
    return [
        PlateauSpan("rest" if rest[a] else "cc", a, b, float(total[b] - total[a]) / (b - a))
        for a, b in found
        if b - a >= 2 or (a == 0 and rest[0])
    ]


def _without_slopes(x: FloatArray, total: FloatArray, parts: RowArray) -> list[tuple[int, int]]:
    """Parts that are levels: of a current that moves slowly, its steps are none.

    A step is one whose level differs little from both neighbours, up or down a slope, or that has
    few rows and differs little from one. A level ends where the slope after it begins.
    """
    start, stop = parts.T
    level = (total[stop] - total[start]) / (stop - start)
    change = np.concatenate(([0.0], np.diff(level) / np.abs(level[1:]), [0.0]))
    before, after = change[:-1], change[1:]
    little = [(np.abs(c) < LIMITS.slope) & (c != 0.0) for c in (before, after)]
    slope = little[0] & little[1] & (before * after > 0.0)
    slope |= (little[0] | little[1]) & (stop - start < RISE_ROWS)
    found = []
    for k in np.flatnonzero(~slope).tolist():
        a, b = int(start[k]), int(stop[k])
        level_A = np.median(x[a:b])
        near = max(4.0 * 1.4826 * np.median(np.abs(x[a:b] - level_A)), LIMITS.knee * abs(level_A))
        if little[1][k]:
            b = a + int(np.flatnonzero(np.abs(x[a:b] - level_A) <= near)[-1]) + 1
        follows = b == stop[k] and k + 1 < start.size
        if follows and (slope[k + 1] or stop[k + 1] - b < 2) and abs(x[b] - level_A) <= near:
            b += 1  # the first row of a fall
        found.append((a, b))
    return found


@cached()
def _levels(
    x: FloatArray, total: FloatArray, start: int, stop: int, step_A: float, parts: RowArray
) -> int:
    """Parts of rows start to stop that hold one level, in order: their number.

    Parameters
    ----------
    x, total : (n,), (n + 1,) float      current and its running sum [A]
    step_A : float                       smallest change [A]
    parts : (rows, 2) int64, out         first row, row after the last
    """
    todo = np.empty((stop - start + 1, 2), dtype=np.int64)
    todo[0, 0], todo[0, 1] = start, stop
    open_, count = 1, 0
    while open_ > 0:
        open_ -= 1
        a, b = todo[open_, 0], todo[open_, 1]
        n = b - a
        mean = (total[b] - total[a]) / n
        low = high = x[a]
        largest, split = 0.0, a + 1
        for k in range(a, b):
            low, high = min(low, x[k]), max(high, x[k])
            away = abs(total[k + 1] - total[a] - (k + 1 - a) * mean)
            if k + 1 < b and away > largest:
                largest, split = away, k + 1
        flat = high - low <= max(step_A, LIMITS.flat * abs(mean))
        if not flat and n > 2:
            bends = wide = 0.0
            for k in range(a + 2, b):
                bends += abs(x[k] - 2.0 * x[k - 1] + x[k - 2])
            for k in range(a + 4, b):
                wide += abs(x[k] - 2.0 * x[k - 2] + x[k - 4])
            bends, wide = bends / (n - 2), wide / max(n - 4, 1)
            sigma = bends / MEAN_BEND
            white = wide <= (WHITE.growth + 1.5 / math.sqrt(n)) * bends
            few = high - low <= WHITE.few * abs(mean)
            flat = few and largest <= 0.5 * WHITE.change * sigma * math.sqrt(n)
            spread = 0.0
            for k in range(a, b):
                spread += (x[k] - mean) ** 2
            spread = max(sigma, math.sqrt(spread / n)) / max(abs(mean), 1e-12)
            if n >= WHITE.rows and white and spread <= WHITE.scatter:
                flat = flat or largest <= WHITE.change * sigma * math.sqrt(n)
            if a == start and b == stop and n >= RISE_ROWS and white and spread <= WHITE.alone:
                flat = flat or largest <= WHITE.quiet * sigma * math.sqrt(n)
        if flat or n < 2:
            parts[count, 0], parts[count, 1] = a, b
            count += 1
        else:  # the first half last, so that it is looked at next
            todo[open_, 0], todo[open_, 1] = split, b
            todo[open_ + 1, 0], todo[open_ + 1, 1] = a, split
            open_ += 2
    return count
