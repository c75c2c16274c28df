"""What a source of a stream reads and yields; from what sensors say to samples of one cell."""

from __future__ import annotations

import math
import os
import select
import sys
import time
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, NamedTuple, Protocol

from cellwise.errors import InputError
from cellwise.estimate.fixed.options import MOST_CELLS
from cellwise.logs.files.columns import TIDY_NAMES, Unit, listed, tidy_name
from cellwise.logs.files.source import HEAD_BYTES, ReadOptions
from cellwise.logs.packs.cells import CellColumn, known_column
from cellwise.wording import arg

FIELDS = ("time_s", "current_A", "voltage_V", "temperature_C")
CELL_FIELDS = FIELDS[1:]
# A cell is polled every few seconds at the slowest; an older voltage is that of another current.
HELD_S = 5.0
CURRENT_HELD_S, TEMPERATURE_HELD_S = 1.0, 60.0  # older ones are missing
POLL_S = 0.2  # a source that nothing comes from says so as often
FAILURES = 25  # in a row, of a bus or a device, and it is given up


class Sample(NamedTuple):
    """One sample of one cell, positive current = discharge; NaN where nothing was measured.

    ``current_A`` is that of the interval that ends at ``time_s``; ``voltage_V`` and
    ``temperature_C`` are read there. ``arrived_s`` is the clock of the
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


class Readings:
    """What the sensors of a pack have said, to samples of its mean cell, positive = discharge.

    The current of a sample is the mean of the currents since the sample before, so that none is
    lost where it comes faster; where none has come it is the last one. The temperature is the last
    one, the voltage that of the sample alone, or the mean of the cells' where it has none.

    Parameters
    ----------
    options : ReadOptions   series, parallel
    sign : str              ``charge-positive`` turns the current round
    cells : int             voltages of so many cells in series, held for some seconds; 0: none
    held_s : float          a current older than this is missing [s]

    Raises
    ------
    InputError              no number of cells in series; one cell, or more than a thousand
    """

    def __init__(
        self,
        options: ReadOptions,
        sign: str,
        cells: int = 0,
        held_s: float = CURRENT_HELD_S,
    ) -> None:
        if options.series == "auto":
            raise InputError(
                arg("series", "auto") + " for a stream",
                "the number of cells in series",
                "Give it: " + arg("series", 4) + ", say.",
            )
        if cells and not 2 <= cells <= MOST_CELLS:
            raise InputError(
                f"{cells} cells in a stream",
                f"2 to {MOST_CELLS} in series",
                "Leave `cells` out for one cell.",
            )
        self.cells = cells
        self._factors = {
            "current_A": (-1.0 if sign == "charge-positive" else 1.0) / options.parallel,
            "voltage_V": 1.0 / options.series,
        }
        self._held_s = {"current_A": held_s, "temperature_C": TEMPERATURE_HELD_S}
        self._last: dict[str | int, tuple[float, float]] = {}
        self._currents: list[float] = []

    @property
    def waiting(self) -> bool:
        """A current has come since the last sample."""
        return bool(self._currents)

    def take(self, field: str | int, value: float, time_s: float) -> None:
        """A reading of a field of `CELL_FIELDS` or of a cell, whose positions count from 0."""
        if isinstance(field, str):
            value *= self._factors.get(field, 1.0)
        self._last[field] = value, time_s
        if field == "current_A":
            self._currents.append(value)

    def sample(self, time_s: float, arrived_s: float) -> Sample:
        """A sample of what has come up to now."""
        known = [x for x in self._currents if not math.isnan(x)]
        current = sum(known) / len(known) if known else math.nan
        if not self._currents:
            current = self._held("current_A", time_s)
        self._currents.clear()
        voltage, _ = self._last.pop("voltage_V", (math.nan, 0.0))
        cell_V = tuple(self._held(k, time_s) for k in range(self.cells))
        measured = [v for v in cell_V if math.isfinite(v)]
        if math.isnan(voltage) and measured:
            voltage = sum(measured) / len(measured)
        temperature_C = self._held("temperature_C", time_s)
        return Sample(time_s, current, voltage, temperature_C, arrived_s, cell_V)

    def _held(self, field: str | int, time_s: float) -> float:
        value, at_s = self._last.get(field, (math.nan, -math.inf))
        return value if time_s - at_s <= self._held_s.get(str(field), HELD_S) else math.nan


# Names of a time without a unit: seconds, or by its size thousandths of one since 1970, and dates.
STAMPS = ("time", "timestamp", "ts", "t", "datetime", "date_time", "date", "zeit", "zeitstempel")
_SINCE_1970 = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))


def stamp_s(value: object) -> float:
    """Seconds of a time without a unit: a number, by its size, or a date (since 1970, UTC).

    Raises
    ------
    ValueError, OverflowError        it is none
    """
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise ValueError("no time")
    try:
        number = float(value)
    except ValueError:
        date = datetime.fromisoformat(str(value).strip())
        return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
    return number * next((unit for least, unit in _SINCE_1970 if abs(number) >= least), 1.0)


class ObjectReader:
    """JSON objects with tidy names, which give the unit, to samples.

    Parameters
    ----------
    readings : Readings         what they are taken into
    channels : mapping          tidy name to another one that stands for it
    """

    def __init__(self, readings: Readings, channels: Mapping[str, str]) -> None:
        self.readings = readings
        self.note: str | None = None
        self.names: dict[str, tuple[str, Unit]] = {
            name: known for name, known in TIDY_NAMES.items() if known[0] in FIELDS
        }
        self.names |= {name: tidy_name(tidy, FIELDS) for tidy, name in channels.items()}

    def knows(self, name: str) -> bool:
        """Whether a value of this name is used."""
        return name in self.names or name.casefold() in STAMPS or self._cell(name) is not None

    def _cell(self, name: str) -> CellColumn | None:
        cell = known_column(name) if self.readings.cells else None
        return cell if cell is not None and cell.kind == "cell" and cell.number > 0 else None

    def _noted(self, found: Mapping[str, Any], stamp: str | None) -> None:
        """Say once by what the time is taken, where no name gives its unit."""
        said = f"the time was taken from '{stamp}', whose name states no unit"
        if stamp is None:
            unused = [name for name in found if not self.knows(str(name))]
            said = "no time_s in the samples: that of their arrival was taken"
            said += f" (not used: {listed(unused)})" if unused else ""
        self.note = said

    def read(self, found: Any, arrived_s: float) -> Sample | Stray:
        """A sample; a value that is missing or null is NaN, a missing time is that of arrival."""
        if not isinstance(found, dict):
            return Stray("not an object")
        # What was not said now is not known now.
        values: dict[str | int, float] = {
            "time_s": arrived_s, **dict.fromkeys(CELL_FIELDS, math.nan)
        }  # fmt: skip
        known = bool(self.readings.cells)
        if not any(self.names.get(name, ("",))[0] == "time_s" for name in found):
            stamp = next((name for name in found if str(name).casefold() in STAMPS), None)
            if self.note is None:
                self._noted(found, stamp)
            if stamp is not None and found[stamp] is not None:
                try:
                    values["time_s"] = stamp_s(found[stamp])
                except (ValueError, OverflowError):
                    return Stray(f"{stamp} is no time")
        for name, value in found.items():
            cell = self._cell(name)
            if cell is not None:
                field: str | int = cell.number - 1
                unit = cell.unit
            elif name in self.names:
                field, unit = self.names[name]
            else:
                continue
            number = math.nan if value is None else value
            if isinstance(number, bool) or not isinstance(number, (int, float)):
                return Stray(f"{name} is no number")
            try:
                values[field] = number * unit.factor + unit.offset
            except OverflowError:
                return Stray(f"{name} is no number")
            known |= field != "time_s"
        if not known:
            return Stray(f"none of {', '.join(CELL_FIELDS)}")
        time_s = values.pop("time_s")
        for field, number in values.items():
            self.readings.take(field, number, time_s)
        return self.readings.sample(time_s, arrived_s)


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
                piece = self._file.read(HEAD_BYTES)
            else:
                # Not the buffered reader: it would wait for a whole buffer.
                ready, _, _ = select.select([number], [], [], POLL_S)
                if not ready:
                    yield b""
                    continue
                piece = os.read(number, HEAD_BYTES)
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
