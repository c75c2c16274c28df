"""Parquet, a column at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.arrow_arrays import to_numpy
from cellwise.logs.columns import Unit, choose_columns, folded
from cellwise.logs.format import Format, damaged
from cellwise.logs.source import LogSource, RawLog
from cellwise.logs.text_cells import arrow_values
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    import pyarrow

PARQUET_MAGIC = b"PAR1"


def is_parquet(source: LogSource) -> bool:
    """The file begins as parquet does."""
    return not source.gzipped and source.head.startswith(PARQUET_MAGIC)


def parquet_has(source: LogSource, *groups: tuple[str, ...]) -> bool:
    """A parquet file has a column of each group's names."""
    if not is_parquet(source):
        return False
    import pyarrow as pa
    from pyarrow import parquet

    try:
        names = {folded(name) for name in parquet.read_schema(source.path).names}
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
        with parquet.ParquetFile(source.path) as file:
            columns, notices = choose_columns(
                file.schema_arrow.names,
                known.channels,
                where,
                known=known.known,
                chosen=source.options.channels,
            )
            if file.metadata.num_rows == 0:
                raise InputError(f"no rows in {where}", "rows of numbers", "Check the export.")
            arrays: dict[str, FloatArray] = {}
            for k, column in enumerate(columns):
                name = file.schema_arrow.names[column.index]
                values = _numbers(file.read(columns=[name]).column(0), column.unit, name, where)
                arrays[column.field] = column.unit.convert(values)
                source.tell(k + 1, len(columns))
    except (pa.ArrowException, OSError) as error:
        raise damaged(source, "parquet file", str(error).splitlines()[0]) from None
    return RawLog(arrays, tuple(notices))


def _numbers(column: pyarrow.ChunkedArray, unit: Unit, name: str, where: str) -> FloatArray:
    """A column as float64, missing values as NaN."""
    import pyarrow as pa

    kind = column.type
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    if unit.kind != "number" and (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        parts = [arrow_values(unit, chunk.cast(pa.string())) for chunk in column.chunks]
        return np.concatenate([values for values, _ in parts])
    numeric = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)
    if not (numeric or pa.types.is_null(kind)):
        raise InputError(
            f"column '{name}' of type {kind} in {where}",
            "a column of numbers",
            "Write the time as seconds from the log's start, and quantities as floating point.",
        )
    chunks = [to_numpy(chunk) for chunk in column.cast(pa.float64()).chunks]
    return np.concatenate(chunks)
