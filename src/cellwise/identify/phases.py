"""A log cut into phases: rest, constant current, constant voltage, dynamic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from cellwise.identify.edges import CurrentScale, Plateaus, current_scale, find_plateaus
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

PhaseKind = Literal["rest", "cc", "cv", "dynamic"]

# Rows between two plateaus up to this long are the tester's rise, not a phase of their own.
RAMP_ROWS = 8
RAMP_S = 3.0
# Levels held for less than this, one after another, are a drive.
DYNAMIC_S = 5.0
DYNAMIC_LEVELS = 4
# A single row at another level is a phase only where a row is this long.
SLOW_ROW_S = 5.0
VOLTAGE_SIGMAS = 6.0
VOLTAGE_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Phase:
    """A stretch of a log in which the tester did one thing.

    Rows ``start`` to ``stop`` (not included) are the rows whose *intervals* belong to the phase:
    row k carries the interval from row k-1 to row k. The phase begins at the time of row
    ``start - 1``, and the voltage there is ``voltage_start_V``.

    kind : ``rest``, ``cc`` (constant current), ``cv`` (voltage held while the current falls),
        ``dynamic`` (anything else)
    current_A : mean over time, positive on discharge [A]
    duration_s : length [s]
    charge_Ah : charge removed, by the tester's counter where there is one [Ah]
    voltage_start_V, voltage_end_V : at the instants at which it begins and ends [V]
    """

    kind: PhaseKind
    start: int
    stop: int
    current_A: float
    duration_s: float
    charge_Ah: float
    voltage_start_V: float
    voltage_end_V: float

    @property
    def charging(self) -> bool:
        """Whether charge flows into the cell."""
        return self.kind != "rest" and self.current_A < 0.0

    @property
    def discharging(self) -> bool:
        """Whether charge flows out of the cell."""
        return self.kind != "rest" and self.current_A > 0.0


class _Span(NamedTuple):
    kind: PhaseKind
    start: int
    stop: int
    level_A: float


def find_phases(log: CellLog, *, rest_current_A: float | None = None) -> tuple[Phase, ...]:
    """Cut a log into phases that follow one another without gap or overlap.

    Parameters
    ----------
    log : CellLog
    rest_current_A : float       current up to which the cell rests [A]; default: from the
                                 noise, zero and range of the current

    Returns
    -------
    tuple of Phase, in order; together they hold every row
    """
    current = log.known_current_A()
    scale = current_scale(current)
    if rest_current_A is not None:
        scale = scale._replace(rest_A=rest_current_A)
    plateaus = find_plateaus(current, scale)
    voltage = _filled(log.voltage_V)
    spans = _assemble(plateaus, current, voltage, log, scale)
    spans = _join_cv(spans, voltage, voltage_tolerance(log), scale)
    spans = _join_dynamic(spans, log)
    return _finish(spans, current, voltage, log)


def voltage_tolerance(log: CellLog) -> float:
    """Scatter within which a voltage counts as held [V]: noise and resolution of the log."""
    v = _filled(log.voltage_V)
    n = v.size // 8 * 8
    noise = 0.0
    if n:
        spread = np.median(np.abs(np.diff(v[:n].reshape(-1, 8), axis=1)), axis=1)
        noise = float(np.quantile(spread, 0.2)) / (0.6745 * np.sqrt(2.0))
    return max(VOLTAGE_SIGMAS * noise, VOLTAGE_TOLERANCE * float(np.median(np.abs(v))))


def _filled(voltage_V: FloatArray) -> FloatArray:
    bad = np.isnan(voltage_V)
    if not bad.any():
        return voltage_V
    rows = np.arange(voltage_V.size)
    return np.interp(rows, rows[~bad], voltage_V[~bad])


def _assemble(
    plateaus: Plateaus, current: FloatArray, voltage: FloatArray, log: CellLog, scale: CurrentScale
) -> list[_Span]:
    """Plateaus and what lies between them, as spans that touch."""
    spans: list[_Span] = []
    tolerance = voltage_tolerance(log)
    at = 0
    n = len(log)
    for start, stop, level, rest in zip(*(a.tolist() for a in plateaus), strict=True):
        kind = "rest" if rest else "cc"
        if start > at:
            before = spans[-1] if spans else None
            between = _between(at, start, level, before, current, voltage, log, tolerance, scale)
            if between is None:
                start = at
            else:
                spans.append(between)
        spans.append(_Span(kind, start, stop, level))
        at = stop
    if at < n:
        level = float(np.mean(current[at:n]))
        if n - at == 1 and spans:  # the last row alone says nothing
            last = spans.pop()
            spans.append(last._replace(stop=n))
        elif _held(at, n, current, voltage, tolerance):
            spans.append(_Span("cv", at, n, level))
        else:
            spans.append(_Span("dynamic", at, n, level))
    return spans


def _between(
    a: int,
    b: int,
    level_after: float,
    before: _Span | None,
    current: FloatArray,
    voltage: FloatArray,
    log: CellLog,
    tolerance: float,
    scale: CurrentScale,
) -> _Span | None:
    """What rows a to b between two plateaus are; None: the rise to the level that follows."""
    level = float(np.mean(current[a:b]))
    if _held(a, b, current, voltage, tolerance):
        return _Span("cv", a, b, level)
    duration = log.time_s[b - 1] - log.time_s[max(a - 1, 0)]
    if b - a == 1:
        alone = before is not None and abs(before.level_A - level_after) <= scale.step_A
        return _Span("cc", a, b, level) if alone and duration >= SLOW_ROW_S else None
    if b - a <= RAMP_ROWS and duration <= RAMP_S:
        return None
    return _Span("dynamic", a, b, level)


def _held(a: int, b: int, current: FloatArray, voltage: FloatArray, tolerance: float) -> bool:
    """Whether the voltage is held over rows a to b while the current falls towards zero."""
    if b - a < 2:
        return False
    i, v = current[a:b], voltage[a:b]
    if np.min(i) * np.max(i) <= 0.0:
        return False
    size = np.abs(i)
    third = max(1, (b - a) // 3)
    falls = np.mean(size[-third:]) < np.mean(size[:third])
    low, high = np.quantile(v, (0.05, 0.95))
    return bool(falls and high - low <= 2.0 * tolerance)


def _join_cv(
    spans: list[_Span], voltage: FloatArray, tolerance: float, scale: CurrentScale
) -> list[_Span]:
    """Steps of a falling current at one voltage belong to one constant-voltage phase."""
    out: list[_Span] = []
    for span in spans:
        last = out[-1] if out else None
        if (
            last is not None
            and last.kind == "cv"
            and span.kind in ("cc", "cv")
            and span.level_A * last.level_A > 0.0
            and abs(span.level_A) < abs(last.level_A) + scale.step_A
            and np.all(np.abs(voltage[span.start : span.stop] - voltage[last.stop - 1]) <= 2.0 * tolerance)
        ):
            out[-1] = last._replace(stop=span.stop, level_A=span.level_A)
        else:
            out.append(span)
    return out


def _join_dynamic(spans: list[_Span], log: CellLog) -> list[_Span]:
    """Short levels one after another, and what moves between them, are one dynamic phase."""
    t = log.time_s
    short = [
        s.kind == "dynamic"
        or (s.kind != "cv" and t[s.stop - 1] - t[max(s.start - 1, 0)] < DYNAMIC_S)
        for s in spans
    ]
    out: list[_Span] = []
    k = 0
    while k < len(spans):
        end = k
        while end < len(spans) and short[end]:
            end += 1
        group = spans[k:end]
        if len(group) >= DYNAMIC_LEVELS or (len(group) > 1 and any(s.kind == "dynamic" for s in group)):
            out.append(_Span("dynamic", group[0].start, group[-1].stop, 0.0))
            k = end
        else:
            out.append(spans[k])
            k += 1
    return out


def _finish(
    spans: list[_Span], current: FloatArray, voltage: FloatArray, log: CellLog
) -> tuple[Phase, ...]:
    charge = log.counted_charge_Ah()
    flow = np.concatenate(([0.0], np.cumsum(current * log.interval_s)))
    phases = []
    for kind, start, stop, _ in spans:
        first = max(start - 1, 0)
        duration = float(log.time_s[stop - 1] - log.time_s[first])
        mean = (
            (flow[stop] - flow[start]) / duration
            if duration > 0.0
            else float(np.mean(current[start:stop]))
        )
        phases.append(
            Phase(
                kind=kind,
                start=start,
                stop=stop,
                current_A=float(mean),
                duration_s=duration,
                charge_Ah=float(charge[stop - 1] - charge[first]),
                voltage_start_V=float(voltage[first]),
                voltage_end_V=float(voltage[stop - 1]),
            )
        )
    return tuple(phases)
