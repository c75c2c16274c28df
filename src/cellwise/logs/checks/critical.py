"""What is wrong enough with a log to be said before everything else, by every command."""

from __future__ import annotations

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.faults import (
    FaultSegment,
    impossible_runs,
    longest,
    stuck_voltage,
    without,
)
from cellwise.logs.checks.units import IMPOSSIBLE_A, STRING_V
from cellwise.logs.gaps import RowRange, runs_of
from cellwise.notices import Code, Notice
from cellwise.typing import FloatArray
from cellwise.wording import Piece, RowPlace, arg, place

MOST_NAMED = 3  # rows, in a notice

# From where on a log is said to be wrong before anything else.
MOST_REPEATED = 0.05  # share of the rows
MOST_MISSING = 0.1  # share of the rows
SPIKE = 100.0  # times what the rest of the log shows
SPIKE_ROWS = 1e-3  # share of the rows: so few
IMPOSSIBLE = 1e12  # in any unit: bits that were never that quantity
LONGEST_S = 1e10


def without_impossible(log: CellLog) -> tuple[CellLog, list[Notice]]:
    """The log with values that nothing measures, and single ones that no cell has, missing.

    The latter only where they are rare and far above the rest: else the channel is in another unit.
    """
    limits = {"current_A": IMPOSSIBLE_A, "voltage_V": STRING_V}
    found = {}
    for field in ("current_A", "voltage_V", "charge_Ah"):
        values, limit = getattr(log, field), limits.get(field, IMPOSSIBLE)
        if values is None or not max(np.fmax.reduce(values), -np.fmin.reduce(values)) > limit:
            continue
        size = np.abs(values)
        usual = float(np.nanpercentile(size, 99.0))
        wrong = size > max(limit, SPIKE * usual)
        if np.count_nonzero(wrong) > max(1.0, SPIKE_ROWS * size.size):
            wrong = np.zeros(size.size, dtype=bool)
        if runs := runs_of(wrong | (size > IMPOSSIBLE)):
            found[field] = runs
    notices = [_impossible(log, name, runs) for name, runs in found.items()]
    return without(log, found), [n.followed_by("; taken as missing") for n in notices]


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
            + arg("channels", ("time_s", "COLUMN"))
            + ".",
        )


def critical_notices(log: CellLog) -> list[Notice]:
    """What would turn every figure about this log into nonsense."""
    notices = []
    rows = len(log)
    repeated = log.repeated_stamps
    if repeated > MOST_REPEATED * rows:
        text = (
            f"the time LOOKS WRONG: {repeated} of {rows} rows repeat the time of the row before; "
            "what flowed in them counts for no time"
        )
        notices.append(Notice(Code.TIME_REPEATS, text))
    for field in ("current_A", "voltage_V"):
        missing = int(np.count_nonzero(np.isnan(getattr(log, field))))
        if missing > MOST_MISSING * rows:
            name = field.partition("_")[0]
            text = f"the {name} LOOKS WRONG: {missing} of {rows} rows are without it"
            notices.append(Notice(Code.CHANNEL_MISSING, text))
    highest, lowest = np.fmax.reduce(log.current_A), np.fmin.reduce(log.current_A)
    moves = bool(highest > lowest)
    if not (highest > 0.0 or lowest < 0.0):
        notices.append(Notice(Code.CURRENT_ZERO, "the current LOOKS WRONG: it is 0 throughout"))
    impossible = impossible_runs(log)
    notices += [_impossible(log, name, runs) for name, runs in impossible.items()]
    stuck = longest(log, stuck_voltage(without(log, impossible)))
    if stuck is None and moves and np.fmax.reduce(log.voltage_V) == np.fmin.reduce(log.voltage_V):
        stuck = FaultSegment(
            float(log.time_s[0]), log.duration_s
        )  # any current that moves is enough
    if stuck is not None:
        text = f"the voltage LOOKS WRONG: it stands still for {stuck.duration_s:.0f} s "
        since = RowPlace(f"from {stuck.start_s:.1f} s", stuck.rows_of(log))
        said = (text, since, " on while the current moves")
        notices.append(Notice(Code.VOLTAGE_STUCK, said))
    return notices


def _impossible(log: CellLog, channel: str, runs: list[RowRange]) -> Notice:
    """What no cell has, with its rows."""
    quantity, _, unit = channel.partition("_")
    values = getattr(log, channel)
    count = sum(r.last - r.first + 1 for r in runs)
    named: list[Piece] = []
    for run in runs[:MOST_NAMED]:
        before = ", " if named else ""
        named.append(f"{before}{values[run.first]:g} {unit} in ")
        named.append(place(range(run.first, run.last + 1)))
    more = f" and {len(runs) - MOST_NAMED} more times" if len(runs) > MOST_NAMED else ""
    text = f"the {quantity} LOOKS WRONG in {count} row(s): "
    return Notice(Code.IMPOSSIBLE_VALUE, (text, *named, f"{more}, which no cell has"))
