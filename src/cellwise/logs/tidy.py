"""The tidy form: time_s, current_A, voltage_V[, temperature_C][, ampere_hours][, step]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.arrow_arrays import to_numpy
from cellwise.logs.columns import TIDY_CHANNELS, Channel, choose_columns
from cellwise.logs.csv_text import read_csv
from cellwise.logs.formats import Format
from cellwise.logs.source import LogSource, RawLog
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    import pyarrow

PARQUET_MAGIC = b"PAR1"
_TEXT_CONTROLS = b"\t\n\r\f"


def is_parquet(source: LogSource) -> bool:
    """The file begins as parquet does."""
    return not source.gzipped and source.head.startswith(PARQUET_MAGIC)


def is_text(source: LogSource) -> bool:
    """The file's beginning has no byte that text has not."""
    return not any(byte < 32 and byte not in _TEXT_CONTROLS for byte in set(source.head))


def read_parquet(source: LogSource, channels: Sequence[Channel]) -> RawLog:
    """Read the channels' columns of a parquet file, one column at a time.

    Raises
    ------
    InputError        columns missing, not numeric, no rows, a file cut off or damaged
    """
    import pyarrow as pa
    from pyarrow import parquet

    where = f"'{source.path}'"
    try:
        with parquet.ParquetFile(source.path) as file:
            columns, notices = choose_columns(file.schema_arrow.names, channels, where)
            if file.metadata.num_rows == 0:
                raise InputError(f"no rows in {where}", "rows of numbers", "Check the export.")
            arrays: dict[str, FloatArray] = {}
            for k, column in enumerate(columns):
                name = file.schema_arrow.names[column.index]
                values = _numbers(file.read(columns=[name]).column(0), name, where)
                arrays[column.field] = column.unit.convert(values)
                source.tell(k + 1, len(columns))
    except (pa.ArrowException, OSError) as error:
        raise InputError(
            f"a cut off or damaged parquet file {where} ({str(error).splitlines()[0]})",
            "a complete file",
            "Copy it again, or have it written again.",
        ) from None
    return RawLog(arrays, tuple(notices))


def _numbers(column: pyarrow.ChunkedArray, name: str, where: str) -> FloatArray:
    """A column as float64, missing values as NaN."""
    import pyarrow as pa

    kind = column.type
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    numeric = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)
    if not (numeric or pa.types.is_null(kind)):
        raise InputError(
            f"column '{name}' of type {kind} in {where}",
            "a column of numbers",
            "Write the time as seconds from the log's start, and quantities as floating point.",
        )
    chunks = [to_numpy(chunk) for chunk in column.cast(pa.float64()).chunks]
    return np.concatenate(chunks)


TIDY_PARQUET = Format(
    name="tidy-parquet",
    matches=is_parquet,
    channels=TIDY_CHANNELS,
    read=read_parquet,
    sign="discharge-positive",
)

TIDY_CSV = Format(
    name="tidy-csv",
    matches=is_text,
    channels=TIDY_CHANNELS,
    read=read_csv,
    sign="discharge-positive",
)
