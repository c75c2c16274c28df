"""How a user's options of a stream (channels, pack, sign) turn values into samples."""

from __future__ import annotations

import math
from typing import Any

from cellwise.errors import InputError
from cellwise.live.cell_readings import CellReadings
from cellwise.live.sample import Sample, Stray
from cellwise.logs.files.columns import TIDY_CHANNELS, Unit
from cellwise.logs.files.source import ReadOptions

FIELDS = ("time_s", "current_A", "voltage_V", "temperature_C")
CELL_FIELDS = FIELDS[1:]
# Tidy name to field and unit.
TIDY_NAMES = {
    name: (channel.field, unit)
    for channel in TIDY_CHANNELS
    if channel.field in FIELDS
    for name, unit in channel.names.items()
}


class CellScale:
    """From what a pack's sensors say to one cell, positive = discharge."""

    def __init__(self, options: ReadOptions, sign: str) -> None:
        if options.series == "auto":
            raise InputError(
                "`series='auto'` for a stream",
                "the number of cells in series",
                "Give it: `series=4`, say.",
            )
        self.current = (-1.0 if sign == "charge-positive" else 1.0) / options.parallel
        self.voltage = 1.0 / options.series

    def sample(
        self,
        time_s: float,
        current_A: float,
        voltage_V: float,
        temperature_C: float,
        arrived_s: float,
    ) -> Sample:
        """One sample of the mean cell."""
        return Sample(
            time_s, current_A * self.current, voltage_V * self.voltage, temperature_C, arrived_s
        )


class ObjectReader:
    """JSON objects with tidy names, which give the unit, to samples."""

    def __init__(self, options: ReadOptions, sign: str, cells: int = 0) -> None:
        self._scale = CellScale(options, sign)
        self._cells = CellReadings(cells)
        self._names: dict[str, tuple[str, Unit]] = dict(TIDY_NAMES)
        for tidy, name in options.channels.items():
            if tidy not in TIDY_NAMES:
                raise InputError(
                    f"a channel '{tidy}'", f"one of {', '.join(TIDY_NAMES)}", "Correct the name."
                )
            self._names[name] = TIDY_NAMES[tidy]

    def read(self, found: Any, arrived_s: float) -> Sample | Stray:
        """A sample; a value that is missing or null is NaN, a missing time is that of arrival."""
        if not isinstance(found, dict):
            return Stray("not an object")
        values = {"time_s": arrived_s, "current_A": math.nan, "voltage_V": math.nan}
        known = 0
        for name, value in found.items():
            meaning = self._names.get(name)
            if meaning is None:
                continue
            field, unit = meaning
            if value is None:
                value = math.nan
            elif isinstance(value, bool) or not isinstance(value, (int, float)):
                return Stray(f"{name} is no number")
            known += field != "time_s"
            try:
                values[field] = value * unit.factor + unit.offset
            except OverflowError:
                return Stray(f"{name} is no number")
        self._cells.take_object(found, values["time_s"])
        if not known and not self._cells.cells:
            return Stray(f"none of {', '.join(CELL_FIELDS)}")
        return self._cells.added_to(
            self._scale.sample(
                values["time_s"],
                values["current_A"],
                values["voltage_V"],
                values.get("temperature_C", math.nan),
                arrived_s,
            )
        )
