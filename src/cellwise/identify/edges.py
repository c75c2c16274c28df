"""Current edges: where a tester switches from one level to another.

Two detectors. :func:`ema_edges` is the published one, a difference of two exponential averages.
:func:`robust_edges` is the default: it looks for *plateaus* (runs of rows at one level, as far as
the noise can tell) and calls the change between two plateaus an edge. A glitch of one sample is
then no edge, a ramp over many samples is one, and the row is the exact first one whose interval
carries the new current, at 135 Hz as well as at 60 s per row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from cellwise.errors import InputError
from cellwise.typing import BoolArray, FloatArray

RowArray = NDArray[np.int64]

# The detector of the LFP paper: weights 0.1 and 0.02 at 135 Hz, threshold 0.5 A for steps of up
# to 120 A. A weight w at the interval h is the time constant -h / ln(1 - w).
EMA_FAST_S = -1.0 / (135.0 * np.log1p(-0.1))
EMA_SLOW_S = -1.0 / (135.0 * np.log1p(-0.02))
EMA_THRESHOLD_OF_RANGE = 0.5 / 120.0
EMA_SIGMAS = 6.0

# Two samples of one level differ by less than this many standard deviations of one sample.
STEP_SIGMAS = 8.5
STEP_OF_RANGE = 2e-3
FLAT_OF_LEVEL = 0.01
# Up to this share of the largest current, a steady reading may be the sensor's zero.
ZERO_OF_RANGE = 0.01
REST_OF_RANGE = 1e-3
REST_SIGMAS = 6.0
# Scatter above this share of the range is a moving current, not noise.
NOISE_OF_RANGE = 0.02
SMOOTHED_STEP_OF_RANGE = 0.02
MAX_SMOOTHING_ROWS = 15
BLOCK_ROWS = 8
FLAT_CHUNKS = 8


@dataclass(frozen=True)
class Edge:
    """A change of the current from one level to another.

    ``row`` is the first row whose interval carries something of the new current; ``time_s`` is
    the time at which that interval begins, the instant of the change. ``ramp_rows`` rows pass
    before the new level is held (0: the first row holds it already).
    """

    row: int
    time_s: float
    before_A: float
    after_A: float
    ramp_rows: int

    @property
    def step_A(self) -> float:
        """Change of the current [A]."""
        return self.after_A - self.before_A


class CurrentScale(NamedTuple):
    """What the noise and the range of a current allow to be told apart [A].

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

    The noise is taken from differences of neighbours, in blocks: the quietest blocks at rest and
    the quietest under load, whichever is larger, because testers clamp zero. A drive has no quiet
    block under load, so scatter above 2 % of the range is not taken for noise.

    Parameters
    ----------
    current_A : (n,) float       finite [A]
    """
    top = float(np.max(np.abs(current_A)))
    if top == 0.0:
        return CurrentScale(0.0, 0.0, 0.0, 0.0, 0.0, 1)
    n = current_A.size // BLOCK_ROWS * BLOCK_ROWS
    noise = 0.0
    lsb = 0.0
    d = np.abs(np.diff(current_A))
    if n >= BLOCK_ROWS:
        blocks = current_A[:n].reshape(-1, BLOCK_ROWS)
        spread = np.partition(np.abs(np.diff(blocks, axis=1)), BLOCK_ROWS // 2 - 1, axis=1)
        scatter = spread[:, BLOCK_ROWS // 2 - 1] / (0.6745 * np.sqrt(2.0))
        loaded = np.abs(blocks.mean(axis=1)) > ZERO_OF_RANGE * top
        for group in (scatter[loaded], scatter[~loaded]):
            if group.size:
                quiet = float(np.quantile(group, 0.2))
                noise = max(noise, quiet if quiet < NOISE_OF_RANGE * top else 0.0)
        if not loaded.all() and noise == 0.0:
            noise = min(float(np.quantile(scatter, 0.2)), 0.1 * top)
    moved = d[d > 0.0]
    if moved.size:
        lsb = float(moved.min())
        lsb = lsb if lsb < ZERO_OF_RANGE * top else 0.0
    width = 1
    if STEP_SIGMAS * noise > SMOOTHED_STEP_OF_RANGE * top:
        wanted = (1.25 * STEP_SIGMAS * noise / (SMOOTHED_STEP_OF_RANGE * top)) ** 2
        width = int(min(2 * (wanted // 2) + 1, MAX_SMOOTHING_ROWS))
    seen = noise if width == 1 else 1.25 * noise / np.sqrt(width)
    step = max(STEP_SIGMAS * seen, STEP_OF_RANGE * top, 1.5 * lsb)
    near = current_A[np.abs(current_A) <= max(ZERO_OF_RANGE * top, 4.0 * noise)]
    zero, rest = 0.0, max(REST_OF_RANGE * top, REST_SIGMAS * seen, 1.5 * lsb)
    if near.size:
        zero = float(np.median(near))
        if abs(zero) > 0.3 * ZERO_OF_RANGE * top:  # the end of a CV part, not the sensor's zero
            zero = 0.0
        scatter_near = 1.4826 * float(np.median(np.abs(near - zero)))
        rest = max(rest, min(REST_SIGMAS * scatter_near, 0.5 * ZERO_OF_RANGE * top))
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
    start = np.concatenate(([0], np.flatnonzero(broken) + 1))
    stop = np.append(start[1:], x.size)
    start, stop = _flat_pieces(x, start, stop, rest, scale)
    total = np.concatenate(([0.0], np.cumsum(x)))
    level = (total[stop] - total[start]) / (stop - start)
    plateaus = Plateaus(start, stop, level, rest[start])
    for _ in range(2):
        plateaus = _merge_level(plateaus, scale)
    return plateaus


def _flat_pieces(
    x: FloatArray, start: RowArray, stop: RowArray, rest: BoolArray, scale: CurrentScale
) -> tuple[RowArray, RowArray]:
    """Runs that hold one level; a run that drifts gives its flat beginning and its flat end."""
    rows = stop - start
    low = np.minimum.reduceat(x, start)
    high = np.maximum.reduceat(x, start)
    middle = 0.5 * (low + high)
    allowed = np.maximum(scale.step_A, FLAT_OF_LEVEL * np.abs(middle))
    flat = (rows >= 2) & ((high - low <= allowed) | rest[start])
    doubtful = np.flatnonzero(~flat & (rows >= FLAT_CHUNKS))
    if doubtful.size:
        # Noise widens the range of a long run without bending it: compare means of eighths.
        total = np.concatenate(([0.0], np.cumsum(x)))
        cuts = start[doubtful, None] + np.arange(FLAT_CHUNKS + 1) * rows[doubtful, None] // 8
        means = np.diff(total[cuts], axis=1) / np.diff(cuts, axis=1)
        bound = np.maximum(
            4.0 * scale.noise_A / np.sqrt(rows[doubtful] / 8.0),
            FLAT_OF_LEVEL * np.abs(means).max(axis=1),
        )
        flat[doubtful] = np.ptp(means, axis=1) <= bound
    pieces = [np.column_stack((start[flat], stop[flat]))]
    for k in np.flatnonzero(~flat & (rows >= FLAT_CHUNKS)):
        a, b = int(start[k]), int(stop[k])
        head = a + _flat_head(x[a:b], scale)
        tail = b - _flat_head(x[head:b][::-1], scale)
        pieces.append(np.array([(p, q) for p, q in ((a, head), (tail, b)) if q - p >= 2]).reshape(-1, 2))
    found = np.concatenate(pieces).astype(np.int64)
    found = found[np.argsort(found[:, 0], kind="stable")]
    return found[:, 0], found[:, 1]


def _flat_head(x: FloatArray, scale: CurrentScale) -> int:
    """Number of rows from the first on that stay at the level they begin with (0: none)."""
    if x.size < FLAT_CHUNKS:
        return 0
    level = float(np.median(x[: FLAT_CHUNKS + 1]))
    allowed = max(4.0 * scale.noise_A, FLAT_OF_LEVEL * abs(level))
    off = np.abs(x - level) > allowed
    # Two rows in a row: one alone is a glitch.
    left = np.flatnonzero(off[:-1] & off[1:])
    head = int(left[0]) if left.size else x.size
    if head < FLAT_CHUNKS:
        return 0
    # The knee lies before the row at which the drift has grown to the tolerance.
    level = float(np.median(x[:head]))
    close = np.flatnonzero(np.abs(x[:head] - level) <= max(4.0 * scale.noise_A, 1e-3 * abs(level)))
    knee = int(close[-1]) + 1 if close.size else head
    return knee if knee >= max(FLAT_CHUNKS, head // 2) else head


def _merge_level(p: Plateaus, scale: CurrentScale) -> Plateaus:
    """Join neighbours of one level that only a glitch of one row, or nothing, parts."""
    if p.start.size < 2:
        return p
    between = p.start[1:] - p.stop[:-1]
    apart = np.abs(np.diff(p.level_A))
    n = np.minimum(p.stop - p.start, 64)
    error = 4.0 * scale.noise_A * np.sqrt(1.0 / n[1:] + 1.0 / n[:-1])
    larger = np.maximum(np.abs(p.level_A[1:]), np.abs(p.level_A[:-1]))
    same = apart <= np.maximum(error, 0.5 * FLAT_OF_LEVEL * larger)
    same |= p.rest[1:] & p.rest[:-1]
    joined = same & (between <= 1) & (p.rest[1:] == p.rest[:-1])
    first = np.flatnonzero(np.concatenate(([True], ~joined)))
    last = np.append(first[1:], p.start.size) - 1
    rows = (p.stop - p.start).astype(np.float64)
    level = np.add.reduceat(p.level_A * rows, first) / np.add.reduceat(rows, first)
    return Plateaus(p.start[first], p.stop[last], level, p.rest[first])
