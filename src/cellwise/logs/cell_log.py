"""A measured log of one cell, with its ways in and out: tables, frames, pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

from cellwise.arguments import check_kind
from cellwise.logs.files.assembly import log_from_table
from cellwise.logs.files.named_columns import NamedColumns
from cellwise.logs.gaps import Gap, find_gaps
from cellwise.logs.measured_log import CurrentMeaning, MeasuredLog
from cellwise.logs.writing import arrow_table
from cellwise.plotting import Line, Panel, Plottable, Tabular

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
