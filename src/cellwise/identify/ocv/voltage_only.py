"""Discharges of an unknown load, by time and voltage alone, to a table of what remains.

For boards without a current sensor. The table is over the remaining fraction of the running time at
the usual load, not over SOC: without a current neither charge nor resistance can be determined.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.special import stdtrit

from cellwise.arguments import file_path
from cellwise.errors import InputError
from cellwise.files import write_atomically
from cellwise.identify.assemble import monotone
from cellwise.logs.files.assembly import assemble, complete
from cellwise.logs.files.format import detect_format, one_battery
from cellwise.logs.files.source import ReadOptions, open_source
from cellwise.logs.formats import FORMATS
from cellwise.logs.packs.cells import to_cell
from cellwise.logs.reading import read_channels
from cellwise.logs.stated import Stated, plain_name
from cellwise.notices import Code, Notice
from cellwise.records import need
from cellwise.typing import FloatArray

KIND = "voltage table"
POINTS = 11  # what most firmware has: every tenth
AVERAGE_S = 60.0
TAIL = 0.975  # of the band of 95 %, as of two deviations
UNKNOWN = (
    "capacity: twice the capacity at twice the load shows the same voltages at the same times",
    "resistance: the voltage under a load that is not known cannot be divided by it",
    "the load: another one than that of these discharges moves the voltage and the running time",
    "SOC: the table's fraction is of the time that is left at the usual load",
    "temperature and age: the table holds as far as these discharges had them",
)


class VoltageLog(NamedTuple):
    """Time from the log's start [s] and voltage of one cell [V], both of shape (n,)."""

    name: str
    time_s: FloatArray
    voltage_V: FloatArray


class Discharge(NamedTuple):
    """One discharge from the common full voltage to the common empty one.

    ``remaining`` (n,) is the fraction of its time that is left, ``voltage_V`` (n,) the mean of a
    window, ``hours`` how long it took, ``gap_s`` its longest time without a row.
    """

    name: str
    remaining: FloatArray
    voltage_V: FloatArray
    hours: float
    gap_s: float


@dataclass(frozen=True, eq=False)
class VoltageTable:
    """Voltage over the remaining fraction of the running time, with its band.

    Parameters
    ----------
    remaining : (N,) float      0 (empty) to 1 (full), even
    voltage_V : (N,) float      mean voltage there, rising
    low, high : (N,) float      band of 95 % of what remains where the table says ``remaining``
    full_V, empty_V : float     voltages that count as 1 and 0
    average_s : float           over how long a voltage is averaged before it is looked up [s]
    hours : tuple of float      how long each discharge took
    names : tuple of str        the discharges
    notices : tuple of Notice   what a person should know of the logs
    """

    remaining: FloatArray
    voltage_V: FloatArray
    low: FloatArray
    high: FloatArray
    full_V: float
    empty_V: float
    average_s: float
    hours: tuple[float, ...]
    names: tuple[str, ...]
    notices: tuple[Notice, ...] = ()

    def remaining_at(self, voltage_V: FloatArray) -> FloatArray:
        """Remaining fraction by an averaged voltage [V], linear between points, 0..1."""
        return np.interp(voltage_V, self.voltage_V, self.remaining)

    def band_at(self, remaining: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Ends of the band where the table says ``remaining``."""
        return tuple(np.interp(remaining, self.remaining, v) for v in (self.low, self.high))  # type: ignore[return-value]

    def points(self, count: int) -> FloatArray:
        """Voltages at ``count`` even fractions from empty to full, at least 1 mV apart [V]."""
        even = np.interp(np.linspace(0.0, 1.0, count), self.remaining, self.voltage_V)
        rise = 1e-3 * np.arange(count)
        return np.asarray(np.maximum.accumulate(np.round(even, 3) - rise) + rise)

    def to_dict(self) -> dict[str, Any]:
        """As JSON: its fields, what it is, and what cannot be known."""
        said = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in asdict(self).items()}
        said["notices"] = [notice.text for notice in self.notices]
        return {"kind": KIND, **said, "unknown": list(UNKNOWN)}


def write_voltage_table(table: VoltageTable, path: str | Path) -> None:
    """Write a table as JSON; the file appears whole or not at all.

    Raises
    ------
    InputError        as `write_atomically`
    """
    write_atomically(path, json.dumps(table.to_dict(), indent=1, allow_nan=False) + "\n")


def read_voltage_table(path: str | Path) -> VoltageTable:
    """Read a table that was written.

    Raises
    ------
    InputError        no such file, or another one
    """
    place = file_path("path", path)
    try:
        said = json.loads(place.read_text(encoding="utf-8"))
        columns = np.array([said[k] for k in ("remaining", "voltage_V", "low", "high")], float)
        full, empty, average = (float(said[k]) for k in ("full_V", "empty_V", "average_s"))
        hours, names = tuple(map(float, said["hours"])), tuple(map(str, said["names"]))
        rises = columns.ndim == 2 and bool((np.diff(columns[:2]) > 0.0).all())
        if said["kind"] == KIND and columns.shape[1] > 1 and np.isfinite(columns).all() and rises:
            return VoltageTable(
                columns[0], columns[1], columns[2], columns[3], full, empty, average, hours, names
            )
    except (OSError, ValueError, LookupError, TypeError):
        pass
    raise InputError(
        f"'{place}', which is no table of remaining time",
        "a file that `cellwise identify` wrote of discharges by voltage alone",
        "Give one.",
    )


def read_voltage(path: str | Path | Stated, **options: Any) -> VoltageLog:
    """Read time and voltage of a log, in any format; it needs no current, and one is not looked at.

    ``options`` are those of `ReadOptions`.

    Raises
    ------
    InputError        as `read_log`, but for a current that is missing
    """
    stated = Stated.of(path)
    options = {"instance": stated.instance} | {k: v for k, v in options.items() if v is not None}
    source = open_source(stated.path, None, ReadOptions(**options))
    known = detect_format(source, FORMATS)
    channels = [replace(c, required=c.required and c.field != "current_A") for c in known.channels]
    known = replace(known, channels=tuple(channels))
    raw = one_battery(read_channels(source, known), source, known)
    volts = {k: v for k, v in raw.channels.items() if k.startswith(("time", "step_time", "day"))}
    volts |= {k: v for k, v in raw.channels.items() if k.endswith("_V")}
    volts["current_A"] = np.zeros_like(next(iter(volts.values())))  # a log cannot be without
    raw = complete(replace(raw, channels=volts), "discharge-positive", source.where)
    raw = to_cell(raw, source.options, source.where)
    name = plain_name(source.path)
    log = assemble(raw, None, source.path, name, check_sign=False)
    known_rows = np.isfinite(log.voltage_V)
    return VoltageLog(name, log.time_s[known_rows], log.voltage_V[known_rows])


def identify_voltage_table(
    logs: Sequence[VoltageLog],
    *,
    points: int = POINTS,
    full_V: float | None = None,
    empty_V: float | None = None,
    average_s: float = AVERAGE_S,
) -> VoltageTable:
    """A table of the remaining fraction of the running time, and its band, from discharges.

    The table is the least-squares line between its points of all discharges, each of the same
    weight. The band is that of a discharge that is not among them: of Student's t over what tables
    without a discharge say of it (jackknife), for what differs from one discharge to another, and
    of two deviations for what differs within one.

    Parameters
    ----------
    logs : sequence      of one kind of cell in one kind of device; a log may hold several
                         discharges, with charges between
    points : int         of the table, 3 to 101
    full_V : float       voltage that counts as full [V]; None: the highest that every log shows
    empty_V : float      voltage at which the device ends [V]; None: the lowest that every log shows
    average_s : float    over how long the device averages its voltage [s]

    Raises
    ------
    InputError           fewer than two discharges; a log that is not full, or not empty; too few
                         rows; numbers that cannot be
    """
    need(3 <= points <= 101, f"{points} points", "3 to 101 points")
    need(0.0 < average_s <= 86400.0, f"an average over {average_s:g} s", "0 to 86400 s, above 0")
    found, notices = discharges_of(logs, full_V, empty_V, average_s)
    need(
        len(found.each) >= 2,
        f"{len(found.each)} discharge(s) from {found.full_V:.3f} to {found.empty_V:.3f} V",
        "two or more, for a band; five or more for a narrow one",
        "Add logs of the same device, from full to empty.",
    )
    grid = np.linspace(0.0, 1.0, points)
    for one in found.each:
        need(
            one.remaining.size >= points,
            f"{one.remaining.size} voltages of '{one.name}', averaged over {average_s:g} s, for "
            f"{points} points",
            "at least one for each point",
            "Ask for fewer points, a shorter average, or log more often.",
        )
        gap = one.gap_s / (3600.0 * one.hours)
        if gap > 0.5 / (points - 1):
            text = f": {100 * gap:.0f} % of a discharge has no row; it counts as running time"
            notices.append(Notice(Code.GAP, text, log=one.name))
    volts = _fit(found.each, grid)
    low, high = _band(found.each, grid)
    return VoltageTable(
        remaining=grid,
        voltage_V=volts,
        low=low,
        high=high,
        full_V=found.full_V,
        empty_V=found.empty_V,
        average_s=average_s,
        hours=tuple(one.hours for one in found.each),
        names=tuple(one.name for one in found.each),
        notices=tuple(notices),
    )


class Discharges(NamedTuple):
    """Discharges between two voltages that all of them pass."""

    each: list[Discharge]
    full_V: float
    empty_V: float


def discharges_of(
    logs: Sequence[VoltageLog], full_V: float | None, empty_V: float | None, average_s: float
) -> tuple[Discharges, list[Notice]]:
    """The discharges of logs, each from the full voltage to the empty one; parameters as above.

    Raises
    ------
    InputError        a log that does not come to a voltage that was stated; full is not above empty
    """
    means = [_averaged(log, average_s) for log in logs]
    need(bool(means), "no log", "discharges by time and voltage", "Name some.")
    tops, ends = np.array([_largest_fall(m.voltage_V) for m in means]).T
    full = float(tops.min()) if full_V is None else full_V
    empty = float(ends.max()) if empty_V is None else empty_V
    for log, top, end in zip(logs, tops, ends, strict=True):
        need(
            top >= full and end <= empty,
            f"'{log.name}', which goes from {top:.3f} to {end:.3f} V, of {average_s:g} s each",
            f"a discharge from {full:.3f} to {empty:.3f} V",
            "Leave it out, or state voltages that it comes to.",
        )
    need(
        full > empty,
        f"a highest voltage of {full:.3f} V that every log shows, and a lowest of {empty:.3f} V",
        "full above empty",
        "Leave out the log that does not go from full to empty, or state both voltages.",
    )
    each = [d for log, m in zip(logs, means, strict=True) for d in _cut(log, m, full, empty)]
    # A log that begins or ends far inside shortens all of them: who has others should know.
    span = full - empty
    notices = []
    for stated, reach, which, does, held, to in (
        (full_V, tops - full, np.argmin(tops), "begins", full, "from"),
        (empty_V, empty - ends, np.argmax(ends), "ends", empty, "to"),
    ):
        if stated is None and np.median(reach) > 0.1 * span:
            text = f": it {does} at {held:.3f} V, and all discharges are taken {to} there"
            notices.append(Notice(Code.DISCHARGE_CUT, text, log=logs[int(which)].name))
    return Discharges(each, full, empty), notices


def _largest_fall(volts: FloatArray) -> tuple[float, float]:
    """Voltages from and to which a log falls most: a charge behind a discharge is none before."""
    highest = np.maximum.accumulate(volts)
    end = int(np.argmax(highest - volts))
    return float(highest[end]), float(volts[end])


def _averaged(log: VoltageLog, average_s: float) -> VoltageLog:
    """Means of windows; one of rows that are rarer is its row."""
    window = np.floor((log.time_s - log.time_s[0]) / average_s).astype(np.int64)
    _, place, count = np.unique(window, return_inverse=True, return_counts=True)
    time, volts = (np.bincount(place, x) / count for x in (log.time_s, log.voltage_V))
    return VoltageLog(log.name, time, volts)


def _cut(log: VoltageLog, mean: VoltageLog, full: float, empty: float) -> list[Discharge]:
    """Every stretch from where a voltage is no longer full to the first that is empty.

    What passes before its first row, a rest that was not logged say, is not of the discharge.
    """
    marks = np.flatnonzero((mean.voltage_V >= full) | (mean.voltage_V <= empty))
    is_full = mean.voltage_V[marks] >= full
    found: list[Discharge] = []
    for k in np.flatnonzero(is_full[:-1] & ~is_full[1:]):
        rows = slice(marks[k] + 1, marks[k + 1] + 1)
        time, volts = mean.time_s[rows], mean.voltage_V[rows]
        length = float(time[-1] - time[0])
        if length <= 0.0:
            continue  # from full to empty within a row: a contact that was lost
        inside = (log.time_s >= time[0]) & (log.time_s <= time[-1])
        gap = float(np.diff(log.time_s[inside]).max(initial=0.0))
        name = log.name if not found else f"{log.name} ({len(found) + 1})"
        found.append(Discharge(name, (time[-1] - time) / length, volts, length / 3600.0, gap))
    return found


def _hats(at: FloatArray, grid: FloatArray) -> FloatArray:
    """Weights of the points of a grid in a linear interpolation, of shape (len(at), len(grid))."""
    return np.maximum(0.0, 1.0 - np.abs(at[:, None] - grid) * (grid.size - 1))


def _fit(discharges: Sequence[Discharge], grid: FloatArray) -> FloatArray:
    """Voltages of the points, rising [V]."""
    scale = [1.0 / np.sqrt(d.remaining.size) for d in discharges]
    each = zip(discharges, scale, strict=True)
    rows = np.vstack([s * _hats(d.remaining, grid) for d, s in each])
    volts = np.concatenate([s * d.voltage_V for d, s in zip(discharges, scale, strict=True)])
    return monotone(np.linalg.lstsq(rows, volts, rcond=None)[0])


def _band(discharges: Sequence[Discharge], grid: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ends of the band, by how far tables without a discharge are off on it."""
    count = len(discharges)
    weight, mean, square = (np.zeros((count, grid.size)) for _ in range(3))
    for k, one in enumerate(discharges):
        others = _fit([*discharges[:k], *discharges[k + 1 :]], grid)
        said = np.interp(one.voltage_V, others, grid)
        hats, off = _hats(said, grid), one.remaining - said
        weight[k] = hats.sum(axis=0)
        mean[k], square[k] = (hats.T @ off**p / np.maximum(weight[k], 1e-9) for p in (1, 2))
    seen = weight > 0.0
    have = seen.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        centre = np.where(seen, mean, 0.0).sum(axis=0) / have
        between = np.where(seen, (mean - centre) ** 2, 0.0).sum(axis=0) / (have - 1)
        within = np.where(seen, square - mean**2, 0.0).sum(axis=0) / have
        factor = stdtrit(np.maximum(have - 1, 1), TAIL)
        half = np.sqrt(factor**2 * between * (1.0 + 1.0 / have) + 4.0 * within)
    # Where fewer than two discharges came by, nothing is known.
    low = np.where(have > 1, np.clip(grid + centre - half, 0.0, 1.0), 0.0)
    high = np.where(have > 1, np.clip(grid + centre + half, 0.0, 1.0), 1.0)
    return np.minimum(low, grid), np.maximum(high, grid)
