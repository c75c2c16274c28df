"""A measured log of one cell, with its ways in and out: tables, frames, pictures, even steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from cellwise.arguments import check_kind
from cellwise.errors import InputError
from cellwise.logs.files.assembly import log_from_table
from cellwise.logs.files.named_columns import NamedColumns
from cellwise.logs.gaps import Gap, find_gaps
from cellwise.logs.measured_log import CurrentMeaning, MeasuredLog
from cellwise.logs.writing import arrow_table
from cellwise.plotting import Line, Panel, Plottable, Tabular
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    import pyarrow


__all__ = ["CellLog", "CurrentMeaning", "Gap", "find_gaps"]


@dataclass(frozen=True, eq=False, repr=False)
class CellLog(MeasuredLog, Plottable, Tabular):
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
    notices : tuple of str      what a person should know of how the log was read
    soc0 : float or None        true SOC at the first row where somebody knows it, 0..1: it is
                                believed

    Raises
    ------
    InputError        unequal lengths, fewer than two rows, time that is not finite or runs
                      backwards, a channel without one finite value, a SOC outside 0..1
    """

    @classmethod
    def from_table(
        cls, table: NamedColumns, *, sign: str = "auto", name: str = "", source: str = ""
    ) -> Self:
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
        return log_from_table(cls, table, sign=sign, name=name, source=source)

    def to_arrow(self) -> pyarrow.Table:
        """The log as a pyarrow table in the tidy form, missing values as nulls.

        ``to_arrow().to_pandas()`` makes it a data frame. A log of the other meaning is turned into
        the tidy form's: the current of a row is that of the interval that ends there.
        """
        return arrow_table(self)

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


def check_is_log(log: object) -> None:
    """Refuse what is no log of a cell.

    Raises
    ------
    InputError        another type
    """
    check_kind("log", log, CellLog, "Read one with read_log, or CellLog.from_table(a data frame).")


LARGEST = 100_000_000  # rows; beyond it a step is a slip of the unit


def resample(log: CellLog, dt_s: float) -> CellLog:
    """Rows every ``dt_s`` seconds: mean current of the interval, last voltage and temperature.

    The charge of every interval is kept. A step that holds no measured voltage gets none (NaN),
    so that a pause stays a pause for a filter; the counter is read at the step's end.

    Raises
    ------
    InputError        a step that is not above zero, longer than the log, or beyond any memory
    """
    if not (np.isfinite(dt_s) and dt_s > 0):
        raise InputError(f"a time step of {dt_s} s", "a step above zero", "Give `dt_s=1.0`.")
    if dt_s > log.duration_s:
        raise InputError(
            f"a time step of {dt_s:g} s for a log of {log.duration_s:g} s",
            "a step shorter than the log",
            "Give a shorter step.",
        )
    if log.duration_s / dt_s > LARGEST:
        raise InputError(
            f"a time step of {dt_s:g} s for a log of {log.duration_s:g} s",
            f"at most {LARGEST:,} steps",
            "Give the step in seconds.",
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
