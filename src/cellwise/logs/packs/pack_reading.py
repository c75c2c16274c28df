"""Read a pack's log: the tidy form with a column for each cell, LeafSpy's names, PX4's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

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
    cell_columns,
    cell_name,
    cells_named,
    checked_cells,
    mean_of_known,
    mean_voltage_V,
)
from cellwise.logs.packs.pack_log import PackLog
from cellwise.logs.stated import Stated
from cellwise.typing import BoolArray, FloatArray

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
    mean = assemble(CellLog, RawLog(kept, tuple(notices)), origin, sign, check_sign=check_sign)
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
