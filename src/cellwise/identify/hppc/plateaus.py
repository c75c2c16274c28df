"""Levels of a current: runs of rows at one level, as far as the noise allows."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from cellwise.typing import BoolArray, FloatArray

RowArray = NDArray[np.int64]


class _Limits(NamedTuple):
    """What separates the levels of a current: multiples of its noise, or shares of its range."""

    step_sigmas: float = 8.5  # two samples of one level differ by less
    rest_sigmas: float = 6.0  # so far from zero a sample is no rest
    step: float = 2e-3  # of the range: the least of a step ...
    rest: float = 1e-3  # ... and of what is no rest, where the noise would allow less
    zero: float = 0.01  # of the range: up to here a steady reading may be the sensor's zero
    flat: float = 0.01  # of a level: a held current may drift by so much
    # More scatter than this share of the range, or that grows with the distance of the samples, is
    # a moving current and not noise.
    noise: float = 0.3
    # Steps of this share of the range shall be seen: more noise asks for smoothing, by so many rows
    # at most. Without it currents of A123 and Samsung break into hundreds of pieces.
    seen_step: float = 0.02
    smoothing_rows: int = 15
    # A resolution goes back and forth in this share of the rows; a coarse one (LG at C/20) oftener.
    coarse: float = 0.05
    coarse_rows: float = 0.02
    fine_rows: float = 0.005
    white_growth: float = 1.3  # of second differences at twice the distance: more is no noise
    chunks: int = 8  # a level is flat whose eighths have one mean; blocks of noise are as long
    level_rows: int = 64  # more of a level say nothing new


class _NoisyLevel(NamedTuple):
    """A level noisier than the others, for another device makes it."""

    change: float = 0.5  # of the level: it lies between two such changes
    rows: int = 16  # from so many on white noise is separated from a moving current, ...
    scatter: float = 0.15  # ... and this is the most of it, as a share of the level
    few_rows: int = 8
    few_scatter: float = 0.04  # all of few rows lie within this share


LIMITS, NOISY = _Limits(), _NoisyLevel()
MEAN_BEND = math.sqrt(12.0 / math.pi)  # mean size of a second difference of noise of unit sigma
# Up to this long, what lies between two plateaus is the tester's rise.
RISE_ROWS, RISE_S = 8, 3.0


class CurrentScale(NamedTuple):
    """What the noise and the range of a current allow to be separated [A].

    noise_A : standard deviation of one sample about its level
    zero_A : what the sensor reads at rest
    rest_A : distance from ``zero_A`` within which a sample is a rest
    step_A : smallest difference of two samples that is not noise
    range_A : largest current
    smoothing_rows : width of the running median that the noise asks for; 1 = none
    """

    noise_A: float
    zero_A: float
    rest_A: float
    step_A: float
    range_A: float
    smoothing_rows: int


class Plateaus(NamedTuple):
    """Runs of rows at one level: rows ``start`` to ``stop`` (not included), each (m,)."""

    start: RowArray
    stop: RowArray
    level_A: FloatArray
    rest: BoolArray


def current_scale(current_A: FloatArray) -> CurrentScale:
    """Noise, zero and tolerances of a current, from the samples alone.

    The noise is that of the quietest blocks at rest or of the quietest under load, whichever is
    larger, because testers clamp zero.

    Parameters
    ----------
    current_A : (n,) float       finite [A]
    """
    top = float(np.max(np.abs(current_A)))
    if top == 0.0:
        return CurrentScale(0.0, 0.0, 0.0, 0.0, 0.0, 1)
    lsb = _resolution(current_A, top)
    noise = max(_noise(current_A, top, lsb), 0.3 * lsb)
    if top < LIMITS.rest_sigmas * noise:  # nothing flows in this log
        return CurrentScale(noise, 0.0, top, 3.0 * top, top, 1)
    # Where the resolution makes the noise, samples jump by one step of it, seldom by two.
    rounded = noise < 0.6 * lsb
    width = 1
    if not rounded and LIMITS.step_sigmas * noise > LIMITS.seen_step * top:
        wanted = (1.25 * LIMITS.step_sigmas * noise / (LIMITS.seen_step * top)) ** 2
        width = int(min(2 * (wanted // 2) + 1, LIMITS.smoothing_rows))
    seen = 0.0 if rounded else noise if width == 1 else 1.25 * noise / np.sqrt(width)
    step = max(LIMITS.step_sigmas * float(seen), LIMITS.step * top, 2.5 * lsb if rounded else 0.0)
    rest = max(LIMITS.rest_sigmas * float(seen), LIMITS.rest * top, 1.5 * lsb)
    near = current_A[np.abs(current_A) <= max(LIMITS.zero * top, 4.0 * noise)]
    zero = float(np.median(near)) if near.size else 0.0
    if abs(zero) > LIMITS.step * top:  # the end of a CV part, or a small load: not the zero
        zero = 0.0
    if near.size:
        scatter = 1.4826 * float(np.median(np.abs(near - zero)))
        rest = max(rest, min(LIMITS.rest_sigmas * scatter, LIMITS.step * top))
    return CurrentScale(noise, zero, rest, step, top, width)


def find_plateaus(current_A: FloatArray, scale: CurrentScale | None = None) -> Plateaus:
    """Runs of at least two rows at one level, in order; what lies between them moves.

    Parameters
    ----------
    current_A : (n,) float       finite [A]
    scale : CurrentScale         found from the current where it is not given
    """
    scale = scale or current_scale(current_A)
    x = current_A
    if scale.smoothing_rows > 1:
        x = median_filter(current_A, scale.smoothing_rows, mode="nearest")
    rest = np.abs(x - scale.zero_A) <= scale.rest_A
    broken = (np.abs(np.diff(x)) > scale.step_A) | (rest[1:] != rest[:-1])
    noise = _level_noise(x, rest, broken, scale)
    broken &= ~((noise[1:] > scale.noise_A) & (noise[:-1] == noise[1:]))
    start = np.concatenate(([0], np.flatnonzero(broken) + 1))
    stop = np.append(start[1:], x.size)
    total = np.concatenate(([0.0], np.cumsum(x)))
    start, stop = _flat_pieces(x, total, start, stop, rest, noise, scale)
    level = (total[stop] - total[start]) / (stop - start)
    plateaus = Plateaus(start, stop, level, rest[start])
    for _ in range(2):  # once for the runs, once for what then has become a neighbour
        plateaus = _merge_level(plateaus, noise)
    return plateaus if scale.smoothing_rows == 1 else _sharpened(current_A, plateaus, scale)


def without_ramps(p: Plateaus, time_s: FloatArray) -> Plateaus:
    """Drop the short pieces into which a slow rise breaks between two levels.

    They are a few rows long, lead from the one level towards the other without turning back, and
    take no longer than a tester needs.

    Parameters
    ----------
    p : Plateaus
    time_s : (n,) float       [s]
    """
    short = (p.stop - p.start <= RISE_ROWS) & ~p.rest
    short[:1] = short[-1:] = False
    first = np.flatnonzero(short & ~np.concatenate(([False], short[:-1])))
    last = np.flatnonzero(short & ~np.concatenate((short[1:], [False])))
    if first.size == 0:
        return p
    kept = np.ones(p.start.size, dtype=np.bool_)
    took = time_s[p.start[last + 1] - 1] - time_s[p.stop[first - 1] - 1]
    for a, b in zip(first[took <= RISE_S], last[took <= RISE_S], strict=True):
        climb = np.diff(p.level_A[a - 1 : b + 2])
        kept[a : b + 1] = not (np.all(climb > 0.0) or np.all(climb < 0.0))
    return _chosen(p, kept)


def _chosen(p: Plateaus, kept: BoolArray) -> Plateaus:
    return Plateaus(p.start[kept], p.stop[kept], p.level_A[kept], p.rest[kept])


def _resolution(current_A: FloatArray, top: float) -> float:
    """Smallest change of the current [A], 0 where that is a step of a log without noise."""
    moved = np.abs(np.diff(current_A))
    moved = moved[moved > 1e-9 * top]
    lsb = float(moved.min()) if moved.size else 0.0
    # A resolution shows by going back and forth all the time.
    share = np.count_nonzero(moved < 1.01 * lsb) / current_A.size
    fine = lsb <= LIMITS.zero * top and share > LIMITS.fine_rows
    coarse = lsb <= LIMITS.coarse * top and share > LIMITS.coarse_rows
    return lsb if fine or coarse else 0.0


def _noise(current_A: FloatArray, top: float, lsb: float) -> float:
    """Standard deviation of a sample about its level [A], 0 where the log does not show it.

    Second differences, because a slope is not noise; of the quietest blocks, because most blocks
    of a drive hold steps; at two distances of the samples, because the differences of noise do
    not grow with it and those of a moving current do.
    """
    n = current_A.size // LIMITS.chunks * LIMITS.chunks
    if n == 0:
        return 0.0
    blocks = current_A[:n].reshape(-1, LIMITS.chunks)
    near, far = (_bends(blocks, lag) for lag in (1, 2))
    middle = (near.shape[1] - 1) // 2
    typical = np.partition(near, middle, axis=1)[:, middle]
    loaded = np.abs(blocks.mean(axis=1)) > LIMITS.zero * top
    found = 0.0
    for group in (loaded, ~loaded):
        if not group.any():
            continue
        quiet = max(float(np.quantile(typical[group], 0.2)), lsb)
        calm = group & (typical <= 4.0 * quiet)
        # An edge inside a block counts as little more than noise, and not at all where most have
        # none: it bends more of the wide differences than of the narrow ones.
        whole = calm & (np.max(far, axis=1) <= 10.0 * quiet)
        if 2 * np.count_nonzero(whole) > np.count_nonzero(calm):
            calm = whole
        one, two = (float(np.mean(np.minimum(x[calm], 10.0 * quiet))) for x in (near, far))
        sigma = one / MEAN_BEND
        if two < LIMITS.white_growth * one and sigma < LIMITS.noise * top:
            found = max(found, sigma)
    return found


def _level_noise(
    x: FloatArray, rest: BoolArray, broken: BoolArray, scale: CurrentScale
) -> FloatArray:
    """Standard deviation of every row about its level [A], shape (n,).

    That of the whole log, save where a stretch between two large changes is noisier and yet holds
    one level: a charger may regulate more coarsely than the load beside it.
    """
    noise = np.full(x.size, scale.noise_A)
    size = np.maximum(np.abs(x[1:]), np.abs(x[:-1]))
    large = np.abs(np.diff(x)) > np.maximum(NOISY.change * size, scale.step_A)
    cut = np.flatnonzero(large | (rest[1:] != rest[:-1])) + 1
    count = np.concatenate(([0], np.cumsum(broken)))
    for a, b in pairwise([0, *cut.tolist(), x.size]):
        if b - a < NOISY.few_rows or rest[a]:
            continue
        if count[b - 1] == count[a] and float(np.ptp(x[a:b])) <= scale.step_A:
            continue  # one plateau as it is
        # The first row, and the last, may hold part of a switch.
        first, last = a + 1, b - 1
        sigma = _scatter_of_level(x[first:last], scale)
        if sigma > 0.0:
            level = float(np.mean(x[first:last]))
            near = max(4.0 * sigma, NOISY.few_scatter * abs(level))
            first -= abs(float(x[a]) - level) <= near
            last += abs(float(x[b - 1]) - level) <= near
            noise[first:last] = sigma
    return noise


def _scatter_of_level(part: FloatArray, scale: CurrentScale) -> float:
    """Standard deviation of rows that hold one level and are noisier than the log, else 0 [A]."""
    level = abs(float(np.mean(part)))
    if part.size < NOISY.rows:
        width = float(np.ptp(part))
        return 0.5 * width if width <= NOISY.few_scatter * level else 0.0
    near, far = (_bends(part[None, :], lag) for lag in (1, 2))
    ceiling = 10.0 * float(np.median(near))
    one, two = (float(np.mean(np.minimum(d, ceiling))) for d in (near, far))
    sigma = one / MEAN_BEND
    cuts = np.arange(LIMITS.chunks + 1) * part.size // LIMITS.chunks
    means = np.add.reduceat(part, cuts[:-1]) / np.diff(cuts)
    flat = np.ptp(means) <= 6.0 * sigma / np.sqrt(part.size / LIMITS.chunks)
    noisier = scale.noise_A < sigma < NOISY.scatter * level
    white = two < (LIMITS.white_growth + 1.5 / np.sqrt(part.size)) * one
    return sigma if flat and noisier and white else 0.0


def _bends(blocks: FloatArray, lag: int) -> FloatArray:
    bends: FloatArray = np.abs(
        blocks[:, 2 * lag :] - 2 * blocks[:, lag:-lag] + blocks[:, : -2 * lag]
    )
    return bends


def _flat_pieces(
    x: FloatArray,
    total: FloatArray,
    start: RowArray,
    stop: RowArray,
    rest: BoolArray,
    noise: FloatArray,
    scale: CurrentScale,
) -> tuple[RowArray, RowArray]:
    """Runs that hold one level; a run that drifts gives its flat beginning and its flat end."""
    rows = stop - start
    low = np.minimum.reduceat(x, start)
    high = np.maximum.reduceat(x, start)
    allowed = np.maximum(scale.step_A, LIMITS.flat * np.abs(0.5 * (low + high)))
    flat = (rows >= 2) & ((high - low <= allowed) | rest[start])
    uncertain = np.flatnonzero(~flat & (rows >= LIMITS.chunks))
    if uncertain.size:
        # Noise widens the range of a long run without bending it: compare means of eighths.
        parts = np.arange(LIMITS.chunks + 1) * rows[uncertain, None] // LIMITS.chunks
        cuts = start[uncertain, None] + parts
        means = np.diff(total[cuts], axis=1) / np.diff(cuts, axis=1)
        bound = np.maximum(
            6.0 * noise[start[uncertain]] / np.sqrt(rows[uncertain] / LIMITS.chunks),
            LIMITS.flat * np.abs(means).max(axis=1),
        )
        flat[uncertain] = np.ptp(means, axis=1) <= bound
    pieces = [np.column_stack((start[flat], stop[flat]))]
    for k in np.flatnonzero(~flat & (rows >= 2 * LIMITS.chunks)).tolist():
        a, b = int(start[k]), int(stop[k])
        head = a + _flat_head(x[a:b], scale)
        tail = b - _flat_head(x[head:b][::-1], scale)
        found = [(p, q) for p, q in ((a, head), (tail, b)) if q - p >= 2]
        pieces.append(np.array(found, dtype=np.int64).reshape(-1, 2))
    both = np.concatenate(pieces).astype(np.int64)
    both = both[np.argsort(both[:, 0], kind="stable")]
    return both[:, 0], both[:, 1]


def _flat_head(x: FloatArray, scale: CurrentScale) -> int:
    """Number of rows from the first on that stay at the level they begin with (0: none)."""
    if x.size < LIMITS.chunks:
        return 0
    level = float(np.median(x[: LIMITS.chunks + 1]))
    off = np.abs(x - level) > max(4.0 * scale.noise_A, LIMITS.flat * abs(level))
    left = np.flatnonzero(off[:-1] & off[1:])  # two rows running: one alone is a glitch
    head = int(left[0]) if left.size else x.size
    if head < LIMITS.chunks:
        return 0
    # The knee lies before the row at which the drift has grown to the tolerance.
    level = float(np.median(x[:head]))
    close = np.abs(x[:head] - level) <= max(4.0 * scale.noise_A, 1e-3 * abs(level))
    knee = int(np.flatnonzero(close)[-1]) + 1 if close.any() else head
    return knee if knee >= max(LIMITS.chunks, head // 2) else head


def _merge_level(p: Plateaus, noise_A: FloatArray) -> Plateaus:
    """Join neighbours of one level that only a glitch of one row, or nothing, parts."""
    if p.start.size < 2:
        return p
    between = p.start[1:] - p.stop[:-1]
    difference = np.abs(np.diff(p.level_A))
    n = np.minimum(p.stop - p.start, LIMITS.level_rows)
    noise = noise_A[p.start]
    noise = np.maximum(noise[1:], noise[:-1])
    error = 4.0 * noise * np.sqrt(1.0 / n[1:] + 1.0 / n[:-1])
    larger = np.maximum(np.abs(p.level_A[1:]), np.abs(p.level_A[:-1]))
    same = difference <= np.maximum(error, 0.5 * LIMITS.flat * larger)
    same |= p.rest[1:] & p.rest[:-1]
    joined = same & (between <= 1) & (p.rest[1:] == p.rest[:-1])
    first = np.flatnonzero(np.concatenate(([True], ~joined)))
    last = np.append(first[1:], p.start.size) - 1
    rows = (p.stop - p.start).astype(np.float64)
    level = np.add.reduceat(p.level_A * rows, first) / np.add.reduceat(rows, first)
    return Plateaus(p.start[first], p.stop[last], level, p.rest[first])


def _sharpened(x: FloatArray, p: Plateaus, scale: CurrentScale) -> Plateaus:
    """Put each change found in the smoothed current where the raw samples have it.

    The running median may move a change by some rows: the split with the least squares about
    the two levels is the likeliest row.
    """
    reach = scale.smoothing_rows
    # A running median leaves nothing shorter than half its width but pieces of a slope.
    p = _chosen(p, p.stop - p.start > reach // 2)
    start, stop = p.start.copy(), p.stop.copy()
    for k in range(p.start.size - 1):
        if start[k + 1] - stop[k] > reach:
            continue
        a = max(int(start[k]), int(stop[k]) - reach)
        b = min(int(stop[k + 1]), int(start[k + 1]) + reach)
        gain = (x[a:b] - p.level_A[k + 1]) ** 2 - (x[a:b] - p.level_A[k]) ** 2
        # Cost of a split at s, up to a constant: the rows before s at the old level.
        row = a + int(np.argmax(np.concatenate(([0.0], np.cumsum(gain)))))
        stop[k] = start[k + 1] = row
    return _chosen(p._replace(start=start, stop=stop), stop - start >= 1)
