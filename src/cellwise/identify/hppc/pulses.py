"""Current pulses of a log: found, put into roles, and judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cellwise.identify.hppc.phases import LIMITS as PHASES
from cellwise.identify.hppc.phases import Phase, find_phases
from cellwise.identify.hppc.pulse_quality import LIMITS, Pulse, judge
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray


class _PulseLimits(NamedTuple):
    """What a pulse is, and what a move."""

    rest_s: float = 5.0  # before it
    # In a log that is mostly a drive, idling and cruising look like pulses.
    drive: float = 0.5
    drive_rest_s: float = 30.0
    smallest: float = 0.01  # of the largest current: less is a tester's leakage, or a dither
    # Pulses and moves differ in duration by this factor, and the border lies within these; a pulse
    # is no longer than the last in any case, where no gap is seen.
    factor: float = 2.5
    border_s: tuple[float, float] = (4.0, 900.0)
    longest_s: float = 600.0
    margin: float = 1.25  # above the longest pulse
    many_moves: int = 3  # healthy ones for one short pulse, and the test is one of moves


KINDS = _PulseLimits()


def find_pulses(log: CellLog) -> tuple[Pulse, ...]:
    """Find and judge the pulses of a log, short ones and moves, in order.

    A pulse is a constant current right after a rest, followed by a rest or by another constant
    current. Empty where there is none: a log that never rests, a drive, noise.
    """
    return judge(log, _giving_back_are_pulses(_loads(log, find_phases(log))))


def pulses_to_fit(pulses: Sequence[Pulse]) -> tuple[Pulse, ...]:
    """The healthy pulses; where a test has hardly any short ones, its moves serve as pulses."""
    healthy = [p for p in pulses if p.quality == "healthy"]
    short = tuple(p for p in healthy if p.role == "pulse")
    moves = len(healthy) - len(short)
    many = moves >= KINDS.many_moves * max(len(short), 1)
    return tuple(healthy) if many else short or tuple(healthy)


def _loads(log: CellLog, phases: Sequence[Phase]) -> list[Pulse]:
    """Constant currents after a rest, with the voltage-held part that belongs to them."""
    border = _role_border(phases)
    shortest, rested = _shortest(phases)
    current = log.known_current_A()
    charge = np.cumsum(current * log.interval_s) / 3600.0
    smallest = KINDS.smallest * float(np.max(np.abs(current)))
    loads = []
    for k, phase in enumerate(phases):
        if phase.kind not in ("cc", "cv") or k == 0 or phases[k - 1].kind != "rest":
            continue
        # A limit may be reached in the first row already: then all of it is held.
        cc_stop = phase.stop if phase.kind == "cc" else phase.start
        held = phase.kind == "cc" and k + 1 < len(phases) and _same_load(phase, phases[k + 1])
        after = k + 2 if held else k + 1
        if after < len(phases) and phases[after].kind == "dynamic":
            continue
        rest, relaxed = k - 1, after
        while rest > 0 and phases[rest - 1].kind == "rest":
            rest -= 1
        while relaxed < len(phases) and phases[relaxed].kind == "rest":
            relaxed += 1
        start, stop = phase.start, phases[after - 1].stop
        seconds = float(log.time_s[stop - 1] - log.time_s[start - 1])
        level = float(np.median(current[start : max(cc_stop, start + 1)]))
        # Before the log's first row the cell may have rested for as long as one likes.
        known = rest > 0 or rested > KINDS.rest_s
        if known and sum(p.duration_s for p in phases[rest:k]) < rested:
            continue
        if seconds < shortest or (seconds <= border and abs(level) < smallest):
            continue
        loads.append(
            Pulse(
                start=start,
                stop=stop,
                cc_stop=cc_stop,
                rest_before_start=phases[rest].start,
                relax_stop=phases[relaxed - 1].stop,
                current_A=level,
                duration_s=seconds,
                charge_Ah=float(charge[stop - 1] - charge[start - 1]),
                role="move" if seconds > border else "pulse",
            )
        )
    return loads


def _giving_back_are_pulses(loads: Sequence[Pulse]) -> tuple[Pulse, ...]:
    """Long loads against the way of the moves, of no more charge than the short ones, are pulses.

    A weak current that gives back what a strong pulse took lasts ten times as long as that.
    """
    most = KINDS.margin * max((abs(p.charge_Ah) for p in loads if p.role == "pulse"), default=0.0)
    way = sum(p.charge_Ah for p in loads if p.role == "move")
    return tuple(
        replace(p, role="pulse") if p.charge_Ah * way < 0.0 and abs(p.charge_Ah) <= most else p
        for p in loads
    )


def _shortest(phases: Sequence[Phase]) -> tuple[float, float]:
    """Shortest pulse and shortest rest before it that count [s]; a drive holds many short ones."""
    seconds = {"dynamic": 0.0, "rest": 0.0, "cc": 0.0, "cv": 0.0}
    for phase in phases:
        seconds[phase.kind] += phase.duration_s
    drive = seconds["dynamic"] > KINDS.drive * (seconds["cc"] + seconds["cv"])
    return (PHASES.drive_s, KINDS.drive_rest_s) if drive else (0.0, KINDS.rest_s)


def _same_load(phase: Phase, following: Phase) -> bool:
    return following.kind == "cv" and following.current_A * phase.current_A > 0.0


def _role_border(phases: Sequence[Phase]) -> float:
    """Longest duration of a pulse [s]: below the widest gap between the log's durations.

    Every constant current counts, after a rest or not, except those that a limit ended. Durations
    that come more than once are plans; a single one may be a move that was cut.
    """
    following = [*phases[1:], None]
    d: FloatArray = np.sort([
        p.duration_s
        for p, after in zip(phases, following, strict=True)
        if p.kind == "cc" and p.duration_s > 0.0 and not (after and _same_load(p, after))
    ])  # fmt: skip
    if d.size < 2:
        return KINDS.longest_s
    close = np.diff(d) <= LIMITS.same_duration * d[1:]
    repeated = np.append(False, close) | np.append(close, False)
    plan = d[repeated] if repeated.any() else d
    if repeated.any() and plan[0] > KINDS.longest_s and plan[-1] < KINDS.factor * plan[0]:
        # One plan of moves: what is a little shorter is a move, too, that a limit cut.
        return min(float(plan[0]) / KINDS.factor, KINDS.longest_s)
    border = _widest_gap(plan)
    return border if border < KINDS.longest_s else _widest_gap(d[d >= plan[0]])


def _widest_gap(d: FloatArray) -> float:
    """Border above the durations below the widest gap; where there is none, ten minutes."""
    if d.size < 2:
        return KINDS.longest_s
    middle = np.sqrt(d[1:] * d[:-1])
    fitting = (middle > KINDS.border_s[0]) & (middle < KINDS.border_s[1])
    ratio = np.where(fitting, d[1:] / d[:-1], 0.0)
    widest = int(np.argmax(ratio))
    return KINDS.margin * float(d[widest]) if ratio[widest] >= KINDS.factor else KINDS.longest_s
