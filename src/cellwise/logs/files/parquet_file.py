"""Parquet, a column at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.arrow_arrays import to_numpy
from cellwise.logs.files.columns import Column, Unit, choose_columns, folded
from cellwise.logs.files.format import Format, damaged
from cellwise.logs.files.limits import Limits
from cellwise.logs.files.source import LogSource, RawLog
from cellwise.logs.files.text_cells import arrow_values
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    import pyarrow

PARQUET_MAGIC = b"PAR1"
SMALL_ROWS = 1_000_000


def is_parquet(source: LogSource) -> bool:
    """The file begins as parquet does."""
    return not source.gzipped and source.head.startswith(PARQUET_MAGIC)


def parquet_has(source: LogSource, *groups: tuple[str, ...]) -> bool:
    """A parquet file has a column of each group's names."""
    if not is_parquet(source):
        return False
    import pyarrow as pa

    try:
        schema = source.parquet_metadata.schema.to_arrow_schema()
        names = {folded(name) for name in schema.names}
    except (pa.ArrowException, OSError):
        return False
    return all(names.intersection(map(folded, group)) for group in groups)


def read_parquet(source: LogSource, known: Format) -> RawLog:
    """Read the channels' columns of a parquet file, one column at a time.

    Raises
    ------
    InputError        columns missing, not numeric, no rows, a file cut off or damaged
    """
    import pyarrow as pa
    from pyarrow import parquet

    where = source.where
    try:
        with parquet.ParquetFile(source.path, metadata=source.parquet_metadata) as file:
            columns, notices = choose_columns(
                file.schema_arrow.names,
                known.channels,
                where,
                known=known.known,
                chosen=source.options.channels,
            )
            if file.metadata.num_rows == 0:
                raise InputError(f"no rows in {where}", "rows of numbers", "Check the export.")
            Limits.of(source.size).check_rows(file.metadata.num_rows, where)
            arrays: dict[str, FloatArray] = {}
            header = file.schema_arrow.names
            wanted = [header[column.index] for column in columns]
            for column in columns:
                _check_type(file.schema_arrow.field(column.index).type, column, where)
            small = file.metadata.num_rows <= SMALL_ROWS
            # At once and on this thread alone, where there are many small files; else a column at
            # a time, for the memory's sake.
            table = file.read(columns=wanted, use_threads=False) if small else None
            for k, column in enumerate(columns):
                name = header[column.index]
                read = table if table is not None else file.read(columns=[name])
                values = _numbers(read.column(name), column.unit)
                arrays[column.field] = column.unit.convert(values)
                source.report(k + 1, len(columns))
    except (pa.ArrowException, OSError) as error:
        raise damaged(source, "parquet file", str(error).splitlines()[0]) from None
    return RawLog(arrays, tuple(notices))


def _check_type(kind: pyarrow.DataType, column: Column, where: str) -> None:
    """Refuse a column of something else before it is read, however large it is."""
    import pyarrow as pa

    if column.unit.kind != "number" and _is_text(kind):
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


def _is_text(kind: pyarrow.DataType) -> bool:
    import pyarrow as pa

    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _numbers(column: pyarrow.ChunkedArray, unit: Unit) -> FloatArray:
    """A column as float64, missing values as NaN."""
    import pyarrow as pa

    if unit.kind != "number" and _is_text(column.type):
        parts = [arrow_values(unit, chunk.cast(pa.string())) for chunk in column.chunks]
        return np.concatenate([values for values, _ in parts])
    if column.type != pa.float64():
        column = column.cast(pa.float64())
    chunks = [to_numpy(chunk) for chunk in column.chunks]
    return chunks[0] if len(chunks) == 1 else np.concatenate(chunks)
