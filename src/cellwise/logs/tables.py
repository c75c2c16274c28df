"""Columns of results as a file: CSV, gzip or parquet, whole or not at all."""

from __future__ import annotations

import gzip
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cellwise.errors import InputError
from cellwise.files import write_atomically


def write_columns(columns: Mapping[str, Any], path: Path) -> Path:
    """Write arrays of one length as columns; the suffix says in which form.

    Raises
    ------
    InputError        another suffix, or a place that cannot be written to
    """
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    table = pa.table({name: pa.array(values) for name, values in columns.items()})
    name = path.name.casefold()
    if name.endswith(".parquet"):
        return write_atomically(path, lambda target: pa.parquet.write_table(table, target))
    if name.endswith(".csv"):
        return write_atomically(path, lambda target: pa.csv.write_csv(table, target))
    if name.endswith(".csv.gz"):

        def packed(target: Path) -> None:
            with gzip.open(target, "wb", compresslevel=6) as file:
                pa.csv.write_csv(table, file)

        return write_atomically(path, packed)
    raise InputError(
        f"an output file '{path.name}'",
        "a name that ends in .parquet, .csv or .csv.gz",
        "The suffix says in which form the rows are written.",
    )


def write_rows(columns: Mapping[str, Any], types: Mapping[str, type], path: Path) -> Path:
    """Write lists of one length as a parquet file whose types do not depend on the values.

    Parameters
    ----------
    columns : mapping       name to list, None for what is missing
    types : mapping         name to ``int``, ``float`` or ``str``
    path : Path             appears whole or not at all
    """
    import pyarrow as pa
    import pyarrow.parquet

    kinds = {int: pa.int64(), float: pa.float64(), str: pa.string()}
    table = pa.table({n: pa.array(list(columns[n]), kinds[kind]) for n, kind in types.items()})
    return write_atomically(path, lambda target: pa.parquet.write_table(table, target))


def read_rows(path: Path) -> dict[str, list[Any]]:
    """Columns of a parquet file as lists.

    Raises
    ------
    InputError        no parquet file
    """
    import pyarrow as pa
    import pyarrow.parquet

    try:
        with pa.parquet.ParquetFile(path) as file:
            table = file.read()
    except (pa.ArrowException, OSError) as error:
        raise InputError(
            f"'{path}', which is no parquet file ({str(error).splitlines()[0]})",
            "a part that this command wrote",
            "Remove it, or start again with `fresh=True`.",
        ) from None
    return dict(table.to_pydict())
