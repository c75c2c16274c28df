"""A pack's log and how it is read: one current, the voltage of every cell, flags of both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.files.assembly import assemble, complete
from cellwise.logs.files.columns import TIDY_CHANNELS, listed
from cellwise.logs.files.csv_text import csv_layout
from cellwise.logs.files.format import Format, Reader, one_battery
from cellwise.logs.files.source import LogSource
from cellwise.logs.files.tables import is_parquet, parquet_names
from cellwise.logs.packs.cells import (
    MILLIVOLTS,
    CellColumn,
    CellFlag,
    cell_columns,
    cell_name,
    checked_cells,
    known_column,
    mean_of_known,
    mean_voltage_V,
    to_cell,
)
from cellwise.notices import Code, Notice
from cellwise.typing import BoolArray, FloatArray
from cellwise.wording import arg


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
    flags: tuple[CellFlag, ...] = ()
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
    def notices(self) -> tuple[Notice, ...]:
        """What a person should know: of the cells first, then of reading the log."""
        return (*dict.fromkeys(flag.notice for flag in self.flags), *self.mean.notices)

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
        pack_V: ArrayLike | None = None,
        balancing: ArrayLike | None = None,
        **more: Any,
    ) -> Self:
        """A pack from arrays, checked.

        Parameters
        ----------
        time_s, current_A : (n,) float       positive current is discharge
        cell_V : (n, cells) float            a negative voltage is that of a cell being balanced
        names : sequence of str              None: ``cell_01``, ...
        pack_V : (n,) float                  of the whole pack
        balancing : (n, cells) bool
        more                                 fields of `CellLog`: ``temperature_C`` and
                                             ``charge_Ah`` of the pack, ``name``, ...

        Raises
        ------
        InputError        shapes that do not agree, cells in millivolts, not two cells that measure
        """
        volts = np.array(cell_V, dtype=np.float64)
        rows = np.size(time_s)
        where = f"'{more.get('source') or more.get('name') or 'the pack'}'"
        if volts.ndim != 2 or volts.shape[0] != rows:
            raise InputError(
                f"cell voltages of shape {volts.shape} with {rows} rows in {where}",
                f"shape ({rows}, cells)",
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
        channels = {"time_s": time_s, "current_A": current_A, "voltage_V": mean_voltage_V(volts)}
        mean = CellLog(**{**more, **channels, "series": count})
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
FIELDS = tuple(channel.field for channel in TIDY_CHANNELS)


def pack_columns(source: LogSource, known: Format) -> tuple[CellColumn, ...]:
    """The pack's columns of a file.

    Raises
    ------
    InputError        no voltages of several cells, two columns for one
    """
    names = _names(source, known)
    columns = cell_columns(names, source.where, source.options.channels)
    if sum(c.kind == "cell" for c in columns) < 2:
        raise _no_pack(source, f"columns are {listed(names)}")
    return columns


def columns_of_table(source: LogSource, known: Format) -> tuple[CellColumn, ...]:
    """The pack's columns of a table that holds a voltage for each of several cells; else none."""
    if known.name not in TABLES:
        return ()
    columns = cell_columns(_names(source, known), source.where, source.options.channels)
    return columns if sum(c.kind == "cell" for c in columns) > 1 else ()


def pack_of(
    source: LogSource,
    known: Format,
    columns: Sequence[CellColumn],
    read: Reader,
    *,
    sign: str,
    name: str,
    check_sign: bool = True,
) -> PackLog:
    """The pack of a file that has been looked at, by a reader of its channels.

    Raises
    ------
    InputError        two columns for one cell, no two cells that were measured, or whatever
                      `read_log` refuses
    """
    # The pack's own voltage is not required.
    own = tuple(replace(c, required=c.required and c.field != "voltage_V") for c in known.channels)
    wide = replace(known, channels=(*own, *(c.channel for c in columns)))
    chosen = {n: c for n, c in source.options.channels.items() if known_column(n) is None}
    source = replace(source, options=replace(source.options, channels=chosen))
    raw = complete(one_battery(read(source, wide), source, wide), known.sign, source.where)
    found = raw.channels

    def of_kind(kind: str) -> list[CellColumn]:
        return [c for c in columns if c.kind == kind and c.field in found]

    # A short string never fills the last places of a ULog.
    ulog = known.name == "px4-ulog"
    cells = [c for c in of_kind("cell") if not ulog or np.nanmax(found[c.field]) > 0.0]
    if len(cells) < 2:
        raise _no_pack(source, f"cells with a voltage are {len(cells)}")
    names = tuple(cell_name(c.number, cells[-1].number) for c in cells)
    volts = np.stack([found[c.field] for c in cells], axis=1)
    unsaid = [k for k, c in enumerate(cells) if not c.stated]
    if unsaid and np.nanmedian(np.abs(volts[:, unsaid])) > MILLIVOLTS:
        volts[:, unsaid] /= 1e3
        text = "the cells' voltages, whose names state no unit, are in millivolts"
        raw = raw.noted([Notice(Code.CELLS_CONVERTED, text)])
    balancing = None
    if bypasses := {c.number: found[c.field] > 0.0 for c in of_kind("balancing")}:
        never = np.zeros(len(volts), dtype=np.bool_)
        balancing = np.stack([bypasses.get(c.number, never) for c in cells], axis=1)
    pack_V = found.get("voltage_V")
    volts, balancing, flags = checked_cells(volts, balancing, names, pack_V, source.where)
    mean = {field: found[field] for field in FIELDS if field in found}
    mean["voltage_V"] = mean_voltage_V(volts)
    if measured_C := [found[c.field] for c in of_kind("temperature")]:
        mean.setdefault("temperature_C", mean_of_known(np.stack(measured_C, axis=1)))
    # A conversion of each cell's column is not news.
    of_cell = {c.name for c in cells}
    notices = [n for n in raw.notices if n.column not in of_cell]
    of_cells = replace(raw, channels=mean, notices=tuple(notices), cells=None)
    one = to_cell(of_cells, replace(source.options, series=1), source.where)
    log = assemble(one, known, source.path, name, sign, check_sign=check_sign)
    parallel = source.options.parallel
    log = replace(log, series=len(names), parallel=parallel)
    return PackLog(log, volts, names, balancing, pack_V, flags, parallel)


def _names(source: LogSource, known: Format) -> list[str]:
    """Names of a file's columns."""
    if known.name == "px4-ulog":
        return [f"voltage_cell_v[{k}]" for k in range(ULOG_CELLS)]
    if is_parquet(source):
        return parquet_names(source)
    return list(csv_layout(source).header) if source.is_text else []


def _no_pack(source: LogSource, found: str) -> InputError:
    return InputError(
        f"no pack in {source.where}, whose {found}",
        "at least two columns cell_01_V, cell_02_V, ... (or cell_01_mV, ...)",
        "Name the cells' columns so, or say which they are ("
        + arg("channels", ("cell_01_V", "COLUMN"))
        + ", "
        "one for each); a log of one cell goes to `cellwise replay`.",
    )
