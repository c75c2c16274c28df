"""A log cut into phases: rest, constant current, constant voltage, dynamic."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from cellwise.identify.hppc.plateaus import (
    DRIFT,
    RISE_ROWS,
    RISE_S,
    SIGMAS,
    CurrentScale,
    PhaseKind,
    PlateauSpan,
    current_scale,
    find_plateaus,
)
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray


class _PhaseLimits(NamedTuple):
    """What a phase is."""

    drive_s: float = 5.0  # levels held for less, one after another, are a drive ...
    drive_levels: int = 4  # ... from so many on
    # A voltage counts as held within its noise, or within this share of it.
    held: float = 1e-3


LIMITS = _PhaseLimits()


@dataclass(frozen=True)
class Phase:
    """A stretch of a log in which the tester did one thing.

    Rows ``start`` to ``stop`` (not included) are the rows whose *intervals* belong to the phase:
    row k carries the interval from row k-1 to row k: the phase begins at the time of row
    ``start - 1``.

    kind : ``rest``, ``cc`` (constant current), ``cv`` (voltage held while the current falls),
        ``dynamic`` (anything else)
    current_A : mean over time, positive on discharge [A]
    duration_s : length [s]
    charge_Ah : charge removed, by the tester's counter where there is one [Ah]
    """

    kind: PhaseKind
    start: int
    stop: int
    current_A: float
    duration_s: float
    charge_Ah: float

    @property
    def charging(self) -> bool:
        """Whether charge flows into the cell."""
        return self.kind != "rest" and self.current_A < 0.0


class _Signals(NamedTuple):
    """What the cutting looks at: finite current and voltage, and what counts as noise in them."""

    time_s: FloatArray
    current_A: FloatArray
    voltage_V: FloatArray
    tolerance_V: float
    scale: CurrentScale

    def seconds(self, start: int, stop: int) -> float:
        """Length of the intervals of rows start to stop [s]."""
        return float(self.time_s[stop - 1] - self.time_s[max(start - 1, 0)])

    def still(self, start: int, stop: int, at_V: float) -> bool:
        """Whether the voltage of the rows stays at a value."""
        v = self.voltage_V[start:stop]
        return bool(np.max(np.abs(v - at_V)) <= 2.0 * self.tolerance_V)


_FOUND: WeakKeyDictionary[CellLog, tuple[Phase, ...]] = WeakKeyDictionary()


def find_phases(log: CellLog) -> tuple[Phase, ...]:
    """Cut a log into phases that follow one another without gap or overlap; each log once.

    Returns
    -------
    tuple of Phase, in order; together they hold every row
    """
    if log in _FOUND:
        return _FOUND[log]
    current = log.known_current_A()
    scale, voltage = current_scale(current), filled(log.voltage_V)
    signals = _Signals(log.time_s, current, voltage, _voltage_tolerance(voltage), scale)
    spans = _assemble(find_plateaus(current, scale), signals)
    _FOUND[log] = _finish(_join_dynamic(_join_cv(spans, signals), signals), signals, log)
    return _FOUND[log]


def _voltage_tolerance(v: FloatArray) -> float:
    """Scatter within which a voltage counts as held [V]: noise and resolution of the log."""
    n = v.size // 8 * 8
    noise = 0.0
    if n:
        spread = np.partition(np.abs(np.diff(v[:n].reshape(-1, 8), axis=1)), 3, axis=1)[:, 3]
        noise = float(np.quantile(spread, 0.2)) / (0.6745 * np.sqrt(2.0))
    return max(SIGMAS * noise, LIMITS.held * float(np.median(np.abs(v))))


def filled(voltage_V: FloatArray) -> FloatArray:
    """Voltage with straight lines over what is missing, shape (rows,)."""
    bad = np.isnan(voltage_V)
    if not bad.any():
        return voltage_V
    rows = np.arange(voltage_V.size)
    return np.interp(rows, rows[~bad], voltage_V[~bad])


def _assemble(plateaus: list[PlateauSpan], s: _Signals) -> list[PlateauSpan]:
    """Plateaus and what lies between them, as spans that touch."""
    spans: list[PlateauSpan] = []
    at, n = 0, s.time_s.size
    for plateau in plateaus:
        start = plateau.start
        if start > at:
            between, start = _between(at, start, spans[-1] if spans else None, plateau.level_A, s)
            spans.extend(between)
        spans.append(plateau._replace(start=start))
        at = plateau.stop
    if n - at == 1 and spans:  # the last row alone says nothing
        spans[-1] = spans[-1]._replace(stop=n)
    elif at < n:
        spans.extend(_moving(at, n, s)[0])
    return spans


def _between(
    a: int, b: int, before: PlateauSpan | None, after_A: float, s: _Signals
) -> tuple[list[PlateauSpan], int]:
    """What rows a to b between two plateaus are, and where the second one begins with its rise."""
    inside = s.current_A[a:b]
    begin_A = before.level_A if before is not None else float(inside[0])
    rises = b - a == 1 or (s.seconds(a, b) <= RISE_S and _rises(inside, begin_A, after_A, s.scale))
    if rises and not _held(a, b, s):
        return [], a
    return _moving(a, b, s)


def _rises(inside: FloatArray, begin_A: float, end_A: float, scale: CurrentScale) -> bool:
    """Whether rows lead from one level to another: straight on, or in few rows with overshoot."""
    low, high = min(begin_A, end_A), max(begin_A, end_A)
    if inside.size <= RISE_ROWS:
        room = 0.5 * (high - low) + scale.step_A
        return bool(low - room <= np.min(inside) and np.max(inside) <= high + room)
    on = np.diff(inside) * np.sign(end_A - begin_A)
    within = low - scale.step_A <= np.min(inside) and np.max(inside) <= high + scale.step_A
    return bool(within and np.all(on >= -scale.step_A))


def _moving(a: int, b: int, s: _Signals) -> tuple[list[PlateauSpan], int]:
    """Rows that hold no level: constant voltage with what leads to it, or dynamic; where they end.

    The last rows, up to a tester's rise, may lead from the constant voltage to what follows.
    """
    v = s.voltage_V[a:b]
    near = np.flatnonzero(np.abs(v - np.sort(v)[v.size // 2]) <= 1.5 * s.tolerance_V)
    first, last = a + int(near[0]), a + int(near[-1]) + 1
    if last < b and s.seconds(last, b) > RISE_S:
        last = b
    elif last < b and last - first > 1:  # the first row of the fall may be near by its voltage
        change = np.abs(np.diff(s.current_A[last - 2 : last]))[0]
        last -= int(change > DRIFT * abs(s.current_A[last - 2]))
    whole = last - first >= max(3, (b - a) // 2) and _held(first, last, s)
    if not whole and _held(a, b, s):
        first, last, whole = a, b, True
    if not whole:
        return [PlateauSpan("dynamic", a, b, float(np.mean(s.current_A[a:b])))], b
    spans = []
    if first > a:
        head = s.current_A[a:first]
        flat = np.ptp(head) <= max(s.scale.step_A, DRIFT * float(np.max(np.abs(head))))
        kind: PhaseKind = "cc" if flat or s.seconds(a, first) <= RISE_S else "dynamic"
        spans.append(PlateauSpan(kind, a, first, float(np.mean(head))))
    spans.append(PlateauSpan("cv", first, last, float(np.mean(s.current_A[first:last]))))
    return spans, last


def _held(a: int, b: int, s: _Signals) -> bool:
    """Whether the voltage is held over rows a to b while the current falls towards zero."""
    if b - a < 2:
        return False
    i, v = s.current_A[a:b], s.voltage_V[a:b]
    if i[0] * i[-1] <= 0.0 or abs(v[-1] - v[0]) > 3.0 * s.tolerance_V:
        return False
    third = max(1, (b - a) // 3)
    if np.min(i) * np.max(i) <= 0.0 or abs(np.mean(i[-third:])) >= abs(np.mean(i[:third])):
        return False
    low, high = np.quantile(v, (0.05, 0.95)) if v.size > 20 else (np.min(v), np.max(v))
    return bool(high - low <= 2.0 * s.tolerance_V)


def _join_cv(spans: list[PlateauSpan], s: _Signals) -> list[PlateauSpan]:
    """Steps of a falling current at one voltage belong to one constant-voltage phase."""
    out: list[PlateauSpan] = []
    for span in spans:
        while out and _continues(out[-1], span, out[-2] if len(out) > 1 else None, s):
            last = out.pop()
            span = PlateauSpan("cv", last.start, span.stop, span.level_A)
        out.append(span)
    return out


def _continues(
    last: PlateauSpan, span: PlateauSpan, before: PlateauSpan | None, s: _Signals
) -> bool:
    """Whether two spans are parts of one constant-voltage phase."""
    if "rest" in (last.kind, span.kind) or last.level_A * span.level_A <= 0.0:
        return False
    held = float(s.voltage_V[last.stop - 1])
    falls = abs(last.level_A) - abs(span.level_A) >= -s.scale.step_A
    if not falls or not s.still(span.start, span.stop, held):
        return False
    if last.kind == "cv":
        return True
    # A constant current that ends where the voltage is held: all of it was held already, and a
    # larger current went before.
    larger = before is not None and before.kind != "rest" and before.level_A * last.level_A > 0.0
    constant = (last.kind, span.kind) == ("cc", "cv")
    return constant and larger and s.still(last.start, last.stop, held)


def _join_dynamic(spans: list[PlateauSpan], s: _Signals) -> list[PlateauSpan]:
    """Short levels one after another, and what moves between them, are one dynamic phase."""
    out: list[PlateauSpan] = []
    for short, spans_ in groupby(
        spans, lambda x: x.kind == "dynamic" or s.seconds(x.start, x.stop) < LIMITS.drive_s
    ):
        group = list(spans_)
        moves = any(x.kind == "dynamic" for x in group)
        if short and len(group) > 1 and (moves or len(group) >= LIMITS.drive_levels):
            group = [PlateauSpan("dynamic", group[0].start, group[-1].stop, 0.0)]
        out += group
    return out


def _finish(spans: list[PlateauSpan], s: _Signals, log: CellLog) -> tuple[Phase, ...]:
    charge = log.counted_charge_Ah()
    flow = np.concatenate(([0.0], np.cumsum(s.current_A * log.interval_s)))
    phases = []
    for kind, start, stop, _ in spans:
        first = max(start - 1, 0)
        seconds = float(log.time_s[stop - 1] - log.time_s[first])
        mean = (flow[stop] - flow[start]) / seconds if seconds > 0.0 else s.current_A[start]
        moved = float(charge[stop - 1] - charge[first])
        phases.append(Phase(kind, start, stop, float(mean), seconds, moved))
    return tuple(phases)
