"""Voltages of a pack's cells in a stream: which name is which cell, and how long one is held."""

from __future__ import annotations

import math
import re

from cellwise.errors import InputError
from cellwise.estimate.cells.settings import MOST_CELLS
from cellwise.live.sample import Sample
from cellwise.logs.packs.cell_columns import known_cell

# A cell is polled every few seconds at the slowest; an older voltage is that of another current.
HELD_S = 5.0
# Of signals on a bus, whose unit the database says: CellVoltage01, VCell_12, Cell3_Volt.
_SIGNAL = re.compile(
    r"(?:v(?:olt(?:age)?)?_?)?cell_?(?:v(?:olt(?:age)?)?)?_?(\d+)(?:_?v(?:olt(?:age)?)?)?",
    re.IGNORECASE,
)


def cell_number(signal: str) -> int | None:
    """The cell whose voltage a signal is by its name, from 1 as the names count; else None."""
    match = _SIGNAL.fullmatch(signal)
    return int(match[1]) if match else None


class CellReadings:
    """The last voltage of every cell, held for some seconds; positions count from 0.

    Parameters
    ----------
    cells : int      in series; 0: none is asked for

    Raises
    ------
    InputError       one cell, or more than a thousand
    """

    def __init__(self, cells: int) -> None:
        if cells and not 2 <= cells <= MOST_CELLS:
            raise InputError(
                f"{cells} cells in a stream",
                f"2 to {MOST_CELLS} in series",
                "Leave `cells` out for one cell.",
            )
        self.cells = cells
        self._volts = [math.nan] * cells
        self._at = [-math.inf] * cells

    def take(self, position: int, voltage_V: float, time_s: float) -> None:
        """A reading; one of a cell beyond the pack is passed over."""
        if 0 <= position < self.cells:
            self._volts[position], self._at[position] = voltage_V, time_s

    def take_object(self, found: dict[str, object], time_s: float) -> None:
        """The readings of an object with tidy names: ``cell_01_V`` or ``cell_01_mV``."""
        for name, value in found.items() if self.cells else ():
            known = known_cell(name)
            if known is not None and isinstance(value, (int, float)):
                number, unit = known
                self.take(number - 1, float(value) * unit.factor + unit.offset, time_s)

    def now(self, time_s: float) -> tuple[float, ...]:
        """Voltage of every cell [V]; NaN for one that has not come for a while."""
        return tuple(
            v if time_s - at <= HELD_S else math.nan
            for v, at in zip(self._volts, self._at, strict=True)
        )

    def added_to(self, sample: Sample) -> Sample:
        """The sample with the cells' voltages; their mean where it has no voltage of its own."""
        if not self.cells:
            return sample
        cell_V = self.now(sample.time_s)
        known = [v for v in cell_V if math.isfinite(v)]
        voltage = sample.voltage_V
        if math.isnan(voltage) and known:
            voltage = sum(known) / len(known)
        return sample._replace(voltage_V=voltage, cell_V=cell_V)
