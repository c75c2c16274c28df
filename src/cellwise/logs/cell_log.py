"""A measured log of one cell: arrays with units, sign and meaning, and the charge they imply."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellwise.arguments import check_kind, held_soc, number, shown
from cellwise.errors import InputError
from cellwise.logs.gaps import Gap, find_gaps, run_edges
from cellwise.notices import Notice
from cellwise.plotting import Line, Panel, Plottable, Tabular
from cellwise.typing import BoolArray, FloatArray, IntArray, NamedColumns
from cellwise.wording import arg

CurrentMeaning = Literal["interval_end", "interval_start"]

CHANNELS = ("time_s", "current_A", "voltage_V", "temperature_C", "charge_Ah", "step")
# A missing current is its last value; of more seconds what the counter says, whose steps (0.01 Ah
# on some testers) are by then small against what flowed.
COUNTED_S = 60.0
WAY_TO_A_LOG = "Read one with read_log, or CellLog.from_table(a data frame)."
LARGEST = 100_000_000  # rows of an even step; beyond it a step is a slip of the unit


@dataclass(frozen=True, eq=False, repr=False)
class CellLog(Plottable, Tabular):
    """One cell, one log.

    Parameters
    ----------
    time_s : (n,) float         seconds from the log's start, never decreasing
    current_A : (n,) float      positive = discharge; NaN where missing
    voltage_V : (n,) float      terminal voltage; NaN where missing
    temperature_C : (n,) float or None    surface temperature
    charge_Ah : (n,) float or None        the tester's own counter, discharge positive
    step : (n,) int or None               tester step
    name, source : str          for people: what it is, where it came from
    current_meaning : str       ``interval_end``: the current of row k flowed during the interval
                                that ends at row k (what testers mean); ``interval_start``: it
                                flows from row k on
    format : str                the file's format as detected, empty for a log made in memory
    notices : tuple of Notice   what a person should know of how the log was read
    soc0 : float or None        true SOC at the first row where somebody knows it, 0..1: it is
                                believed
    series, parallel : int      cells of the pack whose mean cell this is

    Raises
    ------
    InputError        unequal lengths, fewer than two rows, time that is not finite or runs
                      backwards, a channel without one finite value, a SOC outside 0..1
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
    notices: tuple[Notice, ...] = ()
    soc0: float | None = None
    series: int = 1
    parallel: int = 1

    def __new__(cls, *given: object, **named: object) -> Self:
        """Refuse a table, or the name of a file, in the place of channels."""
        if len(given) + len(named) == 1:
            raise InputError(
                f"CellLog({shown((*given, *named.values())[0])})",
                "time_s, current_A and voltage_V",
                "Write CellLog.from_table(frame) with a data frame, read_log('a.csv') with a file.",
            )
        return super().__new__(cls)

    def __post_init__(self) -> None:
        n = np.size(self.time_s)
        where = f"log '{self.name or self.source}'" if self.name or self.source else "the log"
        for field in CHANNELS:
            values = getattr(self, field)
            if values is not None or field in ("time_s", "current_A", "voltage_V"):
                object.__setattr__(self, field, _channel(values, field, n, where))
        _check_time(self.time_s, where)
        for field in ("current_A", "voltage_V"):
            if np.isnan(getattr(self, field)).all():
                raise InputError(
                    f"no finite value of {field} in {where}",
                    "at least some measured values",
                    "Check which column was taken for it.",
                )
        if self.current_meaning not in ("interval_end", "interval_start"):
            raise InputError(
                f"current_meaning '{self.current_meaning}' in {where}",
                "'interval_end' or 'interval_start'",
                "Say which interval the current of a row belongs to.",
            )
        if self.soc0 is not None:
            object.__setattr__(self, "soc0", held_soc(number("soc0", self.soc0, "a SOC, or None")))
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

    def with_notices(self, notices: Iterable[Notice]) -> Self:
        """The same log with other notices."""
        return replace(self, notices=tuple(notices))

    def part(self, start: int, stop: int) -> Self:
        """Rows ``start`` to ``stop`` (not included) as a log of their own, time kept.

        Raises
        ------
        InputError          rows that are no whole numbers, none between them
        """
        if not all(isinstance(k, (int, np.integer)) for k in (start, stop)):
            raise InputError(
                f"rows {shown(start)} to {shown(stop)}", "whole numbers", "Write log.part(0, 1000)."
            )
        return self.rows(np.arange(*slice(start, stop).indices(len(self))))

    def rows(self, rows: NDArray[np.integer[Any]] | BoolArray) -> Self:
        """The log with the chosen rows only, time kept; a stated start only with the first row."""

        def taken(field: str) -> Any:
            values = getattr(self, field)
            return None if values is None else values[rows]

        chosen = np.arange(len(self))[rows]
        begins = chosen.size > 0 and int(chosen[0]) == 0
        channels = {field: taken(field) for field in CHANNELS}
        return replace(self, soc0=self.soc0 if begins else None, **channels)

    @classmethod
    def from_table(
        cls, table: NamedColumns, *, sign: str = "auto", name: str = "", source: str = ""
    ) -> CellLog:
        """Log from columns by name: a pandas or polars frame, a pyarrow table, a dict of arrays.

        Parameters
        ----------
        table : anything with column names and ``table[name]``      the tidy form's columns
        sign : str          ``auto`` (positive = discharge), ``discharge-positive`` or
                            ``charge-positive``
        name, source : str  for people

        Raises
        ------
        InputError          as `read_log` does for a file with these columns
        """
        # What makes a log of a table stands above the record, which knows nobody.
        above = import_module("cellwise.logs.files.assembly")
        log: CellLog = above.log_of_table(table, sign, name, source)
        return log

    def columns(self) -> dict[str, Any]:
        """The tidy form's columns, as `to_pandas` and `to_polars` have them."""
        optional = {
            "temperature_C": self.temperature_C,
            "ampere_hours": self.charge_Ah,
            "step": self.step,
        }
        return {
            "time_s": self.time_s,
            "current_A": self.interval_current_A,
            "voltage_V": self.voltage_V,
            **{name: values for name, values in optional.items() if values is not None},
        }

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """Voltage, current and, where they are measured, temperature and counter over time."""
        hours = self.time_s / 3600.0
        shown = [
            ("voltage [V]", self.voltage_V),
            ("current [A]", self.current_A),
            ("temperature [°C]", self.temperature_C),
            ("counter [Ah]", self.charge_Ah),
        ]
        panels = [Panel(y, (Line(y, hours, v),)) for y, v in shown if v is not None]
        return "time [h]", tuple(panels)


def typical(values: FloatArray) -> float:
    """Median of the values; of very many, of every so manyth one."""
    some = values[:: max(values.size // 4000, 1)]
    known = some[np.isfinite(some)]
    return float(np.median(known) if known.size else np.nanmedian(values))


CHANNEL = "numbers, one for each row, nan where one is missing"


def _channel(value: ArrayLike | None, field: str, n: int, where: str) -> NDArray[Any]:
    """A read-only view or copy of one channel; infinite readings become missing ones."""
    if value is None or isinstance(value, (str, bytes)):
        found = f"{field} = {shown(value)} in {where}"
        raise InputError(found, CHANNEL, "Pass an array or a list.")
    try:
        array = np.ascontiguousarray(value, dtype=np.int32 if field == "step" else np.float64)
    except (TypeError, ValueError) as error:
        found = f"{field} = {shown(value)} in {where} ({error})"
        raise InputError(found, CHANNEL, "Pass an array or a list.") from None
    if array.shape != (n,):
        raise InputError(
            f"{field} of shape {array.shape} in {where}",
            f"one value per row, shape ({n},) as time_s",
            "Give every channel the length of time_s.",
        )
    with np.errstate(over="ignore"):
        whole = np.isfinite(np.sum(array))
    if field != "time_s" and not whole and np.isinf(array).any():
        # An infinite reading must not reach a sum.
        array = np.where(np.isinf(array), np.nan, array)
    array = array.view()  # the caller's own array stays writeable
    array.setflags(write=False)
    return array


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
        counted = (seconds > COUNTED_S) & np.isfinite(moved)
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


def resample(log: CellLog, dt_s: float) -> CellLog:
    """Rows every ``dt_s`` seconds: mean current of the interval, last voltage and temperature.

    The charge of every interval is kept. A step that holds no measured voltage gets none (NaN),
    so that a pause stays a pause for a filter; the counter is read at the step's end.

    Raises
    ------
    InputError        a step that is not above zero, longer than the log, or beyond any memory
    """
    check_kind("log", log, CellLog, WAY_TO_A_LOG)
    dt_s = number("dt_s", dt_s, "seconds, above zero")
    if not (0.0 < dt_s <= log.duration_s <= LARGEST * dt_s):
        raise InputError(
            f"a time step of {dt_s:g} s for a log of {log.duration_s:g} s",
            f"a step in seconds, shorter than the log, and at most {LARGEST:,} of them",
            "Give " + arg("dt_s", 1.0) + ", say.",
        )
    start = float(log.time_s[0])
    steps = int(np.floor(log.duration_s / dt_s + 1e-9))
    grid: FloatArray = start + dt_s * np.arange(steps + 1, dtype=np.float64)
    current = log.known_current_A()
    charge = np.cumsum(current * log.interval_s)
    at = np.interp(grid, log.time_s, charge)
    mean = np.diff(at, prepend=at[0]) / dt_s
    mean[0] = current[0]
    last = np.searchsorted(log.time_s, grid + 1e-9, side="right") - 1
    fresh = log.time_s[last] > grid - dt_s + 1e-9
    fresh[0] = True

    def held(values: FloatArray | None) -> FloatArray | None:
        return None if values is None else values[last]

    counter = None
    if log.charge_Ah is not None:
        counter = np.interp(grid, log.time_s, log.charge_Ah)
    return replace(
        log,
        time_s=grid,
        current_A=mean,
        voltage_V=np.where(fresh, log.voltage_V[last], np.nan),
        temperature_C=held(log.temperature_C),
        charge_Ah=counter,
        step=None if log.step is None else log.step[last],
        current_meaning="interval_end",
    )
