"""Cells of a pack: which columns they are, what is wrong with them before any model is asked."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.checks.units import LARGEST_V
from cellwise.logs.files.columns import OWN, UNITS, Channel, Unit, no_such_name
from cellwise.logs.files.source import FROM_FILE, RawLog, ReadOptions
from cellwise.notices import Code, Notice
from cellwise.typing import BoolArray, FloatArray
from cellwise.wording import Option, arg

Kind = Literal["cell", "balancing", "temperature"]

# `Cell 1 (V)`, `cell_voltage_1`, `cellVoltage1`, `cell 1 mv`, `voltageCell1`, `Zelle 01 [V]`: a
# word for a cell, perhaps one for its voltage, before or behind it, its number, and a unit.
_CELL = r"(?:cells?|zellen?|celda|cellule|cella|cel|电芯|单体|セル)"
_VOLTAGE = r"(?:voltages?|volts?|spannung|tension|tensión|tensione|tensão|电压|電圧|[vu])"
_OWNER = r"(?:sensor|bms|pack|batt?|battery|batterie|module)"
_NAME = (
    rf"(?:{_OWNER}-){{0,2}}(?:{_VOLTAGE}-)?{_CELL}-(?:{_VOLTAGE}-)?(?:n[or]-)?(?P<n>\d+)"
    rf"(?:-{_VOLTAGE})??-(?P<unit>m?v)?-"
).replace("-", r"[\s_.,:#/()\[\]-]*")
# Pattern of a column's name, what it holds, its unit (None: as the name says), and what its number
# counts from.
_PATTERNS: tuple[tuple[re.Pattern[str], Kind, Unit | None, int], ...] = (
    (re.compile(r"CP(?P<n>\d+)"), "cell", UNITS["mV"], 1),  # LeafSpy
    (re.compile(r"voltage_cell_v\[(?P<n>\d+)\]"), "cell", OWN, 0),  # PX4
    (re.compile(_NAME, re.IGNORECASE), "cell", None, 1),
    (re.compile(r"C ?(?P<n>\d+) ?[(\[](?P<unit>m?V)[)\]]"), "cell", None, 1),
    (re.compile(r"cell_?(?P<n>\d+)_balancing", re.IGNORECASE), "balancing", OWN, 1),
    (re.compile(r"temperature_?(?P<n>\d+)_?C", re.IGNORECASE), "temperature", OWN, 1),
)


@dataclass(frozen=True)
class CellColumn:
    """One column: its name in the file, what it holds, its number from 1, its unit.

    ``stated``: the name states the unit.
    """

    name: str
    kind: Kind
    number: int
    unit: Unit
    stated: bool = True

    @property
    def field(self) -> str:
        """Key among the channels that a reader returns."""
        return f"{self.kind}:{self.number}"

    @property
    def channel(self) -> Channel:
        """The column as a channel of a format."""
        return Channel(self.field, {self.name: self.unit})


def cell_columns(
    header: Sequence[str], where: str, chosen: Mapping[str, str] | None = None
) -> tuple[CellColumn, ...]:
    """The columns of a pack among a file's, cells in the order of their numbers.

    ``chosen``: what the user stated, a cell's tidy name to the name in the file.

    Raises
    ------
    InputError        two columns for one cell; a stated name that the file has not
    """
    names = [name.strip() for name in header]
    found = []
    for tidy, name in (chosen or {}).items():
        if (c := known_column(tidy)) is not None:
            if name not in names:
                raise no_such_name(name, names, where)
            found.append(replace(c, name=name))
    if not found:
        found = [c for name in names if (c := known_column(name)) is not None]
    # Numbers of a program that counts from 0.
    first = min((c.number for c in found if c.kind == "cell"), default=1)
    if first == 0:
        found = [replace(c, number=c.number + 1) if c.kind == "cell" else c for c in found]
    found.sort(key=lambda c: (c.kind, c.number))
    for a, b in pairwise(found):
        if a.field == b.field:
            raise InputError(
                f"columns '{a.name}' and '{b.name}' for the {a.kind} number {a.number} in {where}",
                "one column for each",
                "Remove or rename the one that is not meant.",
            )
    return tuple(found)


def known_column(name: str) -> CellColumn | None:
    """What a column of this name holds of a pack; None: nothing."""
    for pattern, kind, unit, first in _PATTERNS:
        if match := pattern.fullmatch(name):
            said = "v" if unit is not None else (match["unit"] or "")
            own = unit or (UNITS["mV"] if said.casefold() == "mv" else OWN)
            return CellColumn(name, kind, int(match["n"]) + 1 - first, own, bool(said))
    return None


def cell_name(number: int, cells: int) -> str:
    """``cell_01``: the number with as many digits as the largest one needs, two at least."""
    return f"cell_{number:0{max(2, len(str(cells)))}d}"


FlagKind = Literal["missing", "dead", "frozen", "balancing", "count"]


# From where on a cell's voltage is not believed.
POSSIBLE_V = (0.5, LARGEST_V)  # of a cell
MILLIVOLTS = 500.0  # typical values above are in that unit
# Of one value, while the mean cell moves, are frozen; as many last ones without a value, dead.
REPEATED_ROWS = 50
MOVE_V = 0.02  # by which the mean cell moves then
MISSING = 0.5  # share of the rows: a cell that misses more is not estimated
SPIKE_V = 0.05  # from the others, as no cell under load is: not part of the mean
TOLERANCE_CELLS = 0.3  # between the pack's voltage and the sum of the cells


@dataclass(frozen=True)
class CellFlag:
    """What was found: of one cell, or of the pack (``cell`` empty), and a line for people."""

    cell: str
    kind: FlagKind
    text: str
    rows: range | None = None

    @property
    def notice(self) -> Notice:
        """The same among the notices of a log."""
        return Notice(OF_FLAG[self.kind], self.text, rows=self.rows)


OF_FLAG: dict[FlagKind, Code] = {
    "missing": Code.CELL_MISSING,
    "dead": Code.CELL_DEAD,
    "frozen": Code.CELL_FROZEN,
    "balancing": Code.CELL_BALANCING,
    "count": Code.CELLS_UNCOUNTED,
}


def checked_cells(
    volts: FloatArray,
    balancing: BoolArray | None,
    names: Sequence[str],
    pack_V: FloatArray | None,
    where: str,
) -> tuple[FloatArray, BoolArray | None, tuple[CellFlag, ...]]:
    """Cells' voltages as far as they can be believed, balancing flags, and what was found.

    Parameters
    ----------
    volts : (n, cells) float      changed in place

    Raises
    ------
    InputError        millivolts under the name of volts; fewer than two cells that measure
    """
    some = volts[np.isfinite(volts)][:: max(volts.size // 10_000, 1)]
    typical = float(np.median(np.abs(some))) if some.size else np.nan
    if not np.isfinite(typical):
        raise InputError(f"no cell voltage in {where}", "numbers", "Check the cells' columns.")
    if typical > MILLIVOLTS:
        raise InputError(
            f"cell voltages of typically {typical:.0f} under the names cell_.._V in {where}",
            "volts",
            "They look like millivolts: name the columns cell_01_mV, ...",
        )
    negative = volts < -POSSIBLE_V[0]
    np.abs(volts, out=volts, where=negative)
    if negative.any():
        balancing = negative if balancing is None else balancing | negative
    flags = [*_absent(names), *_bypassed(negative, names), *_unbelieved(volts, names)]
    if np.count_nonzero(np.any(np.isfinite(volts), axis=0)) < 2:
        raise InputError(
            f"fewer than two cells with a voltage that can be believed in {where} "
            f"({'; '.join(f.text for f in flags[:3])})",
            "at least two cells that measure",
            "Check the cells' columns and their unit.",
        )
    if pack_V is not None:
        flags += _uncounted(volts, pack_V)
    return volts, balancing, tuple(flags)


def mean_voltage_V(volts: FloatArray) -> FloatArray:
    """Mean of the cells' voltages of every row [V], readings far from the others left out.

    A cell that misses some rows must not move the mean by its usual difference: each cell counts
    with its own mean difference, which is added where it is missing.
    """
    with np.errstate(invalid="ignore", divide="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # rows and cells without any value
        known = np.isfinite(volts)
        complete = bool(known.all())
        first = volts.mean(axis=1) if complete else mean_of_known(volts)
        apart = volts - first[:, None]
        spike = np.abs(apart) > SPIKE_V
        if complete and not spike.any():
            return np.asarray(first)
        # Cells whose whole level is apart are not spikes; a median is not moved by either.
        level = np.nanmedian(apart[:: max(len(apart) // 1000, 1)], axis=0)
        level = np.nan_to_num(level)
        used = known & (np.abs(apart - level) <= SPIKE_V)
        used |= known & ~used.any(axis=1)[:, None]
        centred = np.where(used, volts - level, 0.0).sum(axis=1) / used.sum(axis=1)
        alive = known.any(axis=0)
        return np.asarray(centred + level[alive].mean())


def mean_of_known(values: FloatArray) -> FloatArray:
    """Mean of every row's finite values; NaN where there is none."""
    known = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(known, values, 0.0).sum(axis=1) / known.sum(axis=1))


def _absent(names: Sequence[str]) -> Iterator[CellFlag]:
    """Numbers that are left out among the names: columns that the file has not."""
    numbers = {int(m[1]) for m in (re.fullmatch(r"\D*(\d+)", name) for name in names) if m}
    if len(numbers) != len(names):
        return
    largest = max(numbers)
    absent = sorted(set(range(1, largest + 1)) - numbers)
    for name in (cell_name(k, largest) for k in absent if len(absent) <= len(numbers)):
        text = f"there is no column of {name} among those of cells up to {largest}"
        yield CellFlag(name, "missing", text)


def _bypassed(negative: BoolArray, names: Sequence[str]) -> Iterator[CellFlag]:
    """Negative voltages are those of cells whose bypass is on (LeafSpy writes them so)."""
    some = [name for name, rows in zip(names, negative.T, strict=True) if rows.any()]
    if some:
        named = ", ".join(some[:4]) + (", ..." if len(some) > 4 else "")
        text = f"negative voltages of {len(some)} cell(s) ({named}) were read as those of cells"
        yield CellFlag("", "balancing", f"{text} being balanced")
    for k in np.flatnonzero(negative.all(axis=0)).tolist():
        text = f"{names[k]} is negative in every row, as if balanced all the time: its wires may be"
        yield CellFlag(names[k], "balancing", f"{text} reversed; it is not estimated")


def _unbelieved(volts: FloatArray, names: Sequence[str]) -> Iterator[CellFlag]:
    """Readings that no cell has, or that stay the same to the last digit: made missing.

    A cell most of whose readings are such is not estimated.
    """
    low, high = POSSIBLE_V
    wrong = ~((volts >= low) & (volts <= high))
    share = wrong.mean(axis=0)
    most = wrong.mean(axis=1) < MISSING
    for k in np.flatnonzero(share > 0.0).tolist():
        bad, name = wrong[:, k], names[k]
        seen = volts[bad & np.isfinite(volts[:, k]), k]
        what = f"reads {np.median(seen):.3g} V" if seen.size else "has no value"
        volts[bad, k] = np.nan
        there = np.flatnonzero(~bad)
        last = int(there[-1]) + 1 if there.size else 0
        if share[k] > MISSING:
            volts[:, k] = np.nan
            text = f"{name} {what} in {100 * share[k]:.0f} % of the rows: it is not estimated"
            yield CellFlag(name, "dead", text)
        elif np.count_nonzero(most[last:]) >= REPEATED_ROWS:
            text = f"{name} {what} from row {last + 1} on: earlier rows are used alone"
            yield CellFlag(name, "dead", text, range(last, len(volts)))
        else:
            count = np.count_nonzero(bad)
            text = f"{name} has {count} row(s) without a possible voltage, which are left out"
            yield CellFlag(name, "missing", text)
    still, moved = _still(volts)
    for k in np.flatnonzero((still & moved[:, None]).any(axis=0)).tolist():
        repeated = np.repeat(still[:, k], REPEATED_ROWS)
        gone = float((still[:, k] & moved).sum() / moved.sum())
        volts[: repeated.size][repeated, k] = np.nan
        end = "those rows are left out"
        if gone > MISSING:
            volts[:, k] = np.nan
            end = "it is not estimated"
        text = f"{names[k]} repeats one value while the other cells move ({100 * gone:.0f} % of the"
        yield CellFlag(names[k], "frozen", f"{text} time under load): {end}")


def _still(volts: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Blocks of rows in which each cell repeats one value, and those in which the cells moved."""
    blocks, cells = len(volts) // REPEATED_ROWS, volts.shape[1]
    parts = volts[: blocks * REPEATED_ROWS].reshape(blocks, REPEATED_ROWS, cells)
    still = np.max(parts, axis=1) == np.min(parts, axis=1)  # a missing value compares as moving
    moved = np.zeros(blocks, dtype=np.bool_)
    if cells > 2 and still.any():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # rows without any value
            middle = np.nanmedian(parts[:, :, :: max(cells // 12, 1)], axis=2)
            moved = np.nanmax(middle, axis=1) - np.nanmin(middle, axis=1) > MOVE_V
    return still, moved


def _uncounted(volts: FloatArray, pack_V: FloatArray) -> Iterator[CellFlag]:
    """The pack's voltage against the sum of the cells: cells without a column."""
    cells = volts.shape[1]
    some = slice(None, None, max(len(volts) // 2000, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        ratio = float(np.nanmedian(pack_V[some] / np.nanmedian(volts[some], axis=1)))
    # Of the mean cell, of all cells, or of others: the sum's last digits grow with the cells.
    known = (
        abs(ratio - 1.0) < TOLERANCE_CELLS or abs(ratio - cells) <= TOLERANCE_CELLS + cells / 500
    )
    if np.isfinite(ratio) and not known:
        text = f"the pack's voltage is that of {ratio:.1f} cells in series, and {cells} have a"
        yield CellFlag("", "count", f"{text} column")


def to_cell(raw: RawLog, options: ReadOptions, where: str) -> RawLog:
    """Divide a pack's voltage by the cells in series, current and counter by those in parallel.

    Raises
    ------
    InputError        the file does not state the cells in series
    """
    series = options.series
    if series == FROM_FILE:
        if raw.cells is None:
            raise InputError(
                arg("series", "auto") + f" for {where}, which does not state its cells in series",
                "a number of cells",
                "Give it: " + arg("series", 4) + ", say.",
            )
        series = raw.cells
    notices = list(raw.notices)
    if raw.cells is not None and raw.cells > 1 and options.series == 1:
        text = f"the file states {raw.cells} cells in series: "
        said = (text, Option("series", "auto"), " reads their mean cell")
        notices.append(Notice(Code.CELLS_NOT_DIVIDED, said))
    elif raw.cells is not None and raw.cells != series:
        text = f"the file states {raw.cells} cells in series, {series} were stated by the user"
        notices.append(Notice(Code.CELLS_DISAGREE, text))
    channels = dict(raw.channels)
    if series > 1:
        channels["voltage_V"] = channels["voltage_V"] / series
    if options.parallel > 1:
        for field in ("current_A", "charge_Ah"):
            if field in channels:
                channels[field] = channels[field] / options.parallel
    if series > 1 or options.parallel > 1:
        text = (
            f"a pack of {series} in series, {options.parallel} in parallel, read as its mean cell"
        )
        notices.append(Notice(Code.PACK_DIVIDED, text))
    return replace(
        raw,
        channels=channels,
        notices=tuple(notices),
        series=series,
        parallel=options.parallel,
    )
