"""Faults of the sensors, found before anything is judged, and the logs without their rows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

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
from cellwise.logs.gaps import RowRange, run_edges
from cellwise.notices import Code, Notice, texts
from cellwise.wording import RowPlace

FEWEST_SPIKES = 3  # a single row may be bad in any log: so many are a sensor that fails
LEAST_PART = 0.2  # of a log whose current was wrong in between: its longest part

# What a channel did, for people.
KINDS = {
    "impossible": "shows what no cell has",
    "stuck": "stands still while the other channel moves",
    "lost": "is missing",
    "spikes": "jumps away and back without the current",
    "saturated": "is held at its end while the other channel goes on moving",
}


@dataclass(frozen=True)
class SensorFault:
    """What a channel of a log did wrong, one of :data:`KINDS`, in which ``runs`` of rows."""

    log: CellLog
    channel: str
    kind: str
    runs: tuple[RowRange, ...]

    @property
    def rows(self) -> int:
        """Number of rows."""
        return sum(r.last - r.first + 1 for r in self.runs)

    @property
    def start_s(self) -> float:
        """Time of the first row."""
        return float(self.log.time_s[self.runs[0].first])

    @property
    def duration_s(self) -> float:
        """From the first row to the last."""
        return float(self.log.time_s[self.runs[-1].last]) - self.start_s

    def notice(self) -> Notice:
        """For people, who count rows from 1."""
        first, last = self.runs[0].first + 1, self.runs[-1].last + 1
        where, several = f"rows {first} to {last}", ""
        if len(self.runs) > 1:
            where, several = f"rows between {first} and {last}", f"{self.rows} "
        name = f"{self.log.name}: " if self.log.name else ""
        how = f"{name}{self.channel} {KINDS[self.kind]} ({several}"
        rows = RowPlace(where, range(first - 1, last))
        return Notice(Code.SENSOR_FAULT, (how, rows, f", from {self.start_s:.0f} s on)"))


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
    runs: dict[str, list[RowRange]] = {}
    for fault in faults:
        runs.setdefault(fault.channel, []).extend(fault.runs)
    wrong = np.zeros(len(log), dtype=bool)
    for run in runs.pop("current_A", []):
        wrong[run.first : run.last + 1] = True
    whole = without(log, runs)
    if np.isfinite(whole.voltage_V).sum() < 2:
        return log, faults
    if not wrong.any() or wrong.all():
        return whole, faults
    first, last = max(zip(*run_edges(~wrong), strict=True), key=lambda run: run[1] - run[0])
    left = whole.part(first, last + 1)
    if len(left) < LEAST_PART * len(log) or not np.isfinite(left.voltage_V).any():
        return whole, faults
    return left, faults


def without_faults(
    groups: Sequence[Sequence[CellLog]], starts: Iterable[float | None]
) -> tuple[list[tuple[CellLog, ...]], list[float | None], tuple[SensorFault, ...]]:
    """Groups of logs without faults, where each starts, and the faults.

    ``starts`` are those of all logs in order; the start of a log whose first rows were cut out is
    not known any more.
    """
    stated = iter(starts)
    kept: list[float | None] = []
    faults: list[SensorFault] = []
    cleaned: list[tuple[CellLog, ...]] = []
    for group in groups:
        left = [clean(log) for log in group]
        for log, (one, found) in zip(group, left, strict=True):
            start = next(stated, None)
            kept.append(start if one.time_s[0] == log.time_s[0] else None)
            faults += found
        cleaned.append(tuple(one for one, _ in left))
    return cleaned, kept, tuple(faults)


def with_faults(
    said: Diagnosis,
    faults: Sequence[SensorFault],
    model: CellModel,
    raw: Sequence[CellLog],
    left: Sequence[CellLog],
) -> Diagnosis:
    """A diagnosis of the logs without faults, the faults before all that was found there.

    The figures are the model's on the ``raw`` logs and on what is ``left`` of them.
    """
    if not faults:
        return said
    pairs = list(zip(raw, left, strict=True))
    bad = [pair for pair in pairs if pair[0] is not pair[1]] or pairs[:1]
    errors_V = np.array([[_rmse_V(model, log) for log in pair] for pair in bad])
    before_V, after_V = (float(v) for v in np.sqrt(np.mean(errors_V**2, axis=0)))
    gain = 1.0 - after_V / before_V if before_V > 0.0 else 0.0
    largest = max(faults, key=lambda f: f.rows)
    values = {
        "rows": float(sum(f.rows for f in faults)),
        "start_s": largest.start_s,
        "duration_s": largest.duration_s,
    }
    one = FoundCause(
        SENSOR_FAULT.name, SENSOR_FAULT.kind, SENSOR_FAULT.meaning, values,
        {name: (value, value) for name, value in values.items()}, before_V, after_V, before_V,
        after_V, gain, (gain, gain), tuple(texts(f.notice() for f in faults)),
        SENSOR_FAULT.confused_with, 1.0,
    )  # fmt: skip
    return replace(said, verdict=one.name, causes=(one, *said.causes), faults=tuple(faults))


def _rmse_V(model: CellModel, log: CellLog) -> float:
    """Of the model on a log from the start that it finds itself [V]."""
    start = initial_soc(model, log, whole_log=True)
    return float(simulate(model, log, start.soc).rmse_V)


def _faults(log: CellLog) -> tuple[SensorFault, ...]:
    """Every fault, by channel."""
    impossible = impossible_runs(log)
    rest = without(log, impossible)
    spikes = [RowRange(int(k), int(k)) for k in find_spikes(rest)]
    found = {
        "impossible": impossible,
        "stuck": stuck_runs(rest),
        "lost": lost_runs(log),
        "spikes": {"voltage_V": spikes} if len(spikes) >= FEWEST_SPIKES else {},
        "saturated": clipped_runs(rest),
    }
    return tuple(
        SensorFault(log, channel, kind, tuple(runs))
        for kind, by_channel in found.items()
        for channel, runs in by_channel.items()
    )
