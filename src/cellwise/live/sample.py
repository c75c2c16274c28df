"""What a source of a stream yields."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple, Protocol


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
