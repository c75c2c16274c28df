"""Read a measured log, whatever its format."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.files.assembly import Origin, assemble
from cellwise.logs.files.completion import complete
from cellwise.logs.files.format import Format, detect_format
from cellwise.logs.files.source import (
    FROM_FILE,
    LogSource,
    Progress,
    RawLog,
    ReadOptions,
    open_source,
)
from cellwise.logs.formats import FORMATS
from cellwise.logs.isolated import read_channels
from cellwise.logs.packs.cell_columns import CellColumn
from cellwise.logs.packs.pack_reading import columns_of_table, pack_of
from cellwise.logs.places import plain_name
from cellwise.logs.stated import Stated

TIDY = ("tidy-parquet", "tidy-csv")
AS_MEAN_CELL = "read as their mean cell"  # marks the notice


def read_log(
    path: str | Path | Stated,
    *,
    sign: str = "auto",
    name: str | None = None,
    progress: Progress | None = None,
    series: int | Literal["auto"] = 1,
    parallel: int = 1,
    channels: Mapping[str, str] | None = None,
    instance: int | None = None,
    dbc: str | Path | None = None,
    partial: bool = False,
    check_sign: bool = True,
    decimal: str = "auto",
) -> CellLog:
    """Read a log in the tidy form or in a native format detected from its content.

    The tidy form has the columns ``time_s, current_A, voltage_V[, temperature_C]
    [, ampere_hours][, step]`` in any order, as CSV (plain or gzip) or parquet, positive current =
    discharge. Other units are converted when the name gives them (``current_mA``, ``time_h``, ...).
    `FORMATS` holds the others; what they need beyond pyarrow is in the extra ``importers``.

    Parameters
    ----------
    path : str, Path or Stated      a string may state what is known of the log behind an @
                        (``"LOG@temperature_C=-20,soc0=1"``); a Path is taken as it is
    sign : str          ``auto`` trusts the format's sign and verifies it; the other two,
                        ``charge-positive`` and ``discharge-positive``, override the format
    name : str          for people; the file's name without suffix if not given
    progress : callable     called with what is done and the total, while reading
    series : int or "auto"  cells in series, to read a pack as its mean cell; ``auto``: the number
                            that the file states. A table with a voltage for each cell is read as
                            their mean cell without it
    parallel : int          cells in parallel
    channels : mapping      which column or signal is which: a tidy name, which gives the unit, to
                            the name in the file (``{"current_mA": "I_pack"}``)
    instance : int          which battery of a file that holds several, counted from 0
    dbc : str or Path       database of the frames of a CAN log
    partial : bool          read a recording that was cut off (loss of power) as far as it goes
    check_sign : bool       verify the sign from the data, which takes longer than reading

    Returns
    -------
    CellLog             its ``notices`` say what was converted, left out or looks wrong

    Raises
    ------
    InputError          the file cannot be read as a log: see the message for what to do
    """
    stated = path if isinstance(path, Stated) else Stated(str(path))
    if isinstance(path, str):
        stated = Stated.parse(path)
    options = ReadOptions(
        series=series,
        parallel=parallel,
        channels=dict(channels or {}),
        instance=instance,
        dbc=None if dbc is None else Path(dbc),
        partial=partial,
        decimal=decimal,
    )
    source = open_source(stated.path, progress, options)
    known = detect_format(source, FORMATS)
    pack = columns_of_table(source, known)
    counts = (FROM_FILE, sum(c.kind == "cell" for c in pack)) if known.name in TIDY else ()
    if pack and options.series in (1, *counts):
        mean = _mean_of_pack(source, known, pack, sign, name, check_sign)
        return stated.applied(mean)
    raw = complete(read_channels(source, known), known.sign, source.where)
    raw = to_cell(raw, options, source.where)
    origin = Origin(
        name=plain_name(source.path) if name is None else name,
        source=str(source.path),
        format=known.name,
        sign=known.sign,
        current_meaning=known.current_meaning,
    )
    log = assemble(CellLog, raw, origin, sign, check_sign=check_sign)
    return stated.applied(log)


def _mean_of_pack(
    source: LogSource,
    known: Format,
    columns: tuple[CellColumn, ...],
    sign: str,
    name: str | None,
    check_sign: bool,
) -> CellLog:
    """The mean cell of a table with a voltage for each cell, and a notice that says so."""
    name = plain_name(source.path) if name is None else name
    pack = pack_of(source, known, columns, sign=sign, name=name, check_sign=check_sign)
    warm = sum(c.kind == "temperature" for c in columns)
    cells = f"{pack.cells} cells" + (f" and {warm} temperatures" if warm > 1 else "")
    said = f"a table of {cells}, {AS_MEAN_CELL} (`cellwise pack` sees each)"
    return pack.mean.with_notices((*pack.notices, said))


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
                f"`series='auto'` for {where}, which does not state its cells in series",
                "a number of cells",
                "Give it: `series=4`, say.",
            )
        series = raw.cells
    notices = list(raw.notices)
    if raw.cells is not None and raw.cells > 1 and options.series == 1:
        notices.append(
            f"the file states {raw.cells} cells in series: `series='auto'` reads their mean cell"
        )
    elif raw.cells is not None and raw.cells != series:
        notices.append(
            f"the file states {raw.cells} cells in series, {series} were stated by the user"
        )
    channels = dict(raw.channels)
    if series > 1:
        channels["voltage_V"] = channels["voltage_V"] / series
    if options.parallel > 1:
        for field in ("current_A", "charge_Ah"):
            if field in channels:
                channels[field] = channels[field] / options.parallel
    if series > 1 or options.parallel > 1:
        notices.append(
            f"a pack of {series} in series, {options.parallel} in parallel, read as its mean cell"
        )
    return RawLog(channels, tuple(notices), raw.cells)
