"""Columns by their names, in memory or in a parquet file, to a log's channels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import timedelta
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.cells import arrow_values, is_text
from cellwise.logs.files.columns import Channel, Column, NamedColumns, choose_columns, folded
from cellwise.logs.files.format import Format, damaged
from cellwise.logs.files.source import Limits, LogSource, RawLog
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    import pyarrow

PARQUET_MAGIC = b"PAR1"
SMALL_ROWS = 1_000_000  # of a table that is read at once; of a larger one a column at a time


def channels_of(
    arrays: NamedColumns, source: LogSource, known: Format, cells: int | None = None
) -> RawLog:
    """The channels among a native file's arrays; ``cells`` in series, if the file states them.

    Raises
    ------
    InputError              a required channel is missing or holds no numbers; no rows
    """
    where, chosen = source.where, source.options.channels
    raw = table_channels(arrays, known.channels, where, known=known.known, chosen=chosen)
    sizes = {field: values.size for field, values in raw.channels.items()}
    if set(sizes.values()) == {0}:
        raise InputError(f"no rows in {where}", "rows of numbers", "Check the recording.")
    if len(set(sizes.values())) > 1:
        raise InputError(
            f"channels of unequal lengths in {where} ({sizes})",
            "one value per row in each",
            "Choose channels of one group with `channels={...}`.",
        )
    return replace(raw, cells=cells)


def table_channels(
    table: NamedColumns, channels: Sequence[Channel], where: str, **options: Any
) -> RawLog:
    """The channels among the columns of a table in memory; options as of `choose_columns`.

    Raises
    ------
    InputError        a required channel is missing or holds no numbers
    """
    header = getattr(table, "column_names", None)  # pyarrow
    if header is None:
        header = getattr(table, "columns", None)  # pandas, polars
    names = list(cast(Iterable[str], table) if header is None else header)
    columns, notices = choose_columns([str(name) for name in names], channels, where, **options)
    found = {c.field: _values(table[names[c.index]], c, where) for c in columns}
    return RawLog(found, tuple(notices))


def _values(values: Any, column: Column, where: str) -> FloatArray:
    """A column in the channel's unit: numbers, dates, clocks or labels."""
    array = np.asarray(values)
    unit = column.unit
    if column.field == "time_s" and (seconds := _seconds(array)) is not None:
        return unit.convert(seconds)
    if unit.kind == "label" or (unit.kind == "clock" and array.dtype.kind in "UO"):
        import pyarrow as pa

        texts = pa.chunked_array([[str(text) for text in array.tolist()]], pa.string())
        return unit.convert(arrow_values(unit, texts, column.name, where))
    try:
        numbers: FloatArray = np.asarray(array, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise InputError(
            f"column '{column.name}' of {where} ({error})",
            "a column of numbers",
            "Convert it (missing values are nan), or choose another with `channels={...}`.",
        ) from None
    return unit.convert(numbers)


def _seconds(array: Any) -> FloatArray | None:
    """Seconds of dates or of durations, from the first; None for a column of something else."""
    if array.dtype == object and array.size and hasattr(array.flat[0], "isoformat"):
        # Python's own dates, or pandas' with a time zone; numpy wants them without.
        plain = [x.replace(tzinfo=None) - (x.utcoffset() or timedelta()) for x in array.tolist()]
        array = np.array(plain, dtype="datetime64[us]")
    if array.dtype.kind not in "mM":
        return None
    known = array[~np.isnat(array)]
    if known.size == 0:
        return np.full(array.size, np.nan)
    seconds: FloatArray = (array - known[0]) / np.timedelta64(1, "s")
    return seconds


def is_parquet(source: LogSource) -> bool:
    """The file begins as parquet does."""
    return not source.gzipped and source.head.startswith(PARQUET_MAGIC)


def parquet_names(source: LogSource) -> list[str]:
    """Column names of a parquet file.

    Raises
    ------
    InputError        a file that is not whole
    """
    import pyarrow as pa

    try:
        return list(source.parquet_metadata.schema.to_arrow_schema().names)
    except (pa.ArrowException, OSError) as error:
        raise damaged(source, "parquet file", str(error).splitlines()[0]) from None


def parquet_has(source: LogSource, groups: Sequence[Sequence[str]]) -> bool:
    """A parquet file has a column of each group's names."""
    if not is_parquet(source):
        return False
    try:
        names = {folded(name) for name in parquet_names(source)}
    except InputError:
        return False
    return all(names.intersection(map(folded, group)) for group in groups)


def read_parquet(source: LogSource, known: Format) -> RawLog:
    """Read the channels' columns of a parquet file.

    Raises
    ------
    InputError        columns missing, not numeric, no rows, a file cut off or damaged
    """
    import pyarrow as pa
    from pyarrow import parquet

    where = source.where
    header = parquet_names(source)
    columns, notices = choose_columns(
        header, known.channels, where, known=known.known, chosen=source.options.channels
    )
    rows = source.parquet_metadata.num_rows
    if rows == 0:
        raise InputError(f"no rows in {where}", "rows of numbers", "Check the export.")
    Limits.of(source.size).check(where, rows)
    arrays: dict[str, FloatArray] = {}
    try:
        with parquet.ParquetFile(source.path, metadata=source.parquet_metadata) as file:
            for column in columns:
                _check_type(file.schema_arrow.field(column.index).type, column, where)
            wanted = [header[column.index] for column in columns]
            # On this thread alone: there are many small files.
            table = file.read(columns=wanted, use_threads=False) if rows <= SMALL_ROWS else None
            for k, (name, column) in enumerate(zip(wanted, columns, strict=True)):
                read = table if table is not None else file.read(columns=[name])
                arrays[column.field] = column.unit.convert(
                    arrow_values(column.unit, read.column(name), column.name, where)
                )
                source.report(k + 1, len(columns))
    except (pa.ArrowException, OSError) as error:
        raise damaged(source, "parquet file", str(error).splitlines()[0]) from None
    return RawLog(arrays, tuple(notices))


def _check_type(kind: pyarrow.DataType, column: Column, where: str) -> None:
    """Refuse a column of something else before it is read, however large it is."""
    import pyarrow as pa

    if column.unit.kind != "number" and is_text(kind):
        return
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    numeric = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)
    if not (numeric or pa.types.is_null(kind)):
        raise InputError(
            f"column '{column.name}' of type {kind} in {where}",
            "a column of numbers",
            "Write the time as seconds from the log's start, and quantities as floating point.",
        )
