"""Faults of the sensors, found before anything is judged, and the logs without their rows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.diagnose.causes.catalogue import SENSOR_FAULT
from cellwise.diagnose.result import Diagnosis, FoundCause
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.faults import (
    clipped_runs,
    find_spikes,
    impossible_runs,
    lost_runs,
    stuck_runs,
    without,
)
from cellwise.logs.gaps import Run, run_edges


class Failing(NamedTuple):
    """A single row may be bad in any log; ``spikes`` of them are a sensor that fails.

    Of a log whose current was wrong in between, the longest part must be ``least_part`` of it.
    """

    spikes: int = 3
    least_part: float = 0.2


FAILING = Failing()

Kind = Literal["impossible", "stuck", "saturated", "spikes", "lost"]
Starts = list[float | str]


@dataclass(frozen=True)
class SensorFault:
    """What a channel of a log did wrong, where.

    ``runs`` are its rows, ``log`` the log's name.
    """

    log: str
    channel: str
    kind: Kind
    runs: tuple[Run, ...]
    start_s: float
    duration_s: float

    @property
    def rows(self) -> int:
        """Number of rows."""
        return sum(r.last - r.first + 1 for r in self.runs)

    def text(self) -> str:
        """For people."""
        how = {
            "impossible": "shows what no cell has",
            "stuck": "stands still while the other channel moves",
            "saturated": "is held at its end while the other channel goes on moving",
            "spikes": "jumps away and back without the current",
            "lost": "is missing",
        }[self.kind]
        first, last = self.runs[0].first + 1, self.runs[-1].last + 1  # people count from 1
        where = f"rows {first} to {last}"
        if len(self.runs) > 1:
            where = f"{self.rows} rows between {first} and {last}"
        name = f"{self.log}: " if self.log else ""
        return f"{name}{self.channel} {how} ({where}, from {self.start_s:.0f} s on)"


def clean(log: CellLog) -> tuple[CellLog, tuple[SensorFault, ...]]:
    """A log without what its sensors did wrong, and what that was.

    A voltage that is wrong is made missing: its rows are not compared. Where the current was wrong
    nobody knows what flowed, so the longest part without such rows is kept; a stated start goes
    with the first row.

    Parameters
    ----------
    log : CellLog

    Returns
    -------
    CellLog                      the log itself where nothing is wrong
    tuple of SensorFault         by channel
    """
    faults = _faults(log)
    if not faults:
        return log, ()
    runs: dict[str, list[Run]] = {}
    for fault in faults:
        if fault.channel != "current_A":
            runs.setdefault(fault.channel, []).extend(fault.runs)
    whole = without(log, runs)
    if np.isfinite(whole.voltage_V).sum() < 2:
        return log, faults
    wrong = np.zeros(len(log), dtype=bool)
    for fault in faults:
        if fault.channel == "current_A":
            for run in fault.runs:
                wrong[run.first : run.last + 1] = True
    if not wrong.any() or wrong.all():
        return whole, faults
    first, last = max(zip(*run_edges(~wrong), strict=True), key=lambda run: run[1] - run[0])
    stop = last + 1
    part = whole.voltage_V[first:stop]
    if stop - first < FAILING.least_part * len(log) or not np.isfinite(part).any():
        return whole, faults
    return whole.part(first, stop), faults


def without_faults(
    groups: Sequence[Sequence[CellLog]], starts: Iterable[float | str]
) -> tuple[list[tuple[CellLog, ...]], Starts, tuple[SensorFault, ...]]:
    """Groups of logs without faults, where each starts, and the faults.

    ``starts`` are those of all logs in order; the start of a log whose first rows were cut out is
    not known any more.
    """
    known_starts = iter(starts)
    cleaned: list[tuple[CellLog, ...]] = []
    kept: Starts = []
    faults: list[SensorFault] = []
    for group in groups:
        made = []
        for log in group:
            one, found = clean(log)
            start = next(known_starts, "auto")
            kept.append(start if one.time_s[0] == log.time_s[0] else "auto")
            made.append(one)
            faults += found
        cleaned.append(tuple(made))
    return cleaned, kept, tuple(faults)


def with_faults(
    said: Diagnosis, faults: Sequence[SensorFault], model: CellModel, logs: Sequence[CellLog]
) -> Diagnosis:
    """A diagnosis of the logs without faults, the faults before all that was found there.

    ``logs`` are those with the faults: the figures are the model's on them and on the cleaned ones.
    """
    if not faults:
        return said
    pairs = [(raw, clean(raw)[0]) for raw in logs]
    bad = [(raw, left) for raw, left in pairs if left is not raw] or pairs[:1]
    before, after = (
        float(np.sqrt(np.mean([_rmse_V(model, pair[k]) ** 2 for pair in bad]))) for k in (0, 1)
    )
    gain = 1.0 - after / before if before > 0.0 else 0.0
    largest = max(faults, key=lambda f: f.rows)
    values = {
        "rows": float(sum(f.rows for f in faults)),
        "start_s": largest.start_s,
        "duration_s": largest.duration_s,
    }
    one = FoundCause(
        SENSOR_FAULT.name,
        SENSOR_FAULT.kind,
        SENSOR_FAULT.meaning,
        values,
        {name: (value, value) for name, value in values.items()},
        before,
        after,
        before,
        after,
        gain,
        (gain, gain),
        tuple(f.text() for f in faults),
        SENSOR_FAULT.confused_with,
        1.0,
    )
    return replace(said, verdict=one.name, causes=(one, *said.causes))


def _rmse_V(model: CellModel, log: CellLog) -> float:
    """Of the model on a log from the start that it finds itself [V]."""
    start = initial_soc(model, log, whole_log=True)
    return float(simulate(model, log, start.soc).metrics.rmse_V)


def _faults(log: CellLog) -> tuple[SensorFault, ...]:
    """Every fault, by channel."""

    def fault(channel: str, kind: Kind, runs: Sequence[Run]) -> SensorFault:
        begins, ends = log.time_s[runs[0].first], log.time_s[runs[-1].last]
        return SensorFault(
            log.name, channel, kind, tuple(runs), float(begins), float(ends - begins)
        )

    impossible = impossible_runs(log)
    rest = without(log, impossible)
    found = [fault(name, "impossible", runs) for name, runs in impossible.items()]
    found += [fault(name, "stuck", runs) for name, runs in stuck_runs(rest).items()]
    found += [fault(name, "lost", runs) for name, runs in lost_runs(log).items()]
    spikes = find_spikes(rest)
    if spikes.size >= FAILING.spikes:
        found.append(fault("voltage_V", "spikes", [Run(int(k), int(k)) for k in spikes]))
    found += [fault(name, "saturated", runs) for name, runs in clipped_runs(rest).items()]
    return tuple(found)
