"""What is wrong enough with a log to be said before everything else, by every command."""

from __future__ import annotations

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.checks.impossible import impossible_runs, without
from cellwise.logs.checks.oddities import Run, stuck_voltage
from cellwise.logs.checks.units import IMPOSSIBLE_CELL_CURRENT_A, LARGEST_STRING_V
from cellwise.logs.measured_log import MeasuredLog
from cellwise.typing import FloatArray

MARK = "LOOKS WRONG"

REPEATED_SHARE = 0.05
MISSING_SHARE = 0.1
# A spike is far above what the rest of the log shows, and rare: one transmission in a thousand.
SPIKE_TIMES = 100.0
SPIKE_SHARE = 1e-3
USUAL_PERCENT = 99.0
MOST_ROWS_NAMED = 3
IMPOSSIBLE = 1e12  # in any unit of any channel
LONGEST_S = 1e10


def is_grave(notice: str) -> bool:
    """Whether a notice says that a channel cannot be what it is taken for."""
    return MARK in notice


def graves_first(notices: list[str]) -> list[str]:
    """The same notices, the grave ones first, each once."""
    return sorted(dict.fromkeys(notices), key=lambda notice: not is_grave(notice))


def without_spikes(channels: dict[str, FloatArray], where: str) -> list[str]:
    """Make single values that no cell can have missing ones; notices that name their rows.

    Only where they are rare and far above the rest: else the channel is in another unit.
    """
    notices = []
    for field, possible, unit in (
        ("current_A", IMPOSSIBLE_CELL_CURRENT_A, "A"),
        ("voltage_V", LARGEST_STRING_V, "V"),
    ):
        values = channels.get(field)
        if values is None:
            continue
        highest, lowest = np.fmax.reduce(values), np.fmin.reduce(values)
        if not max(highest, -lowest) > possible:
            continue
        size = np.abs(values)
        finite = size[np.isfinite(size)]
        if finite.size == 0:
            continue
        usual = float(np.percentile(finite, USUAL_PERCENT))
        spikes = size > max(possible, SPIKE_TIMES * usual)
        count = int(np.count_nonzero(spikes))
        if not 0 < count <= max(1.0, SPIKE_SHARE * values.size):
            continue
        rows = np.flatnonzero(spikes)
        named = ", ".join(f"{values[k]:g} {unit} in row {k + 1}" for k in rows[:MOST_ROWS_NAMED])
        more = f" and {count - MOST_ROWS_NAMED} more" if count > MOST_ROWS_NAMED else ""
        channels[field] = np.where(spikes, np.nan, values)
        notices.append(
            f"the {field.partition('_')[0]} {MARK} in {count} row(s) of {where}: {named}{more}, "
            f"where it is otherwise below {usual:.3g} {unit}; taken as missing"
        )
    return notices


def without_impossible(channels: dict[str, FloatArray], where: str) -> list[str]:
    """Make numbers that nothing measures missing ones: bits that were never that quantity."""
    notices = []
    for field, values in channels.items():
        if field == "time_s":
            continue
        highest, lowest = np.fmax.reduce(values), np.fmin.reduce(values)
        if not max(highest, -lowest) > IMPOSSIBLE:
            continue
        wrong = np.abs(values) > IMPOSSIBLE
        channels[field] = np.where(wrong, np.nan, values)
        row = int(np.flatnonzero(wrong)[0])
        notices.append(
            f"the {field.partition('_')[0]} {MARK} in {np.count_nonzero(wrong)} row(s) of {where}, "
            f"row {row + 1} first ({values[row]:g}); taken as missing"
        )
    return notices


def check_time_possible(time_s: FloatArray, where: str) -> None:
    """Refuse a log that would be longer than centuries.

    Raises
    ------
    InputError        it is
    """
    if time_s.size and np.max(np.abs(time_s)) > LONGEST_S:
        row = int(np.argmax(np.abs(time_s) > LONGEST_S))
        raise InputError(
            f"a time of {time_s[row]:.3g} s from the log's start in row {row + 1} of {where}",
            "a log of less than 300 years",
            "Check the time column and its unit, or repair the row.",
        )


def check_time_moves(time_s: FloatArray, where: str) -> None:
    """Refuse rows that all have the same time.

    Raises
    ------
    InputError        they have
    """
    if time_s.size > 1 and time_s[-1] == time_s[0] and np.ptp(time_s) == 0.0:
        raise InputError(
            f"the same time, {time_s[0]:g} s, in all {time_s.size} rows of {where}",
            "a time that goes on",
            "Check the export; if the time stands in another column, name it with "
            "`channels={'time_s': 'COLUMN'}`.",
        )


def grave_notices(log: MeasuredLog) -> list[str]:
    """What would turn every figure about this log into nonsense."""
    notices = []
    rows = len(log)
    repeated = log.repeated_stamps
    if repeated > REPEATED_SHARE * rows:
        notices.append(
            f"the time {MARK}: {repeated} of {rows} rows repeat the time of the row before; what "
            "flowed in them counts for no time"
        )
    for field in ("current_A", "voltage_V"):
        missing = int(np.count_nonzero(np.isnan(getattr(log, field))))
        if missing > MISSING_SHARE * rows:
            notices.append(
                f"the {field.partition('_')[0]} {MARK}: {missing} of {rows} rows are without it"
            )
    if not (np.fmax.reduce(log.current_A) > 0.0 or np.fmin.reduce(log.current_A) < 0.0):
        notices.append(f"the current {MARK}: it is 0 throughout")
    impossible = impossible_runs(log)
    notices += [_impossible(log, name, runs) for name, runs in impossible.items()]
    stuck = stuck_voltage(without(log, impossible))
    if stuck is not None:
        notices.append(
            f"the voltage {MARK}: it stands still for {stuck.duration_s:.0f} s from "
            f"{stuck.start_s:.1f} s on while the current moves"
        )
    return notices


def _impossible(log: MeasuredLog, channel: str, runs: list[Run]) -> str:
    """What no cell has, with its rows (people count from 1)."""
    quantity, _, unit = channel.partition("_")
    values = getattr(log, channel)
    count = sum(r.last - r.first + 1 for r in runs)
    named = ", ".join(
        f"{values[r.first]:g} {unit} in row{f's {r.first + 1} to' if r.last > r.first else ''} "
        f"{r.last + 1}"
        for r in runs[:MOST_ROWS_NAMED]
    )
    more = f" and {len(runs) - MOST_ROWS_NAMED} more times" if len(runs) > MOST_ROWS_NAMED else ""
    return f"the {quantity} {MARK} in {count} row(s): {named}{more}, which no cell has"
