"""What a source of a stream reads and yields; from what sensors say to samples of one cell."""

from __future__ import annotations

import math
import os
import re
import select
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple, Protocol

from cellwise.errors import InputError
from cellwise.estimate.cells.settings import MOST_CELLS
from cellwise.logs.files.columns import TIDY_NAMES, Unit, tidy_name
from cellwise.logs.files.source import ReadOptions
from cellwise.logs.packs.cells import known_column

FIELDS = ("time_s", "current_A", "voltage_V", "temperature_C")
CELL_FIELDS = FIELDS[1:]
# A cell is polled every few seconds at the slowest; an older voltage is that of another current.
HELD_S = 5.0
POLL_S = 0.2  # a source that nothing comes from says so as often
FAILURES = 25  # in a row, of a bus or a device, and it is given up
# Of signals on a bus, whose unit the database says: CellVoltage01, VCell_12, Cell3_Volt.
_SIGNAL = re.compile(
    r"(?:v(?:olt(?:age)?)?_?)?cell_?(?:v(?:olt(?:age)?)?)?_?(\d+)(?:_?v(?:olt(?:age)?)?)?",
    re.IGNORECASE,
)


class Sample(NamedTuple):
    """One sample of one cell, positive current = discharge; NaN where nothing was measured.

    The current is that of the interval that ends at ``time_s``. ``arrived_s`` is the clock of the
    day (seconds since 1970) at which the sample reached this machine; ``cell_V`` are the voltages
    of a pack's cells, where they are asked for.
    """

    time_s: float
    current_A: float
    voltage_V: float
    temperature_C: float = math.nan
    arrived_s: float = math.nan
    cell_V: tuple[float, ...] = ()


class Stray(NamedTuple):
    """Something that came and was no sample, and why."""

    reason: str


class Source(Protocol):
    """A stream. None means that nothing came for a while: time to look after other things."""

    name: str

    def __iter__(self) -> Iterator[Sample | Stray | None]:
        """Yield samples until the stream ends."""
        ...

    def close(self) -> None:
        """Let go of whatever is open."""
        ...


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
            known = known_column(name)
            if known is not None and known.kind == "cell" and isinstance(value, (int, float)):
                unit = known.unit
                self.take(known.number - 1, float(value) * unit.factor + unit.offset, time_s)

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
        own = {n: known for n, known in TIDY_NAMES.items() if known[0] in FIELDS}
        self._names: dict[str, tuple[str, Unit]] = own
        for tidy, name in options.channels.items():
            self._names[name] = tidy_name(tidy, FIELDS)
        self.names = frozenset(self._names)

    def field_of(self, name: str) -> str:
        """The field of a sample that a name is of."""
        return self._names[name][0]

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


PIECE_BYTES = 65_536
STDIN = "-"


class Pieces:
    """Pieces of a stream; an empty one after every ``POLL_S`` in which nothing came.

    Parameters
    ----------
    place : str           a path, or ``-`` for standard input
    follow : bool         at a file's end wait for more, as of a file that is being written

    Raises
    ------
    InputError            no such file
    """

    def __init__(self, place: str, *, follow: bool = False) -> None:
        self.name = "standard input" if place == STDIN else f"'{place}'"
        self._follow = follow
        self._owned: IO[bytes] | None = None
        if place == STDIN:
            self._file: IO[bytes] = sys.stdin.buffer
        else:
            try:
                self._file = self._owned = Path(place).open("rb")  # noqa: SIM115 -- closed below
            except OSError as error:
                raise InputError(
                    f"no stream '{place}' ({error.strerror})",
                    "a file, a pipe, or - for standard input",
                    "Check the path.",
                ) from None

    def __iter__(self) -> Iterator[bytes]:
        number = _descriptor(self._file)
        while True:
            if number is None:
                piece = self._file.read(PIECE_BYTES)
            else:
                # Not the buffered reader: it would wait for a whole buffer.
                ready, _, _ = select.select([number], [], [], POLL_S)
                if not ready:
                    yield b""
                    continue
                piece = os.read(number, PIECE_BYTES)
            if piece:
                yield piece
            elif self._follow:
                time.sleep(POLL_S)
                yield b""
            else:
                return

    def close(self) -> None:
        """Close the file; standard input stays."""
        if self._owned is not None:
            self._owned.close()


def _descriptor(file: IO[bytes]) -> int | None:
    """What `select` can wait for; None for a stream in memory, or where pipes cannot be waited for.

    On Windows only sockets can: there a read waits for the next bytes.
    """
    if sys.platform == "win32":
        return None
    try:
        return file.fileno()
    except (OSError, ValueError, AttributeError):
        return None
