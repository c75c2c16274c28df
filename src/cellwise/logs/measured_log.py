"""What was measured of one cell: arrays with units, sign and meaning, and the charge they imply."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellwise.errors import InputError
from cellwise.logs.gaps import Gap, find_gaps, run_edges
from cellwise.typing import BoolArray, FloatArray, IntArray

CurrentMeaning = Literal["interval_end", "interval_start"]

Log = TypeVar("Log", bound="MeasuredLog")


class Bridge(NamedTuple):
    """Over what is missing in a log.

    A missing current is its last value, from ``counter_s`` on what the counter says, whose steps
    (0.01 Ah on some testers) are by then small against what flowed. What flows unseen in less than
    ``pause_s`` hardly moves the SOC. A stretch of fewer ``voltages`` says less than it costs to
    find where it begins.
    """

    counter_s: float = 60.0
    pause_s: float = 300.0
    voltages: int = 30


BRIDGE = Bridge()


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredLog:
    """Channels of one log of one cell, checked: lengths, time that never decreases, finite values.

    The fields, their units and the errors are those of :class:`cellwise.logs.cell_log.CellLog`,
    which adds the ways in and out; what checks and assembles logs works on this.
    """

    time_s: FloatArray
    current_A: FloatArray
    voltage_V: FloatArray
    temperature_C: FloatArray | None = None
    charge_Ah: FloatArray | None = None
    step: IntArray | None = None
    name: str = ""
    source: str = ""
    current_meaning: CurrentMeaning = "interval_end"
    format: str = ""
    notices: tuple[str, ...] = ()
    soc0: float | None = None

    def __post_init__(self) -> None:
        n = np.atleast_1d(np.asarray(self.time_s)).size
        where = f"log '{self.name or self.source}'" if self.name or self.source else "the log"
        for field in ("time_s", "current_A", "voltage_V", "temperature_C", "charge_Ah"):
            if getattr(self, field) is not None:
                object.__setattr__(self, field, _channel(getattr(self, field), field, n, where))
        _check_time(self.time_s, where)
        for field in ("current_A", "voltage_V"):
            values = getattr(self, field)
            if np.isnan(values[0]) and np.all(np.isnan(values)):
                raise InputError(
                    f"no finite value of {field} in {where}",
                    "at least some measured values",
                    "Check which column was taken for it.",
                )
        if self.step is not None:
            step = np.ascontiguousarray(self.step, dtype=np.int32).view()
            _check_shape(step, "step", n, where)
            step.setflags(write=False)
            object.__setattr__(self, "step", step)
        if self.current_meaning not in ("interval_end", "interval_start"):
            raise InputError(
                f"current_meaning '{self.current_meaning}' in {where}",
                "'interval_end' or 'interval_start'",
                "Say which interval the current of a row belongs to.",
            )
        if self.soc0 is not None and not 0.0 <= self.soc0 <= 1.0:
            raise InputError(
                f"soc0 = {self.soc0:g} of {where}",
                "a fraction from 0 to 1, or None where it is not known",
                "Divide per cent by 100.",
            )

    def __len__(self) -> int:
        return self.time_s.size

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.name or self.source or 'unnamed'}: {len(self)} rows, "
            f"{self.duration_s / 3600:.2f} h, {np.nanmin(self.current_A):.2f} to "
            f"{np.nanmax(self.current_A):.2f} A, {np.nanmin(self.voltage_V):.3f} to "
            f"{np.nanmax(self.voltage_V):.3f} V)"
        )

    @property
    def duration_s(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.time_s[-1] - self.time_s[0])

    @property
    def interval_s(self) -> FloatArray:
        """Length of the interval that ends at each row [s], shape (n,); 0 for the first row."""
        interval = np.empty(self.time_s.size)
        interval[0] = 0.0
        np.subtract(self.time_s[1:], self.time_s[:-1], out=interval[1:])
        return interval

    @property
    def interval_current_A(self) -> FloatArray:
        """Current during the interval that ends at each row [A], shape (n,)."""
        if self.current_meaning == "interval_end":
            return self.current_A
        return np.concatenate(([self.current_A[0]], self.current_A[:-1]))

    @cached_property
    def gap_rows(self) -> BoolArray:
        """True for a row that ends a gap, shape (n,)."""
        return find_gaps(self.time_s)

    @cached_property
    def typical_voltage_V(self) -> float:
        """Median of the measured voltages [V]."""
        return typical(self.voltage_V)

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """The log's gaps, in order."""
        rows = np.flatnonzero(self.gap_rows)
        return tuple(
            Gap(
                row=int(k),
                start_s=float(self.time_s[k - 1]),
                duration_s=float(self.time_s[k] - self.time_s[k - 1]),
                charge_Ah=None
                if self.charge_Ah is None
                else float(self.charge_Ah[k] - self.charge_Ah[k - 1]),
            )
            for k in rows
        )

    @property
    def repeated_stamps(self) -> int:
        """Number of rows that carry the same time as the row before."""
        return int(np.count_nonzero(np.diff(self.time_s) == 0.0))

    def known_current_A(self) -> FloatArray:
        """Current of each interval with gaps and missing values filled by a stated policy [A].

        Over a gap it is what the tester's counter says flowed; without a counter zero (a pause is
        a rest until stated otherwise). Where samples are missing it is their last known
        value, and over more than a minute of missing samples what the counter says.

        Returns
        -------
        (n,) float        finite everywhere
        """
        current = self.interval_current_A.copy()
        missing = np.isnan(current)
        gaps = self.gap_rows
        if missing.any():
            _bridge(current, missing, self.time_s, self.charge_Ah)
        if gaps.any():
            current[gaps] = 0.0
            if self.charge_Ah is not None:
                moved = np.diff(self.charge_Ah, prepend=self.charge_Ah[0])
                counted = gaps & np.isfinite(moved)
                current[counted] = 3600.0 * moved[counted] / self.interval_s[counted]
        return current

    def counted_charge_Ah(self) -> FloatArray:
        """Charge removed since the first row [Ah], shape (n,): the counter, else the current's sum.

        The counter starts at zero here whatever it read at the first row; where it is missing it
        is carried on by the current.
        """
        counted: FloatArray
        if self.charge_Ah is not None and np.all(np.isfinite(self.charge_Ah)):
            counted = self.charge_Ah - self.charge_Ah[0]
            return counted
        summed: FloatArray = np.cumsum(self.known_current_A() * self.interval_s) / 3600.0
        if self.charge_Ah is None:
            return summed
        read = np.flatnonzero(np.isfinite(self.charge_Ah))
        if read.size == 0:
            return summed
        drift = np.interp(np.arange(len(self)), read, self.charge_Ah[read] - summed[read])
        counted = summed + drift - (summed[0] + drift[0])
        return counted

    @classmethod
    def checked_before(cls, **values: Any) -> Self:
        """A log of what another log held: float64 channels that were checked when it was made."""
        log = object.__new__(cls)
        for one in fields(cls):
            value = values.get(one.name, one.default)
            if isinstance(value, np.ndarray) and value.flags.writeable:
                value.setflags(write=False)
            object.__setattr__(log, one.name, value)
        return log

    def with_notices(self, notices: Iterable[str]) -> Self:
        """The same log with other notices; nothing is checked again, nothing copied."""
        log = object.__new__(type(self))
        log.__dict__.update(self.__dict__)
        object.__setattr__(log, "notices", tuple(notices))
        return log

    def part(self, start: int, stop: int) -> Self:
        """Rows ``start`` to ``stop`` (not included) as a log of their own, time kept."""
        return self.rows(np.arange(*slice(start, stop).indices(len(self))))

    def rows(self, rows: NDArray[np.integer[Any]] | BoolArray) -> Self:
        """The log with the chosen rows only, time kept; a stated start only with the first row."""

        def take(a: FloatArray | None) -> FloatArray | None:
            return None if a is None else a[rows]

        chosen = np.arange(len(self))[rows]
        begins = chosen.size > 0 and int(chosen[0]) == 0
        return replace(
            self,
            soc0=self.soc0 if begins else None,
            time_s=self.time_s[rows],
            current_A=self.current_A[rows],
            voltage_V=self.voltage_V[rows],
            temperature_C=take(self.temperature_C),
            charge_Ah=take(self.charge_Ah),
            step=None if self.step is None else self.step[rows],
        )


def typical(values: FloatArray) -> float:
    """Median of the values; of very many, of every so manyth one."""
    some = values[:: max(values.size // 4000, 1)]
    known = some[np.isfinite(some)]
    return float(np.median(known) if known.size else np.nanmedian(values))


def _channel(value: ArrayLike, field: str, n: int, where: str) -> FloatArray:
    """A read-only float64 view or copy of one channel; infinite readings become missing ones."""
    array: FloatArray = np.ascontiguousarray(value, dtype=np.float64)
    _check_shape(array, field, n, where)
    if field != "time_s" and not np.isfinite(np.sum(array)) and np.isinf(array).any():
        # An infinite reading must not reach a sum.
        array = np.where(np.isinf(array), np.nan, array)
    array = array.view()  # the caller's own array stays writeable
    array.setflags(write=False)
    return array


def _check_shape(array: FloatArray | IntArray, field: str, n: int, where: str) -> None:
    if array.ndim != 1 or array.size != n:
        raise InputError(
            f"{field} of shape {array.shape} in {where}",
            f"one value per row, shape ({n},) as time_s",
            "Give every channel the length of time_s.",
        )


def _bridge(
    current: FloatArray, missing: BoolArray, time_s: FloatArray, charge_Ah: FloatArray | None
) -> None:
    """Fill the missing values of ``current`` in place, run by run."""
    first, last = run_edges(missing)
    before = np.maximum(first - 1, 0)
    value = current[before]
    value[np.isnan(value)] = 0.0  # the log begins with missing current
    if charge_Ah is not None:
        seconds = time_s[last] - time_s[before]
        moved = charge_Ah[last] - charge_Ah[before]
        counted = (seconds > BRIDGE.counter_s) & np.isfinite(moved)
        value[counted] = 3600.0 * moved[counted] / seconds[counted]
    current[missing] = np.repeat(value, last - first + 1)


def _check_time(time_s: FloatArray, where: str) -> None:
    if time_s.size < 2:
        raise InputError(
            f"{time_s.size} row(s) in {where}",
            "at least two rows",
            "Check that the file is complete.",
        )
    # A sum is finite only where every stamp is: one pass without a mask.
    if not (np.isfinite(np.sum(time_s)) or np.all(np.isfinite(time_s))):
        row = int(np.flatnonzero(~np.isfinite(time_s))[0])
        raise InputError(
            f"time_s = {time_s[row]} at row {row} of {where}",
            "a finite time in every row",
            "Drop the row or repair its stamp.",
        )
    interval = np.diff(time_s)
    if np.min(interval) < 0:
        back = np.flatnonzero(interval < 0)
        k = int(back[0])
        raise InputError(
            f"time running backwards in {where}: {time_s[k]:.3f} s at row {k}, then "
            f"{time_s[k + 1]:.3f} s ({back.size} such rows)",
            "time that never decreases",
            "Sort the rows, or split the file where the clock was reset.",
        )


def uncounted_pauses(log: MeasuredLog) -> tuple[int, ...]:
    """Rows that end a pause of minutes over which no counter went on.

    A car that is switched off may be charged meanwhile: where its SOC is then, nobody knows.
    """
    long = np.flatnonzero(log.gap_rows & (log.interval_s > BRIDGE.pause_s))
    if log.charge_Ah is None:
        return tuple(map(int, long))
    return tuple(int(k) for k in long if not np.isfinite(log.charge_Ah[k - 1 : k + 1]).all())


def cut_at_pauses(log: Log) -> tuple[Log, ...]:
    """The stretches between such pauses, as logs with their time in the name; the log without one.

    What is too short to say anything is left away; a stated start and the notices of reading
    stay with the first stretch.
    """
    rows = uncounted_pauses(log)
    if not rows:
        return (log,)
    found: list[Log] = []
    for first, stop in pairwise((0, *rows, len(log))):
        if np.count_nonzero(np.isfinite(log.voltage_V[first:stop])) < BRIDGE.voltages:
            continue
        part = log.part(first, stop)
        name = f"{log.name}, {log.time_s[first]:.0f} s" if first else log.name
        found.append(replace(part, name=name, notices=() if found else log.notices))
    return tuple(found) or (log,)
