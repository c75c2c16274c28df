"""How good a current pulse is for identification, and why: judged from the log itself.

Four verdicts, in the LFP paper's words. *Spurious*: an edge without a pulse. *Trimmed*: a voltage
limit ended the constant current. *Distorted*: the response is none of a linear circuit, which
happens at the ends of the SOC range where the OCV bends. *Healthy*: the rest.

The test for distortion needs no model order. With constant current, any circuit of positive
resistances and capacitances answers with a sum of saturating exponentials, and afterwards with
the same ones decaying; the OCV adds a term linear in charge as long as it is straight. So the
measured response is fitted by *all* of them at once, with amplitudes that may not be negative
(non-negative least squares over a grid of time constants). What is left over beyond the noise
no 2-RC model can explain either, whatever its parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from scipy.optimize import nnls

from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray

PulseQuality = Literal["healthy", "trimmed", "distorted", "spurious"]
PulseRole = Literal["pulse", "move"]

# Durations within this share of each other were planned alike.
SAME_DURATION = 0.05
SAME_RATE = 0.03
PLANNED_LOADS = 3
PLANNED_ROWS = 5
SHORT_OF_EXPECTED = 0.93
# Without a limit near, less than this is no pulse that was planned.
SPURIOUS_OF_EXPECTED = 0.5
LIMIT_OF_VOLTAGE = 0.015
PASSED_OF_VOLTAGE = 0.003
MINIMUM_ROWS = 2
MISSING_OF_ROWS = 0.1
RESPONSE_SIGMAS = 5.0
# A misfit of 1 % of the response shifts tau1 of a 60 s pulse by about half (synthetic cells with a
# bending OCV), so the score is one half there. What every pulse of a test shows, as nonlinear
# kinetics in the cold, is not the distortion of some: the border rises with the better pulses, but
# not beyond 3 %.
DISTORTED_OF_RESPONSE = 0.01
WORST_OF_RESPONSE = 0.03
ABOVE_SIBLINGS = 2.0
MINIMUM_SIBLINGS = 6
MISFIT_SIGMAS = 3.0
# A row whose current is this far from its level, as a share of the pulse, is part of an edge.
EDGE_SHARE = 0.03
SETTLING_ROWS = 2
LONGEST_FALL_ROWS = 3
BINS = 40
MINIMUM_BINS = 6
RESTED_BINS = 8
RESTED_PART = 0.4
RELAXATION_OF_PULSE = 10.0
TAUS_PER_DECADE = 3


class Load(NamedTuple):
    """Rows and plain facts of a current pulse, before anybody judged it.

    Rows ``start`` to ``cc_stop`` hold the current, ``cc_stop`` to ``stop`` the voltage (none if
    equal); ``rest_start`` to ``start`` is the rest before, ``stop`` to ``relax_stop`` that after.
    """

    rest_start: int
    start: int
    cc_stop: int
    stop: int
    relax_stop: int
    current_A: float
    role: PulseRole


class Verdict(NamedTuple):
    """Quality of a pulse, the reason in words, and a figure from 0 (useless) to 1."""

    quality: PulseQuality
    reason: str
    score: float


class Channels(NamedTuple):
    """Time [s], finite current of each interval [A] and voltage [V] of a log's rows."""

    time_s: FloatArray
    current_A: FloatArray
    voltage_V: FloatArray


class Misfit(NamedTuple):
    """What no passive circuit explains of a response.

    rms_V, noise_V : what is left, and what the noise alone would leave [V]
    response_V : size of the voltage response [V]
    growth : |dV/dt| in the last third of the pulse over that in the middle third
    """

    rms_V: float
    noise_V: float
    response_V: float
    growth: float

    @property
    def relative(self) -> float:
        """Misfit beyond the noise, as a share of the response."""
        beyond = np.sqrt(max(self.rms_V**2 - self.noise_V**2, 0.0))
        return float(beyond / max(self.response_V, 1e-9))


def judge_loads(
    log: CellLog,
    loads: Sequence[Load],
    *,
    lower_V: float | None = None,
    upper_V: float | None = None,
) -> tuple[Verdict, ...]:
    """Judge every load of a log against its siblings and against a passive circuit.

    Parameters
    ----------
    log : CellLog
    loads : sequence of Load     all of the log's, because durations and limits come from the set
    lower_V, upper_V : float     voltage limits [V]; default: inferred
    """
    v = log.voltage_V
    durations = np.array([_seconds(log, x.start, x.stop) for x in loads])
    held = np.array([x.cc_stop < x.stop for x in loads], dtype=np.bool_)
    expected = _expected(v, loads, durations)
    given = {True: lower_V, False: upper_V}
    limits = {
        discharge: _limit(v, loads, durations, expected, held, discharge)
        if known is None
        else known
        for discharge, known in given.items()
    }
    gaps = log.gap_rows
    found: list[Verdict | None] = []
    for x, t, e in zip(loads, durations.tolist(), expected.tolist(), strict=True):
        limit = limits[x.current_A > 0.0]
        found.append(_spurious(log, x, t, e, gaps, limit) or _trimmed(log, x, t, e, limit))
    channels = _channels(log)
    misfits = [
        None if verdict else passive_misfit(channels, x)
        for x, verdict in zip(loads, found, strict=True)
    ]
    border = {role: _border(misfits, loads, role) for role in ("pulse", "move")}
    return tuple(
        verdict or _shape(channels, x, misfit, border[x.role])
        for x, verdict, misfit in zip(loads, found, misfits, strict=True)
    )


def _border(misfits: Sequence[Misfit | None], loads: Sequence[Load], role: str) -> float:
    shares = [m.relative for m, x in zip(misfits, loads, strict=True) if m and x.role == role]
    usual = float(np.quantile(shares, 0.25)) if len(shares) >= MINIMUM_SIBLINGS else 0.0
    return float(np.clip(ABOVE_SIBLINGS * usual, DISTORTED_OF_RESPONSE, WORST_OF_RESPONSE))


def _channels(log: CellLog) -> Channels:
    return Channels(log.time_s, log.known_current_A(), log.voltage_V)


def _end(v: FloatArray, start: int, stop: int) -> float:
    """Last voltage that was measured in rows start to stop, NaN where there is none."""
    known = np.flatnonzero(np.isfinite(v[start:stop]))
    return float(v[start + known[-1]]) if known.size else float("nan")


def _seconds(log: CellLog, start: int, stop: int) -> float:
    return float(log.time_s[stop - 1] - log.time_s[max(start - 1, 0)])


def _expected(v: FloatArray, loads: Sequence[Load], durations: FloatArray) -> FloatArray:
    """Planned duration of each load [s]: the commonest one of its role and direction.

    A rate has a plan of its own where its loads last equally long and yet end at different
    voltages: a limit would have made the voltages equal and the durations different.
    """
    kind = np.array([f"{x.role} {x.current_A > 0.0}" for x in loads])
    current = np.array([x.current_A for x in loads])
    ends = np.array([_end(v, x.start, x.stop) for x in loads])
    enough = np.array([x.stop - x.start >= PLANNED_ROWS for x in loads], dtype=np.bool_)
    out = np.array([_commonest(durations[kind == k]) for k in kind])
    for k in range(len(loads)):
        alike = (kind == kind[k]) & (np.abs(current - current[k]) <= SAME_RATE * abs(current[k]))
        alike &= np.abs(durations - durations[k]) <= SAME_DURATION * durations[k]
        spread = float(np.ptp(ends[alike]))
        planned = np.count_nonzero(alike) >= PLANNED_LOADS and bool(enough[k])
        if loads[k].role == "pulse" and planned and spread > LIMIT_OF_VOLTAGE * abs(ends[k]):
            out[k] = durations[k]
    return out


def _commonest(durations: FloatArray) -> float:
    """Duration that most loads share within a few per cent; the longer of two as common."""
    if durations.size == 0:
        return 0.0
    near = np.abs(durations[:, None] - durations[None, :]) <= SAME_DURATION * durations[:, None]
    count = near.sum(axis=1)
    return float(np.max(durations[count == count.max()]))


def _limit(
    v: FloatArray,
    loads: Sequence[Load],
    durations: FloatArray,
    expected: FloatArray,
    held: BoolArray,
    discharge: bool,
) -> float | None:
    """Voltage limit that loads of this sign ran into [V]: as held, else where short ones end.

    Nothing else in the log goes beyond a limit, so a short load that ended at a voltage that
    others passed unharmed did not end for it.
    """
    side = np.array([(x.current_A > 0.0) == discharge for x in loads], dtype=np.bool_)
    short = side & ~held & (durations < SHORT_OF_EXPECTED * expected)
    others = v.copy()
    for x, s in zip(loads, short, strict=True):
        if s:
            others[x.start : x.stop] = np.nan
    extreme = float(np.nanmin(others) if discharge else np.nanmax(others))
    levels = [
        float(np.nanmedian(v[x.cc_stop : x.stop]))
        for x, s in zip(loads, side & held, strict=True)
        if s
    ]
    levels = [e for e in levels if abs(e - extreme) <= LIMIT_OF_VOLTAGE * abs(extreme)]
    if levels:
        return float(np.median(levels))
    ends = [_end(v, x.start, x.stop) for x, s in zip(loads, short, strict=True) if s]
    margin = PASSED_OF_VOLTAGE * abs(extreme)
    if discharge:
        return max((e for e in ends if e <= extreme + margin), default=None)
    return min((e for e in ends if e >= extreme - margin), default=None)


def _at_limit(voltage: float, limit: float | None, discharge: bool) -> bool:
    if limit is None:
        return False
    margin = LIMIT_OF_VOLTAGE * abs(limit)
    return voltage <= limit + margin if discharge else voltage >= limit - margin


def _spurious(
    log: CellLog, x: Load, duration: float, expected: float, gaps: BoolArray, limit: float | None
) -> Verdict | None:
    v = log.voltage_V
    inside = v[x.start : x.stop]
    if np.any(gaps[x.start : x.stop]):
        return Verdict("spurious", "a gap in the log lies inside the pulse", 0.0)
    if duration <= 0.0:
        return Verdict("spurious", "no time passes in the pulse", 0.0)
    missing = int(np.count_nonzero(np.isnan(inside)))
    if missing > MISSING_OF_ROWS * inside.size or np.isnan(v[x.rest_start : x.start]).all():
        return Verdict("spurious", f"{missing} voltage samples are missing in the pulse", 0.0)
    moved = _end(v, x.start, x.stop) - _end(v, x.rest_start, x.start)
    noise = _noise(v[x.rest_start : x.start])
    if moved * x.current_A >= 0.0 or abs(moved) < RESPONSE_SIGMAS * noise:
        return Verdict(
            "spurious",
            f"the voltage does not answer: {1e3 * moved:+.1f} mV for {x.current_A:+.3g} A "
            f"(noise {1e3 * noise:.1f} mV)",
            0.0,
        )
    ended = _at_limit(_end(v, x.start, x.stop), limit, x.current_A > 0.0)
    if x.cc_stop < x.stop and not ended:
        return Verdict(
            "spurious",
            f"the current falls at {_end(v, x.start, x.stop):.3f} V, which is no limit here",
            0.0,
        )
    if not ended and x.role == "pulse" and duration < SPURIOUS_OF_EXPECTED * expected:
        return Verdict(
            "spurious",
            f"{duration:.3g} s long where its siblings last {expected:.3g} s, and no limit is near "
            f"({_end(v, x.start, x.stop):.3f} V)",
            0.0,
        )
    if not ended and x.stop - x.start < MINIMUM_ROWS:
        return Verdict("spurious", "a single row long", 0.0)
    return None


def _trimmed(
    log: CellLog, x: Load, duration: float, expected: float, limit: float | None
) -> Verdict | None:
    v, i = log.voltage_V, log.interval_current_A
    constant = _seconds(log, x.start, x.cc_stop) if x.cc_stop > x.start else 0.0
    planned = max(expected, duration)
    if x.cc_stop < x.stop:
        return Verdict(
            "trimmed",
            f"{np.nanmedian(v[x.cc_stop : x.stop]):.3f} V was reached after {constant:.3g} s of "
            f"{planned:.3g} s and held while the current fell from {abs(x.current_A):.4g} A to "
            f"{abs(i[x.stop - 1]):.4g} A",
            0.5 * constant / planned,
        )
    end = _end(v, x.start, x.stop)
    if duration < SHORT_OF_EXPECTED * expected and _at_limit(end, limit, x.current_A > 0.0):
        return Verdict(
            "trimmed",
            f"ended after {duration:.3g} s of {expected:.3g} s at {end:.3f} V, the limit of "
            f"{limit:.3f} V",
            0.5 * duration / expected,
        )
    return None


def _shape(channels: Channels, x: Load, misfit: Misfit | None, border: float) -> Verdict:
    """Healthy or distorted, by what a passive circuit leaves unexplained."""
    if misfit is None:
        return Verdict("healthy", "too few rows to test the shape of the response", 0.5)
    share = misfit.relative
    score = float(1.0 / (1.0 + (share / DISTORTED_OF_RESPONSE) ** 2))
    figure = f"{1e3 * misfit.rms_V:.2g} mV rms of {1e3 * misfit.response_V:.3g} mV"
    if share <= border or misfit.rms_V <= MISFIT_SIGMAS * misfit.noise_V:
        return Verdict("healthy", f"a passive circuit explains all but {figure}", score)
    alone = passive_misfit(channels, x, relaxation=False)
    if alone is not None and alone.relative < 0.5 * share:
        why = "the relaxation does not mirror the pulse"
    else:
        why = (
            f"the response bends against a passive circuit (end of the pulse {misfit.growth:.2g} "
            "times as fast as its middle)"
        )
    return Verdict("distorted", f"{why}: {figure} unexplained, {100 * border:.2g} % allowed", score)


def passive_misfit(
    source: CellLog | Channels, load: Load, *, relaxation: bool = True
) -> Misfit | None:
    """What the best passive circuit leaves of a pulse and its relaxation.

    Fitted, with amplitudes that may not be negative, to the mean voltage in bins that widen with
    the time after each edge: a constant, R0, an RC branch for each time constant of a grid, the
    slope of the OCV; and, with either sign, what is still relaxing from before.

    Parameters
    ----------
    source : CellLog
    load : Load              rows of the pulse
    relaxation : bool        whether the circuit has to explain the rest after the pulse too

    Returns
    -------
    Misfit, or None where the pulse has too few rows to tell
    """
    channels = _channels(source) if isinstance(source, CellLog) else source
    window = _window(channels, load, relaxation)
    if window is None:
        return None
    t, v, n, t_on, t_off = window
    inside = (t > t_on) & (t <= t_off)
    rested = t <= t_on
    if not rested.any() or np.count_nonzero(inside) < MINIMUM_BINS:
        return None
    sign = 1.0 if load.current_A > 0.0 else -1.0
    fall = sign * (float(v[rested][-1]) - v)
    response = float(np.max(fall[inside]))
    if response <= 0.0:
        return None
    # Bins of many rows know more, but no model is better than some 0.1 % of the response.
    noise = _noise(channels.voltage_V[load.rest_start : load.relax_stop])
    sigma = np.sqrt(noise**2 / n + (1e-3 * response) ** 2)[:, None]
    columns = _passive_columns(t, t_on, t_off)
    fitted, _ = nnls(columns / sigma, fall / sigma[:, 0], maxiter=50 * columns.shape[1])
    left = columns @ fitted - fall
    freedom = max(0.0, 1.0 - np.count_nonzero(fitted) / t.size)
    return Misfit(
        rms_V=float(np.sqrt(np.mean(left**2))),
        noise_V=float(np.sqrt(np.mean(noise**2 / n) * freedom)),
        response_V=response,
        growth=_growth(t[inside] - t_on, fall[inside], t_off - t_on),
    )


def _passive_columns(t: FloatArray, t_on: float, t_off: float) -> FloatArray:
    """Responses to the pulse of everything that may add up, one per column."""
    duration = t_off - t_on
    since = np.clip(t - t_on, 0.0, duration)
    after = np.maximum(t - t_off, 0.0)
    shortest = max(0.5 * float(np.min(np.diff(t))), 1e-3)
    longest = 3.0 * duration + float(after[-1])
    count = max(3, int(np.ceil(TAUS_PER_DECADE * np.log10(longest / shortest))))
    tau = np.geomspace(shortest, longest, count)
    branches = -np.expm1(-since[:, None] / tau) * np.exp(-after[:, None] / tau)
    rest = max(t_on - float(t[0]), 1e-3)
    before = np.exp(-(t - t[0])[:, None] / (rest * np.array([1.0, 3.0, 10.0, 30.0])))
    free = np.column_stack((np.ones(t.size), before))
    ohmic = ((t > t_on) & (t <= t_off)).astype(np.float64)
    return np.column_stack((ohmic, branches, since / duration, free, -free))


def _growth(t: FloatArray, fall: FloatArray, duration: float) -> float:
    """|dV/dt| in the last third of the pulse over that in the middle third."""
    at = np.interp(np.array([1.0, 2.0, 3.0]) * duration / 3.0, t, fall)
    middle, end = at[1] - at[0], at[2] - at[1]
    return float(end / middle) if middle > 0.0 else float("inf") if end > 0.0 else 1.0


class _Window(NamedTuple):
    """Bins over the end of the rest, the pulse and its relaxation; current on and off [s]."""

    t: FloatArray
    v: FloatArray
    rows: FloatArray
    on_s: float
    off_s: float


def _window(c: Channels, x: Load, relaxation: bool) -> _Window | None:
    rows = slice(x.start, x.relax_stop)
    share = c.current_A[rows] / x.current_A
    dt = np.diff(c.time_s[x.start - 1 : x.relax_stop])
    t_off = float(c.time_s[x.stop - 1])
    duration = t_off - float(c.time_s[x.start - 1])
    # A rise that takes rows is a switch at the instant that keeps the charge.
    on, off, last = 0, x.stop - x.start, x.relax_stop - x.start
    t_on = t_off - min(duration, float(np.sum(share[:off] * dt[:off])))
    while on < off - 1 and abs(share[on] - 1.0) > EDGE_SHARE:
        on += 1
    pulse_stop = off
    while off < min(last - 1, pulse_stop + LONGEST_FALL_ROWS) and abs(share[off]) > EDGE_SHARE:
        t_off += float(share[off] * dt[off])
        off += 1
    if pulse_stop - on > 10 * SETTLING_ROWS:
        # Voltage and current of one row are not always of one instant.
        on, off = on + SETTLING_ROWS, off + SETTLING_ROWS
    # By then what relaxes from before has become slow.
    shown = min(2.0 * duration, RESTED_PART * (t_on - float(c.time_s[x.rest_start])))
    begin = min(x.start - 1, max(x.rest_start, int(np.searchsorted(c.time_s, t_on - shown))))
    end = int(np.searchsorted(c.time_s, t_off + RELAXATION_OF_PULSE * duration, side="right"))
    pieces = [
        _binned(c, begin, x.start, None, RESTED_BINS),
        _binned(c, x.start + on, x.stop, t_on, BINS),
    ]
    if pieces[0][0].size == 0 or pieces[1][0].size < MINIMUM_BINS:
        return None
    if relaxation:
        pieces.append(_binned(c, x.start + off, min(end, x.relax_stop), t_off, BINS))
    t, v, n = (np.concatenate(p) for p in zip(*pieces, strict=True))
    return _Window(t, v, n, t_on, t_off)


def _binned(
    c: Channels, start: int, stop: int, origin_s: float | None, bins: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean time, mean voltage and number of rows of each bin; bins widen from the origin on."""
    t, v = c.time_s[start:stop], c.voltage_V[start:stop]
    good = np.isfinite(v)
    t, v = t[good], v[good]
    if t.size > bins:
        if origin_s is None:
            edges = np.linspace(0.0, t.size, bins + 1)
        else:
            since = np.maximum(t - origin_s, 1e-9)
            spaced = np.geomspace(since[0], since[-1] * (1.0 + 1e-9), bins + 1)
            edges = np.searchsorted(since, spaced).astype(np.float64)
        cuts = np.unique(edges.astype(np.int64)[:-1])
    else:
        cuts = np.arange(t.size)
    if cuts.size == 0:
        empty = np.zeros(0)
        return empty, empty, empty
    n = np.diff(np.append(cuts, t.size)).astype(np.float64)
    return np.add.reduceat(t, cuts) / n, np.add.reduceat(v, cuts) / n, n


def _noise(voltage_V: FloatArray) -> float:
    """Standard deviation of a voltage sample [V]: scatter of second differences, or resolution."""
    v = voltage_V[np.isfinite(voltage_V)]
    if v.size < 5:
        return 0.0
    scatter = float(np.median(np.abs(np.diff(v, 2))) / (0.6745 * np.sqrt(6.0)))
    steps = np.abs(np.diff(v))
    steps = steps[steps > 1e-9]
    resolution = 0.3 * float(steps.min()) if steps.size else 0.0
    return max(scatter, resolution)
