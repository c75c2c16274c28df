"""Which columns of a file are cell voltages, temperatures and balancing flags of a pack."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from cellwise.errors import InputError
from cellwise.logs.files.columns import MILLI, OWN, Channel, Unit

Kind = Literal["cell", "balancing", "temperature"]

MOST_CELLS = 2000
# Pattern of a column's name, what it holds, its unit, and what its number counts from.
_PATTERNS: tuple[tuple[re.Pattern[str], Kind, Unit, int], ...] = (
    (re.compile(r"cell_?(\d+)_?V", re.IGNORECASE), "cell", OWN, 1),
    (re.compile(r"cell_?(\d+)_?mV", re.IGNORECASE), "cell", MILLI, 1),
    (re.compile(r"CP(\d+)"), "cell", MILLI, 1),  # LeafSpy
    (re.compile(r"voltage_cell_v\[(\d+)\]"), "cell", OWN, 0),  # PX4
    (re.compile(r"cell_?(\d+)_balancing", re.IGNORECASE), "balancing", OWN, 1),
    (re.compile(r"temperature_?(\d+)_?C", re.IGNORECASE), "temperature", OWN, 1),
)


@dataclass(frozen=True)
class CellColumn:
    """One column: its name in the file, what it holds, its number from 1, its unit."""

    name: str
    kind: Kind
    number: int
    unit: Unit

    @property
    def field(self) -> str:
        """Key among the channels that a reader returns."""
        return f"{self.kind}:{self.number}"

    @property
    def channel(self) -> Channel:
        """The column as a channel of a format."""
        return Channel(self.field, {self.name: self.unit})


def cell_columns(header: Sequence[str], where: str) -> tuple[CellColumn, ...]:
    """The columns of a pack among a file's, cells in the order of their numbers.

    Raises
    ------
    InputError        no cell voltage; two columns for one cell
    """
    found = []
    for name in header:
        for pattern, kind, unit, first in _PATTERNS:
            match = pattern.fullmatch(name.strip())
            if match:
                found.append(CellColumn(name.strip(), kind, int(match[1]) + 1 - first, unit))
                break
    found.sort(key=lambda c: (c.kind, c.number))
    _check(found, header, where)
    return tuple(found)


def known_cell(name: str) -> tuple[int, Unit] | None:
    """Number from 1 and unit of the cell whose voltage a column of this name holds, if any."""
    for pattern, kind, unit, first in _PATTERNS:
        match = pattern.fullmatch(name)
        if match and kind == "cell":
            return int(match[1]) + 1 - first, unit
    return None


def cells_named(header: Sequence[str]) -> int:
    """For how many cells a table has a column with the voltage."""
    return sum(known_cell(name.strip()) is not None for name in header)


def cell_name(number: int, cells: int) -> str:
    """``cell_01``: the number with as many digits as the largest one needs, two at least."""
    return f"cell_{number:0{max(2, len(str(cells)))}d}"


def _check(found: Sequence[CellColumn], header: Sequence[str], where: str) -> None:
    cells = [c for c in found if c.kind == "cell"]
    if len(cells) < 2:
        named = ", ".join(f"'{name.strip()}'" for name in header[:12])
        raise InputError(
            f"{len(cells)} cell voltage(s) in {where}, whose columns are {named}",
            "at least two columns cell_01_V, cell_02_V, ... (or cell_01_mV, ...)",
            "Name the cells' columns so; a log of one cell goes to `cellwise replay`.",
        )
    if len(cells) > MOST_CELLS:
        raise InputError(f"{len(cells)} cells in {where}", f"at most {MOST_CELLS}", "Split it.")
    for a, b in pairwise(found):
        if (a.kind, a.number) == (b.kind, b.number):
            raise InputError(
                f"columns '{a.name}' and '{b.name}' for the {a.kind} number {a.number} in {where}",
                "one column for each",
                "Remove or rename the one that is not meant.",
            )
