"""Rests, resolution, and channels that stand still, stick at an end, jump or are lost."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.logs.measured_log import MeasuredLog
from cellwise.typing import BoolArray, FloatArray

REST_OF_LARGEST = 0.005
COARSE_REST_OF_LARGEST = 0.02
LEAST_REST_S = 60.0
STUCK_ROWS = 20
STUCK_MOVES = 10
# So many are enough where each would have moved the voltage by so many of its digits.
PLAIN_MOVES, PLAIN_DIGITS = 3, 5.0
DEAD_MOVES = 2
STUCK_MOVE_OF_RANGE = 0.1
HELD_SHARE = 0.01  # of the largest current
SATURATED_RUN = 3
SATURATED_VISITS = 3
# A spike is beyond what the current did by so many robust deviations, and by so much at least.
SPIKE_DEVIATIONS = 20.0
SPIKE_LEAST_V = 0.05
SPIKE_OF_DROP = 2.0
LATE_ROWS = 5
# What one channel shows of the other may come so much later, or earlier.
LATE_S = 3.0
LARGER_STEPS = 0.98
LEAST_STEP_A = 1e-12  # what is below is no current
NOISE_DEVIATIONS = 8.0
LOST_ROWS = 20
SPARSE = 0.25
RESOLUTION_SAMPLE = 200_000
WHOLE_STEPS = 0.95
LEAST_DISTINCT = 20
DECIMAL_PLACES = 9


class Rest(NamedTuple):
    """A time without current: where it starts, its length, the voltage at its end."""

    start_s: float
    duration_s: float
    voltage_V: float


class Stretch(NamedTuple):
    """A part of the log during which a channel did something."""

    start_s: float
    duration_s: float


class Saturation(NamedTuple):
    """A channel held at its largest or smallest value again and again."""

    value: float
    share: float
    visits: int


def is_quiet(log: MeasuredLog) -> BoolArray:
    """Rows whose interval is without current, shape (n,).

    Current counts as none up to 0.5 % of the log's largest; where it is read no finer than that,
    up to its last digit, but never above 2 %.
    """
    current = np.abs(log.known_current_A())
    largest = float(np.max(current))
    digit = min(1.5 * (resolution(log.current_A) or 0.0), COARSE_REST_OF_LARGEST * largest)
    quiet: BoolArray = current <= max(REST_OF_LARGEST * largest, digit)
    return quiet


def find_rests(log: MeasuredLog) -> list[Rest]:
    """Times of at least a minute without current; a gap ends a rest."""
    first, last = _runs(is_quiet(log) & ~log.gap_rows)
    begins = np.maximum(first - 1, 0)  # the interval that ends at the first quiet row is at rest
    duration_s = log.time_s[last] - log.time_s[begins]
    return [
        Rest(float(log.time_s[a]), float(seconds), float(log.voltage_V[b]))
        for a, b, seconds in zip(begins, last, duration_s, strict=True)
        if seconds >= LEAST_REST_S
    ]


def resolution(values: FloatArray) -> float | None:
    """Step between values that a channel can show; None where they are on no grid.

    The smallest difference between values that occur, if there are many and nearly all differences
    are its multiples; else the last decimal place in which values were written.
    """
    finite = values[np.isfinite(values)]
    if finite.size > RESOLUTION_SAMPLE:
        finite = finite[:: -(-finite.size // RESOLUTION_SAMPLE)]
    distinct = np.unique(finite)
    if distinct.size < 3:
        return None
    steps = np.diff(distinct)
    smallest = float(np.min(steps[steps > 1e-9 * np.max(np.abs(distinct))], initial=np.inf))
    multiples = steps / smallest
    whole = np.mean(np.abs(multiples - np.round(multiples)) < 0.05) >= WHOLE_STEPS
    if whole and distinct.size >= LEAST_DISTINCT:
        return float(f"{smallest:.4g}")
    for place in range(DECIMAL_PLACES):
        scaled = distinct * 10.0**place
        if np.max(np.abs(scaled - np.round(scaled))) < 1e-4:
            return float(10.0**-place)
    return None


class Run(NamedTuple):
    """Rows from ``first`` to ``last``, both included."""

    first: int
    last: int


def find_stuck(log: MeasuredLog) -> dict[str, Stretch]:
    """Channels that stood still while the other one moved to and fro: the longest time of each.

    A voltage held by the tester stands still too, but the current then only dies away; a constant
    current stands still, but the voltage under it only drifts.
    """
    found = {}
    for name, runs in stuck_runs(log).items():
        stretches = [
            Stretch(float(log.time_s[a]), float(log.time_s[b] - log.time_s[a]))
            for a, b in ((max(r.first - 1, 0), r.last) for r in runs)
        ]
        found[name] = max(stretches, key=lambda s: s.duration_s)
    return found


def stuck_voltage(log: MeasuredLog) -> Stretch | None:
    """The longest time for which the voltage stood still while the current moved; None: never.

    Of a voltage that never moves, any current that does is enough.
    """
    voltage = log.voltage_V
    lowest, highest = np.fmin.reduce(voltage), np.fmax.reduce(voltage)
    if lowest == highest and len(log) > STUCK_ROWS:
        moves = np.fmax.reduce(log.current_A) > np.fmin.reduce(log.current_A)
        return Stretch(float(log.time_s[0]), log.duration_s) if moves else None
    return _longest_standstill(log.time_s, voltage, log.current_A)


def _longest_standstill(time_s: FloatArray, held: FloatArray, other: FloatArray) -> Stretch | None:
    jump = STUCK_MOVE_OF_RANGE * float(np.fmax.reduce(other) - np.fmin.reduce(other))
    if jump == 0.0:
        return None
    first, last = _runs(np.diff(held, prepend=np.nan) == 0.0)
    long = last - first + 1 >= STUCK_ROWS
    if not long.any():
        return None
    first, last = first[long], last[long]
    change = np.diff(other, prepend=other[0])
    moves = np.minimum(
        _count_within(change > jump, first, last), _count_within(change < -jump, first, last)
    )
    stuck = moves >= STUCK_MOVES
    if not stuck.any():
        return None
    begins = time_s[np.maximum(first - 1, 0)][stuck]
    duration_s = time_s[last][stuck] - begins
    longest = int(np.argmax(duration_s))
    return Stretch(float(begins[longest]), float(duration_s[longest]))


def stuck_runs(log: MeasuredLog) -> dict[str, list[Run]]:
    """The rows of every such time, by channel."""
    current_jump = STUCK_MOVE_OF_RANGE * _swing(log.current_A)
    digits = PLAIN_DIGITS * (resolution(log.voltage_V) or 0.0)
    plain = step_resistance(log) * current_jump > max(digits, PLAIN_DIGITS * _noise(log.voltage_V))
    moves = PLAIN_MOVES if plain else STUCK_MOVES
    found = {
        "voltage_V": _standstills(log.voltage_V, log.current_A, current_jump, moves),
        "current_A": _standstills(log.current_A, log.voltage_V, _current_jump(log), STUCK_MOVES),
    }
    # A rest only relaxes: to and fro twice without a current is a channel that is dead, unless it
    # is the load before or after the rest, and one of the channels comes late.
    jump, late = _current_jump(log), _late_rows(log, 0)
    dead = _standstills(log.current_A, log.voltage_V, jump, DEAD_MOVES, STUCK_ROWS - 1, late)
    nothing = [r for r in dead if log.current_A[r.first] == 0.0]
    found["current_A"] = sorted({*found["current_A"], *nothing})
    return {
        name: runs
        for name, runs in found.items()
        if runs and not (name == "current_A" and _is_held(log))
    }


def _is_held(log: MeasuredLog) -> bool:
    """Whether the current is a tester's constant that flickers by its digits.

    It stands at its end then, and the voltage goes on moving by its own.
    """
    swing = _swing(log.current_A)
    return 0.0 < swing <= HELD_SHARE * float(np.fmax.reduce(np.abs(log.current_A)))


def _current_jump(log: MeasuredLog) -> float:
    """A step of the voltage that only a current makes [V].

    The way from full to empty is no part of it, and neither is the noise.
    """
    swing = _swing(log.voltage_V)
    moved = min(swing, step_resistance(log) * _swing(log.current_A)) or swing
    noise = max(_noise(log.voltage_V), (resolution(log.voltage_V) or 0.0) / 3.0)
    return max(STUCK_MOVE_OF_RANGE * moved, NOISE_DEVIATIONS * noise)


def _swing(values: FloatArray) -> float:
    return float(np.fmax.reduce(values) - np.fmin.reduce(values))


def _standstills(
    held: FloatArray,
    other: FloatArray,
    jump: float,
    least: int,
    steps: int = STUCK_ROWS,
    late: int = 0,
) -> list[Run]:
    """Where a channel repeats its value so many times while the other moves to and fro so often.

    So often also without what ``late`` rows show at one end, whichever: they may be the load there.
    """
    change = np.diff(other, prepend=other[0])
    ups, downs = np.cumsum(change > jump), np.cumsum(change < -jump)
    first, last = _runs(np.diff(held, prepend=np.nan) == 0.0)
    if first.size == 0 or jump == 0.0:
        return []
    ends = (np.minimum(first - 1 + late, last), last), (first - 1, np.maximum(last - late, first))
    moves = np.min([c[b] - c[a] for a, b in ends for c in (ups, downs)], axis=0)
    stuck = (last - first + 1 >= steps) & (moves >= least)
    return [Run(int(a), int(b)) for a, b in zip(first[stuck], last[stuck], strict=True)]


def step_resistance(log: MeasuredLog) -> float:
    """Size of the voltage's larger steps over that of the current's, at whatever delay [ohm]."""
    by_current, by_voltage = np.abs(np.diff(log.known_current_A())), np.abs(np.diff(log.voltage_V))
    known = by_voltage[np.isfinite(by_voltage)]
    if known.size == 0:
        return 0.0
    step_A = float(np.quantile(by_current, LARGER_STEPS))
    if step_A < LEAST_STEP_A:
        return 0.0
    return float(np.quantile(known, LARGER_STEPS)) / step_A


def _late_rows(log: MeasuredLog, least: int) -> int:
    """Rows that one channel may be late by, so many at least."""
    steps = np.diff(log.time_s)
    usual = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else LATE_S
    return max(least, math.ceil(LATE_S / usual))


def _noise(values: FloatArray) -> float:
    """Standard deviation of a channel's noise: of the tenth of its steps that are smallest."""
    steps = np.abs(np.diff(values))
    steps = steps[np.isfinite(steps)]
    # A tenth of normal values is below 0.126 of their deviation; a step is of two values.
    return float(np.quantile(steps, 0.1)) / (0.126 * 2.0**0.5) if steps.size else 0.0


def find_spikes(log: MeasuredLog) -> NDArray[np.intp]:
    """Single rows whose voltage is far from both neighbours', further than the current explains.

    The current of some rows around counts, since a channel may be logged late.
    """
    v, i = log.voltage_V, log.known_current_A()
    late = _late_rows(log, LATE_ROWS)
    if v.size < 2 * late + 3:
        return np.zeros(0, dtype=np.intp)
    before, after = np.zeros(v.size), np.zeros(v.size)
    before[1:-1], after[1:-1] = v[1:-1] - v[:-2], v[1:-1] - v[2:]
    bend = np.nan_to_num(0.5 * np.abs(before + after))
    # At a step, however late, a row is far from one neighbour only.
    nearer = np.minimum(np.abs(before), np.abs(after))
    away = np.nan_to_num(np.where(before * after > 0.0, nearer, 0.0))
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # slow to import

    moved = maximum_filter1d(i, 2 * late + 1) - minimum_filter1d(i, 2 * late + 1)
    usual = 1.48 * float(np.median(bend))
    least = max(SPIKE_LEAST_V, SPIKE_DEVIATIONS * usual)
    far = away > least + SPIKE_OF_DROP * step_resistance(log) * moved
    # Between two spikes the other way a row is far from both, too: the larger is one.
    alone = far[1:-1] & (away[1:-1] >= away[:-2]) & (away[1:-1] >= away[2:])
    return np.flatnonzero(alone) + 1


def lost_runs(log: MeasuredLog) -> dict[str, list[Run]]:
    """Stretches of many rows without a value, by channel; of a temperature that most rows have."""
    channels = {"voltage_V": log.voltage_V, "current_A": log.current_A}
    if log.temperature_C is not None and np.mean(np.isnan(log.temperature_C)) < SPARSE:
        channels["temperature_C"] = log.temperature_C
    found = {}
    for name, values in channels.items():
        many = [r for r in runs_of(np.isnan(values)) if r.last - r.first >= LOST_ROWS - 1]
        if many:
            found[name] = many
    return found


def clipped_runs(log: MeasuredLog) -> dict[str, list[Run]]:
    """Rows at which a sensor is at its end while the other one shows that the truth moves on.

    A tester at its limit stands there, too, but then the voltage only drifts, or the current dies
    away.
    """
    others = {
        "current_A": (log.voltage_V, _current_jump(log)),
        "voltage_V": (log.current_A, STUCK_MOVE_OF_RANGE * _swing(log.current_A)),
    }
    runs: dict[str, list[Run]] = {}
    for name, found in find_saturations(log).items():
        channel = name.rpartition("_")[0]
        other, jump = others[channel]
        change = np.diff(other, prepend=np.nan)
        at_end = getattr(log, channel) == found.value
        inside = at_end & np.concatenate(([False], at_end[:-1]))
        moves = min(np.sum(change[inside] > jump), np.sum(change[inside] < -jump))
        if moves >= STUCK_MOVES and jump > 0.0 and not (channel == "current_A" and _is_held(log)):
            runs[channel] = sorted([*runs.get(channel, []), *runs_of(at_end)])
    return runs


def find_saturations(log: MeasuredLog) -> dict[str, Saturation]:
    """Channels that come to exactly their largest or smallest value for several rows, repeatedly.

    A sensor at the end of its range does this, and a tester at its limit.
    """
    found = {}
    for name, values in (("current_A", log.current_A), ("voltage_V", log.voltage_V)):
        for end, extreme in (("max", np.nanmax(values)), ("min", np.nanmin(values))):
            at_end = values == extreme
            first, last = _runs(at_end)
            visits = int(np.count_nonzero(last - first + 1 >= SATURATED_RUN))
            if visits >= SATURATED_VISITS and extreme != 0.0:
                share = float(np.count_nonzero(at_end)) / len(log)
                found[f"{name}_{end}"] = Saturation(float(extreme), share, visits)
    return found


def _count_within(
    flags: BoolArray, first: NDArray[np.intp], last: NDArray[np.intp]
) -> NDArray[np.intp]:
    """How often a flag is set in each of some runs of rows."""
    edges = np.column_stack((first, last + 1)).ravel()
    counted = np.add.reduceat(np.append(flags, False), edges, dtype=np.intp)
    return counted[::2]


def runs_of(flags: BoolArray) -> list[Run]:
    """Every run of True."""
    return [Run(int(a), int(b)) for a, b in zip(*_runs(flags), strict=True)]


def _runs(flags: BoolArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last row of every run of True."""
    edges = np.diff(np.concatenate(([False], flags, [False])).astype(np.int8))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
