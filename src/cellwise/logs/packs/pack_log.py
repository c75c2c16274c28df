"""A pack's log and how it is read: one current, the voltage of every cell, flags of both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.files.assembly import Origin, assemble, complete
from cellwise.logs.files.columns import TIDY_CHANNELS, Channel
from cellwise.logs.files.csv_layout import csv_layout
from cellwise.logs.files.format import Format, detect_format
from cellwise.logs.files.named_columns import is_parquet, parquet_names
from cellwise.logs.files.source import LogSource, RawLog, ReadOptions, open_source
from cellwise.logs.formats import FORMATS
from cellwise.logs.packs.cells import (
    CellColumn,
    CellFlag,
    cell_columns,
    cell_name,
    cells_named,
    checked_cells,
    mean_of_known,
    mean_voltage_V,
)
from cellwise.logs.stated import Stated
from cellwise.typing import BoolArray, FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class PackLog:
    """Cells in series: one current, one voltage each.

    Parameters
    ----------
    mean : CellLog                the mean cell: current, temperature, mean of the cells' voltages
    cell_V : (n, cells) float     voltage of every cell [V]; NaN where it is missing or not believed
    names : tuple of str          ``cell_01``, ...
    balancing : (n, cells) bool or None      the cell's bypass is on
    pack_V : (n,) float or None   voltage of the whole pack [V], where it was measured
    flags : tuple of CellFlag     what is wrong with cells' voltages before any model is asked
    parallel : int                strings in parallel, of which the current is that of one

    Notes
    -----
    Cells of one pack need not be polled at one instant; how far apart they are is for
    :mod:`cellwise.pack` to find.
    """

    mean: CellLog
    cell_V: FloatArray
    names: tuple[str, ...]
    balancing: BoolArray | None = None
    pack_V: FloatArray | None = None
    flags: tuple[CellFlag, ...] = field(default=())
    parallel: int = 1

    def __len__(self) -> int:
        return len(self.mean)

    def __repr__(self) -> str:
        return f"PackLog({self.name or 'unnamed'}: {self.cells} cells, {len(self)} rows)"

    @property
    def name(self) -> str:
        """For people."""
        return self.mean.name

    @property
    def cells(self) -> int:
        """Number of cells with a column."""
        return len(self.names)

    @property
    def notices(self) -> tuple[str, ...]:
        """What a person should know: of the cells first, then of reading the log."""
        return (*dict.fromkeys(flag.text for flag in self.flags), *self.mean.notices)

    @property
    def difference_V(self) -> FloatArray:
        """Every cell's voltage minus the mean cell's [V], shape (n, cells)."""
        return np.asarray(self.cell_V - self.mean.voltage_V[:, None])

    @classmethod
    def from_arrays(
        cls,
        time_s: ArrayLike,
        current_A: ArrayLike,
        cell_V: ArrayLike,
        *,
        names: Sequence[str] | None = None,
        temperature_C: ArrayLike | None = None,
        charge_Ah: ArrayLike | None = None,
        pack_V: ArrayLike | None = None,
        balancing: ArrayLike | None = None,
        name: str = "",
        source: str = "",
        notices: Sequence[str] = (),
    ) -> Self:
        """A pack from arrays, checked.

        Parameters
        ----------
        time_s, current_A : (n,) float       positive current is discharge
        cell_V : (n, cells) float            a negative voltage is that of a cell being balanced
        names : sequence of str              None: ``cell_01``, ...
        temperature_C : (n,) float           of the pack
        charge_Ah : (n,) float               counter of the pack's current
        pack_V : (n,) float                  of the whole pack
        balancing : (n, cells) bool

        Raises
        ------
        InputError        shapes that do not agree, cells in millivolts, not two cells that measure
        """
        time = np.asarray(time_s, dtype=np.float64)
        volts = np.array(cell_V, dtype=np.float64)
        where = f"'{source or name}'" if source or name else "the pack"
        if volts.ndim != 2 or volts.shape[0] != time.size:
            raise InputError(
                f"cell voltages of shape {volts.shape} with {time.size} rows in {where}",
                f"shape ({time.size}, cells)",
                "Give one column for each cell and one row for each time.",
            )
        count = volts.shape[1]
        named = tuple(names or (cell_name(k + 1, count) for k in range(count)))
        if len(named) != count or len(set(named)) != count:
            raise InputError(
                f"{len(named)} names ({len(set(named))} different) for {count} cells in {where}",
                "one name for each cell",
                "Correct the names.",
            )
        bypass = None if balancing is None else np.array(balancing, dtype=np.bool_)
        pack = None if pack_V is None else np.asarray(pack_V, dtype=np.float64)
        volts, bypass, flags = checked_cells(volts, bypass, named, pack, where)
        mean = CellLog(
            time_s=time,
            current_A=np.asarray(current_A, dtype=np.float64),
            voltage_V=mean_voltage_V(volts),
            temperature_C=None if temperature_C is None else np.asarray(temperature_C, np.float64),
            charge_Ah=None if charge_Ah is None else np.asarray(charge_Ah, np.float64),
            name=name,
            source=source,
            format="pack",
            notices=tuple(notices),
        )
        return cls(mean, volts, named, bypass, pack, flags)

    def rows(self, rows: Any) -> Self:
        """The chosen rows, time kept."""

        def taken(a: Any) -> Any:
            return None if a is None else a[rows]

        return replace(
            self,
            mean=self.mean.rows(rows),
            cell_V=self.cell_V[rows],
            balancing=taken(self.balancing),
            pack_V=taken(self.pack_V),
        )

    def with_cells(self, cell_V: FloatArray) -> Self:
        """The same log with other cell voltages, shape (n, cells): mean and checks again."""
        mean = self.mean
        return type(self).from_arrays(
            mean.time_s,
            mean.current_A,
            cell_V,
            names=self.names,
            temperature_C=mean.temperature_C,
            charge_Ah=mean.charge_Ah,
            pack_V=self.pack_V,
            balancing=self.balancing,
            name=mean.name,
            source=mean.source,
            notices=mean.notices,
        )

    def columns(self) -> Mapping[str, FloatArray]:
        """The tidy form's columns: time, current, temperature, ``cell_01_V``, ..."""
        mean = self.mean
        found = {"time_s": mean.time_s, "current_A": mean.interval_current_A}
        if mean.temperature_C is not None:
            found["temperature_C"] = mean.temperature_C
        for k, name in enumerate(self.names):
            found[f"{name}_V"] = self.cell_V[:, k]
        return found


ULOG_CELLS = 16
TABLES = ("tidy-parquet", "tidy-csv", "leafspy-csv")  # formats with a column for each cell


def read_pack(
    path: str | Path | Stated,
    *,
    sign: str = "auto",
    parallel: int = 1,
    channels: Mapping[str, str] | None = None,
    instance: int | None = None,
    name: str | None = None,
) -> PackLog:
    """Read a log with a voltage for each cell.

    The tidy form is ``time_s, current_A, cell_01_V, cell_02_V, ...`` (or ``cell_01_mV``), with
    ``voltage_V`` (of the pack), ``temperature_C`` or ``temperature_1_C``, ... and
    ``cell_01_balancing``, ... where they were recorded. Columns ``CP1``, ... of LeafSpy and the
    cells of a PX4 ULog are known too.

    Parameters
    ----------
    path : str, Path or Stated      a string may state temperature and initial SOC behind an @
    sign : str                      ``auto``, ``charge-positive`` or ``discharge-positive``
    parallel : int                  cells in parallel that the model is not for: divides the current
    channels : mapping              which column is which, as of `read_log`
    instance : int                  which battery of a file that holds several

    Raises
    ------
    InputError        no cell voltages, or whatever `read_log` refuses
    """
    stated = path if isinstance(path, Stated) else Stated(str(path))
    if isinstance(path, str):
        stated = Stated.parse(path)
    options = ReadOptions(parallel=parallel, channels=dict(channels or {}), instance=instance)
    source = open_source(stated.path, None, options)
    known = detect_format(source, FORMATS)
    names = _names(source, known)
    pack = pack_of(source, known, cell_columns(names, source.where), sign=sign, name=name)
    return replace(pack, mean=stated.applied(pack.mean))


def columns_of_table(source: LogSource, known: Format) -> tuple[CellColumn, ...]:
    """The pack's columns of a table that holds a voltage for each of several cells; else none."""
    if known.name not in TABLES:
        return ()
    names = _names(source, known)
    return cell_columns(names, source.where) if cells_named(names) > 1 else ()


def pack_of(
    source: LogSource,
    known: Format,
    columns: tuple[CellColumn, ...],
    *,
    sign: str = "auto",
    name: str | None = None,
    check_sign: bool = True,
) -> PackLog:
    """The pack of a file that has been looked at.

    Raises
    ------
    InputError        no cell voltages, or whatever `read_log` refuses
    """
    raw = known.read(source, _with_cells(known, columns))
    raw = complete(raw, known.sign, source.where)
    origin = Origin(
        name=source.path.name.split(".")[0] if name is None else name,
        source=str(source.path),
        format=known.name,
        sign=known.sign,
        current_meaning=known.current_meaning,
    )
    return _assembled(raw, columns, source, origin, sign, check_sign)


def _names(source: LogSource, known: Format) -> list[str]:
    """Names of a file's columns."""
    if known.name == "px4-ulog":
        return [f"voltage_cell_v[{k}]" for k in range(ULOG_CELLS)]
    if is_parquet(source):
        return parquet_names(source)
    return list(csv_layout(source).header) if source.is_text else []


def _with_cells(known: Format, columns: tuple[CellColumn, ...]) -> Format:
    """The format with the pack's columns; a pack's own voltage is not required."""
    base: tuple[Channel, ...] = tuple(
        replace(c, required=False) if c.field == "voltage_V" else c for c in known.channels
    )
    return replace(known, channels=(*base, *(c.channel for c in columns)))


def _assembled(
    raw: RawLog,
    columns: tuple[CellColumn, ...],
    source: LogSource,
    origin: Origin,
    sign: str,
    check_sign: bool,
) -> PackLog:
    channels = dict(raw.channels)
    timed = np.isfinite(channels["time_s"])
    if not timed.any():
        raise InputError(f"no time in {source.where}", "seconds in every row", "Check the column.")
    notices = [n for n in raw.notices if not _of_cells(n, columns)]
    if not timed.all():
        channels = {field: values[timed] for field, values in channels.items()}
        notices.append(f"{np.count_nonzero(~timed)} row(s) without a time left out")
    cells = _there(channels, columns)
    if len(cells) < 2:
        raise InputError(
            f"{len(cells)} cell(s) with a voltage in {source.where}",
            "at least two",
            "A log of one cell goes to `cellwise replay`.",
        )
    count = max(c.number for c in cells)
    names = tuple(cell_name(c.number, count) for c in cells)
    volts = np.stack([channels.pop(c.field) for c in cells], axis=1)
    pack_V = channels.pop("voltage_V", None)
    balancing = _balancing(channels, cells, columns)
    warm = [channels.pop(c.field) for c in columns if c.kind == "temperature"]
    if warm and "temperature_C" not in channels:
        channels["temperature_C"] = mean_of_known(np.stack(warm, axis=1))
    volts, balancing, flags = checked_cells(volts, balancing, names, pack_V, source.where)
    channels["voltage_V"] = mean_voltage_V(volts)
    if source.options.parallel > 1:
        for field in ("current_A", "charge_Ah"):
            if field in channels:
                channels[field] = channels[field] / source.options.parallel
        notices.append(f"current of {source.options.parallel} in parallel, read as that of one")
    fields = {c.field for c in TIDY_CHANNELS}
    kept = {field: values for field, values in channels.items() if field in fields}
    mean = assemble(RawLog(kept, tuple(notices)), origin, sign, check_sign=check_sign)
    return PackLog(mean, volts, names, balancing, pack_V, flags, source.options.parallel)


def _there(
    channels: dict[str, FloatArray], columns: tuple[CellColumn, ...]
) -> tuple[CellColumn, ...]:
    """The cells' columns that the reader found, without those that a short string never fills."""
    return tuple(
        c
        for c in columns
        if c.kind == "cell"
        and c.field in channels
        and not (c.name.startswith("voltage_cell_v") and not np.nanmax(channels[c.field]) > 0.0)
    )


def _balancing(
    channels: dict[str, FloatArray], cells: tuple[CellColumn, ...], columns: tuple[CellColumn, ...]
) -> BoolArray | None:
    flagged = {c.number: channels.pop(c.field) for c in columns if c.kind == "balancing"}
    if not flagged:
        return None
    none = np.zeros(channels["time_s"].size)
    return np.stack([flagged.get(c.number, none) > 0.0 for c in cells], axis=1)


def _of_cells(notice: str, columns: tuple[CellColumn, ...]) -> bool:
    """A notice about the unit of a cell's column, or one that only lists them."""
    return any(f"column '{c.name}' was converted" in notice for c in columns)
